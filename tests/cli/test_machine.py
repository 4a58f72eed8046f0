"""`rpl demo` is the recipe of the repository; `rpl doctor` says what is there and what is not."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from rpl_data.capture.playback import read_realsense
from rpl_data.cli import installed
from rpl_data.cli.main import main
from rpl_data.pipeline.demo import DEMO
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.raycast import RayScene
from rpl_data.types import DataError

ROOT = Path(__file__).parents[2]


def test_the_demo_is_the_recipe_of_the_repository() -> None:
    assert load_recipe(ROOT / "datasets/demo.yaml") == DEMO


def test_what_is_missing_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr(
        installed.importlib.util, "find_spec", lambda name: None if name == "pyrealsense2" else there(name)
    )
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("rpl-data ") and any("ok       numpy" in line for line in lines)
    (missing,) = [line for line in lines if "missing" in line]
    assert "pyrealsense2: RealSense cameras" in missing and "pip install pyrealsense2" in missing


def test_what_few_people_need_is_optional(monkeypatch: pytest.MonkeyPatch) -> None:
    there, packages = importlib.util.find_spec, {"depthai", "pyorbbecsdk", "pyk4a", "record3d", "s3fs"}
    monkeypatch.setattr(
        installed.importlib.util, "find_spec", lambda name: None if name in packages else there(name)
    )
    lines = [line for line in installed.package_lines() if "not installed" in line]
    assert len(lines) == 5 and all(line.startswith("  optional ") for line in lines)
    said = "pyorbbecsdk2: capture with Orbbec cameras, not installed; pip install --no-deps"
    assert any(said in line for line in lines)


def test_a_command_that_needs_what_is_missing_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    monkeypatch.setattr("rpl_data.cli.main.COMMANDS", {"cast": cast})
    assert main(["cast"]) == 1
    assert capsys.readouterr().err == (
        "rpl: missing open3d: surfaces, masks will not work; pip install rpl-data\n"
    )


def cast() -> None:
    """Need Open3D."""
    RayScene([])


def test_a_file_of_realsense_is_not_called_damaged_where_its_reader_is_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "take.db3").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DataError, match="needs pyrealsense2, which is not installed"):
        read_realsense(tmp_path / "take.db3", unpack=lambda name: tmp_path)
