"""What the page may open lies below one folder, links resolved; other machines need that folder named."""

from __future__ import annotations

from pathlib import Path

import pytest

from rpl_data.annotate import Address
from rpl_data.annotate.opening import Opening
from rpl_data.cli.opened import folder_of
from rpl_data.types import DataError

HERE, ANYWHERE = Address("127.0.0.1", 8017, None), Address("0.0.0.0", 8017, "secret")


def opening_of(folder: Path | None) -> Opening:
    return Opening(folder, lambda path: 0, lambda *said: [])


def test_paths_that_lead_out_are_refused_whether_they_exist_or_not(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    (folder / "ws").mkdir(parents=True)
    (folder / "out").symlink_to(tmp_path)
    opening = opening_of(folder)
    assert opening.allowed("ws") == opening.allowed(str(folder / "ws")) == folder / "ws"
    for text in ("..", "../mine2", "/etc", "/none", "out", "out/mine2", str(tmp_path), "ws/../../x", "a\0b"):
        with pytest.raises(DataError):
            opening.allowed(text)


def test_other_machines_open_nothing_unless_a_folder_was_named(tmp_path: Path) -> None:
    workspace = tmp_path / "ws"
    assert folder_of(workspace, HERE, None) == tmp_path
    assert folder_of(workspace, ANYWHERE, None) is None
    assert folder_of(workspace, ANYWHERE, tmp_path) == tmp_path
    with pytest.raises(DataError, match="served to other machines"):
        opening_of(None).allowed("ws")
    with pytest.raises(DataError, match="no such folder"):
        folder_of(workspace, HERE, tmp_path / "none")


def test_workspaces_are_listed_without_links_and_hidden_ones(tmp_path: Path) -> None:
    for name in ("a", "deep/b", ".hidden/c", "plain"):
        (tmp_path / name / "scenes").mkdir(parents=True)
        if name != "plain":
            (tmp_path / name / "recipe.yaml").touch()
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert opening_of(tmp_path).workspaces() == [tmp_path / "a", tmp_path / "deep" / "b"]
    assert opening_of(None).workspaces() == []
