"""The experiments end to end on the tiny workspace, and the laws their numbers keep."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from rpl_data.workspace import Workspace
from training.reproduce.__main__ import COMMANDS, main
from training.reproduce.results import finite_or_none, write_results

ROOT = Path(__file__).parent.parent


def test_help_is_quick_and_lists_every_command() -> None:
    code = (
        "import sys; from training.reproduce.__main__ import COMMANDS; "
        "heavy = {'torch', 'open3d', 'matplotlib', 'cv2'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    assert all((command.__doc__ or "").strip() for command in COMMANDS.values())


def test_table1_of_a_workspace(
    tiny_workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["table1", str(tiny_workspace.root), "--out", str(tmp_path)]) == 0
    (row,) = json.loads((tmp_path / "table1.json").read_text())["rows"]
    assert (row["object"], row["keypoints"], row["scenes"]) == ("carton", 8, 3)
    assert row["labels"] == sum(
        1 for s in tiny_workspace.scene_names() for _ in tiny_workspace.load_labels(s)
    )
    assert 0 < row["strict"]["error_3d_mm"] < 5
    assert "carton" in (tmp_path / "table1.html").read_text()


def test_a_folder_that_is_no_workspace_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["table1", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "is not a workspace" in capsys.readouterr().err


def test_results_hold_no_nan(tmp_path: Path) -> None:
    page = write_results(tmp_path, "x", title="<X>", data={"a": [float("nan"), 1.0]}, sections=["body"])
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [None, 1.0]}
    assert "&lt;X&gt;" in page.read_text()
    assert finite_or_none({"t": (1, float("inf"))}) == {"t": [1, None]}
