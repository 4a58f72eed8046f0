"""What the benchmarks keep of a run, and how two runs are compared."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location("rows", Path(__file__).parent / "bench/rows.py")
assert SPEC is not None and SPEC.loader is not None
rows = sys.modules["rows"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(rows)


def test_two_runs_are_compared_by_ratios_and_beyond_their_spread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(name: str) -> None:
        rows.main("table", str(tmp_path / f"{name}.rows"), str(tmp_path / f"{name}.json"))

    monkeypatch.setenv("RPL_BENCH_ROWS", str(tmp_path / "a.rows"))
    rows.record("solve", "l2", [1.0, 1.1, 0.9], "s", baseline=("slsqp", 100.0), asked=10)
    rows.record("label", "warm", 200.0, "frames/s", more_is_better=True)
    rows.record("gone", "old", 1.0, "s")
    run("a")
    assert "| solve | l2 | 1 s | slsqp: 100 | 100.00 | 10 |" in capsys.readouterr().out
    kept = json.loads((tmp_path / "a.json").read_text())
    assert {"commit", "machine", "cores", "packages"} <= kept["run"].keys() and len(kept["rows"]) == 3
    monkeypatch.setenv("RPL_BENCH_ROWS", str(tmp_path / "b.rows"))
    rows.record("solve", "l2", [2.0, 2.2, 1.8], "s", baseline=("slsqp", 200.0), asked=10)  # a slower machine
    rows.record("label", "warm", 100.0, "frames/s", more_is_better=True)
    run("b")
    capsys.readouterr()
    rows.main("compare", str(tmp_path / "a.json"), str(tmp_path / "b.json"))
    lines = capsys.readouterr().out.splitlines()
    assert lines[2:] == ["worse by 2.00x: label: warm: 200 -> 100 frames/s", "only in the first: gone: old"]


def test_every_benchmark_keeps_its_figures() -> None:
    for program in (Path(__file__).parent / "bench").glob("bench_*.py"):
        text = program.read_text(encoding="utf-8")
        assert "from rows import" in text and "record(" in text, program.name


def test_a_share_of_the_repetitions(monkeypatch: pytest.MonkeyPatch) -> None:
    assert rows.shared(20, least=4) == 20
    monkeypatch.setenv("RPL_BENCH_SHARE", "0.25")
    assert rows.shared(20, least=4) == 5 and rows.shared(20, least=8) == 8 and rows.shared(3, least=8) == 3


def test_no_false_alarm_can_be_compared() -> None:
    none, some = (rows.Row("doctor", "sound: false alarms", value, "share") for value in (0.0, 0.05))
    assert rows.compared([none], [none]) == []
    assert rows.compared([none], [some])[0].startswith("worse by 50.00x")
