"""What a build says where there is no terminal, and which messages it repeats."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from rpl_data.cli import screen
from rpl_data.pipeline.build import Progress
from rpl_data.pipeline.ledger import Ledger, Outcome, Step
from rpl_data.workspace.workspace import Workspace


def test_without_a_terminal_a_long_step_is_named_at_most_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 0.0
    monkeypatch.setattr(screen.time, "monotonic", lambda: now_s)
    with screen.Screen() as shown:
        shown.console = shown._lines.console = Console(file=(file := io.StringIO()))
        for now_s in range(26):
            shown.tell(Progress("label", "00", "runs", now_s, 100))
        shown.tell(Progress("label", "00", "kept"))
        for now_s in range(26, 34):
            shown.tell(Progress("label", "01", "runs", now_s - 26, 100))
    lines = [line.split() for line in file.getvalue().splitlines()]
    assert lines == [["label", "00", "10", "of", "100"], ["label", "00", "20", "of", "100"]]


def test_steps_that_run_side_by_side_are_named_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(screen.time, "monotonic", lambda: now_s)
    with screen.Screen() as shown:
        shown.console = shown._lines.console = Console(file=(file := io.StringIO()), width=200)
        for now_s in range(12):
            shown.tell(Progress("track", "00", "runs", now_s, 50))
            shown.tell(Progress("track", "01", "runs"))
        shown.tell(Progress("track", "01", "failed"))
    lines = [" ".join(line.split()) for line in file.getvalue().splitlines()]
    assert lines == ["track 00 10 of 50, track 01 at work", "track 01 failed"]


def test_an_import_repeats_nothing_that_later_stages_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ledger = Ledger(tmp_path / "stages.json")
    for stage in ("cut", "solve"):
        said = Outcome(messages=(f"{stage} speaks",))
        ledger.run(
            Step(stage, "", 1, {}, {}, (), (), lambda advance, said=said: said), lambda done, total: None
        )
    with screen.Screen() as shown:
        screen.print_results(Workspace(tmp_path), ledger, shown, "cut", {"cut", "solve"})
    told = capsys.readouterr().out
    assert "cut speaks" in told and "solve speaks" not in told
