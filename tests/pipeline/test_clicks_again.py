"""A newer CSV file of the recipe, where clicks were also made by hand or imported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from rpl_data.clicks.incoming import Incoming
from rpl_data.clicks.log import click_event
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.ledger import Entry, Ledger
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.recipe import ObjectRecipe, Recipe
from rpl_data.pipeline.stages.clicks import add_clicks, clicks_steps, import_clicks
from rpl_data.types import Click, DataError
from rpl_data.workspace.workspace import Workspace

ITEM = ObjectRecipe("egg", ("a", "b", "c"))
HEADING = "object,keypoint,scene,frame,u_px,v_px"


def csv_of(path: Path, *rows: str) -> Path:
    path.write_text("\n".join([HEADING, *(f"egg,{row}" for row in rows)]) + "\n")
    return path


def clicks_of(workspace: Workspace) -> set[tuple[int, int, float]]:
    return {(c.keypoint, c.frame, c.u_px) for c in workspace.load_annotation("egg").clicks}


def test_clicks_made_elsewhere_stay_and_those_of_the_file_follow_it(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path / "ws")
    path = csv_of(tmp_path / "clicks.csv", "a,00,1,10,5", "b,00,1,20,5", "c,00,1,30,5")
    _, first, kept = import_clicks(workspace, ITEM, path)
    assert kept == 0 and clicks_of(workspace) == {(0, 1, 10), (1, 1, 20), (2, 1, 30)}
    by_hand = [Click("egg", 0, "00", 9, 11.0, 5.0), Click("egg", 1, "00", 1, 22.0, 5.0)]  # added, moved
    workspace.append_events("egg", [click_event(click) for click in by_hand])
    csv_of(path, "a,00,1,12,5", "b,00,1,20,5")  # moved, as it was, removed
    found, now, kept = import_clicks(workspace, ITEM, path, first)
    assert clicks_of(workspace) == {(0, 1, 12), (0, 9, 11), (1, 1, 22)} and kept == 2
    assert (found.added, found.moved, found.removed) == (0, 1, 1)
    again, _, kept = import_clicks(workspace, ITEM, path, now)
    assert again.changed == 0 and kept == 2


def test_without_a_memory_of_the_file_nothing_is_removed(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path / "ws")
    import_clicks(workspace, ITEM, csv_of(tmp_path / "one.csv", "a,00,1,10,5", "b,00,1,20,5"))
    _, _, kept = import_clicks(workspace, ITEM, csv_of(tmp_path / "two.csv", "b,00,1,21,5"))
    assert clicks_of(workspace) == {(0, 1, 10), (1, 1, 21)} and kept == 1


def test_a_table_without_a_click_is_refused(tmp_path: Path) -> None:
    context = Context(Recipe("eggs", objects=(ITEM,)), Workspace(tmp_path / "ws"), Pool(1))
    with pytest.raises(DataError, match="clicks.csv holds no click"):
        add_clicks(context, csv_of(tmp_path / "clicks.csv"), proposed=True)


def test_what_a_program_proposes_in_vain_is_counted() -> None:
    none = Incoming((), added=0, moved=0, removed=0, same=0, decided=3)
    assert str(none) == "no click changed; 3 were left out, of keypoints clicked or skipped before"
    some = replace(none, added=2, same=1, decided=1)
    assert (
        str(some)
        == "2 clicks added; 1 stays as before; 1 was left out, of keypoints clicked or skipped before"
    )


def test_a_file_that_is_away_costs_no_clicks(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path / "ws")
    path = csv_of(tmp_path / "clicks.csv", "a,00,1,10,5", "b,00,1,20,5")
    recipe = Recipe("eggs", objects=(replace(ITEM, clicks=path),))

    def read(*, keep_going: bool = False) -> Entry:
        (step,) = clicks_steps(Context(recipe, workspace, Pool(1), keep_going=keep_going))
        return Ledger(workspace.stages_file).run(step, lambda done, total: None)

    read()
    path.unlink()
    assert "stay as they are" in read(keep_going=True).outcome.messages[0]
    assert clicks_of(workspace) == {(0, 1, 10), (1, 1, 20)}
    csv_of(path, "a,00,1,11,5")
    read()
    assert clicks_of(workspace) == {(0, 1, 11)}  # what was read before it was away is still known
    path.unlink()
    with pytest.raises(DataError, match=r"clicks\.csv does not exist"):
        read()
