"""The ledger: what makes a step run again, and what does not."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from rpl_data.pipeline.ledger import Ledger, Outcome, Step, stamps
from rpl_data.types import DataError


def noop(advance: Callable[[int, int], None]) -> Outcome:
    return Outcome()


def step(source: Path, *outputs: Path) -> Step:
    return Step("import", "", 1, {"a": (1, 2)}, stamps(source), (), outputs, noop)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    (tmp_path / "rgb").mkdir()
    for number in range(3):
        (tmp_path / "rgb" / f"{number}.png").write_bytes(b"image" * (number + 1))
    (tmp_path / "rgb.txt").write_text("list")
    return tmp_path


def replace_same_size(path: Path) -> None:
    status = path.stat()
    path.write_bytes(bytes(reversed(path.read_bytes())))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns - 10**12))  # as `cp -p` of an older file does


def swap(path: Path) -> None:
    other = path.with_name("2.png")
    path.rename(path.with_name("x"))
    other.rename(path)
    path.with_name("x").rename(other)


@pytest.mark.parametrize(
    "change",
    [
        replace_same_size, swap, Path.unlink,
        lambda p: p.write_bytes(b""), lambda p: p.rename(p.with_name("9.png")),
    ],
)  # fmt: skip
def test_an_image_that_is_replaced_renamed_or_gone_is_noticed(
    recording: Path, change: Callable[[Path], object]
) -> None:
    ledger = Ledger(recording / "ws/stages.json")
    ledger.run(step(recording / "rgb"), lambda done, total: None)
    assert ledger.holds(step(recording / "rgb"))
    change(recording / "rgb/1.png")
    assert not Ledger(recording / "ws/stages.json").holds(step(recording / "rgb"))


def test_a_ledger_that_only_counted_images_holds_and_then_knows_them(recording: Path) -> None:
    path = recording / "ws/stages.json"
    Ledger(path).run(step(recording / "rgb"), lambda done, total: None)
    stored = json.loads(path.read_text())
    stored["import"]["sources"] = {str(recording / "rgb"): 3}
    del stored["import"]["folders"]
    path.write_text(json.dumps(stored))
    old = Ledger(path)
    assert old.holds(step(recording / "rgb"))
    old.renew(step(recording / "rgb"))
    replace_same_size(recording / "rgb/1.png")
    assert not Ledger(path).holds(step(recording / "rgb"))
    path.write_text(json.dumps(stored))
    (recording / "rgb/1.png").unlink()
    assert not Ledger(path).holds(step(recording / "rgb")), "two images are not three"


def test_a_folder_that_lost_what_was_made_in_it_is_made_again(recording: Path) -> None:
    made = recording / "export"
    (made / "images").mkdir(parents=True)
    (made / "train.json").write_text("{}")
    (made / "images/a.png").write_bytes(b"12345")
    ledger = Ledger(recording / "ws/stages.json")
    ledger.run(step(recording / "rgb", made), lambda done, total: None)
    (made / "notes.txt").write_text("somebody's own")
    assert ledger.holds(step(recording / "rgb", made))
    (made / "images/a.png").write_bytes(b"")
    assert not ledger.holds(step(recording / "rgb", made))
    (made / "images/a.png").write_bytes(b"12345")
    (made / "train.json").write_text("")
    assert not ledger.holds(step(recording / "rgb", made))


def test_a_link_that_leads_nowhere_is_passed_over(recording: Path) -> None:
    (recording / "rgb/3.png").symlink_to(recording / "nowhere.png")
    (recording / "notes.txt").symlink_to(recording / "nowhere.txt")
    assert str(recording / "notes.txt") not in stamps(recording)


def test_a_ledger_with_a_damaged_field_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "stages.json"
    entry = {
        "key": "k",
        "version": 1,
        "options": {},
        "sources": {},
        "after": {},
        "seconds": 0.5,
        "folders": {},
    }
    entry |= {"outcome": {"frames": 1, "messages": ["a"], "details": {}}}
    path.write_text(json.dumps({"import": entry}))
    assert Ledger(path).entries["import"].outcome.messages == ("a",)
    for name in entry:
        for strange in (None, [1], {"a": float("nan")}, *(["x"] if name != "key" else [])):
            path.write_text(json.dumps({"import": entry | {name: strange}}))
            with pytest.raises(DataError, match=r"stages\.json.*delete it"):
                Ledger(path)


@pytest.mark.parametrize(
    "content", ["[3]", "{", '{"import": {}}', '{"import": 3}', '{"import": {"more": 1}}', "9" * 5000]
)
def test_a_broken_ledger_or_one_of_a_newer_version_is_one_line(tmp_path: Path, content: str) -> None:
    (tmp_path / "stages.json").write_text(content)
    with pytest.raises(DataError, match=r"stages\.json.*delete it"):
        Ledger(tmp_path / "stages.json")
