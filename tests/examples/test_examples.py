"""Every script of examples/ runs as it stands, on the tiny workspace."""

from __future__ import annotations

import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

from rpl_data.workspace.workspace import Workspace

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: object) -> None:
    """The script as `python examples/NAME ...` runs it."""
    monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_each_example_has_a_test() -> None:
    tests = Path(__file__).read_text()
    assert all(f'"{path.name}"' in tests for path in EXAMPLES.glob("*.py"))


def test_pipeline(tiny_workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The labels of the script are the true ones, to the accuracy of the clicks."""
    recording = tiny_workspace.recording
    run(monkeypatch, "pipeline.py", recording, recording / "clicks.csv", "carton", tmp_path / "ws")
    made = Workspace(tmp_path / "ws").label_arrays("carton")
    truth = Workspace(tiny_workspace.truth).label_arrays("carton")
    assert made.scenes == truth.scenes and made.frames.tolist() == truth.frames.tolist()
    known = (made.visibility > 0) & np.isfinite(truth.keypoints_px).all(axis=2)
    errors_px = np.linalg.norm(made.keypoints_px - truth.keypoints_px, axis=2)[known]
    assert errors_px.mean() < 1.5 and known.mean() > 0.9
    assert Workspace(tmp_path / "ws").mesh("carton").triangles.shape[1] == 3


def test_labels_as_arrays(
    tiny_workspace: Workspace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run(monkeypatch, "labels_as_arrays.py", tiny_workspace.root)
    assert "carton: 18 labels in scenes 00, 01, 02; 0." in capsys.readouterr().out


def test_draw_labels(tiny_workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(monkeypatch, "draw_labels.py", tiny_workspace.root, tmp_path)
    assert len(list(tmp_path.glob("*/*.jpg"))) == 18
    picture = cv2.imread(str(tmp_path / "01/000003.jpg"), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    difference = np.abs(picture.astype(int) - tiny_workspace.overlay("01", 3))
    assert np.median(difference) < 4  # a JPEG of it, red and blue in their places


def test_train_in_your_own_loop(
    tiny_workspace: Workspace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run(monkeypatch, "train_in_your_own_loop.py", tiny_workspace.export("coco"), "carton", 2)
    said = capsys.readouterr().out
    losses = [float(line.split()[-1]) for line in said.splitlines() if line.startswith("epoch")]
    assert len(losses) == 2 and losses[1] < losses[0]
    assert "labelled camera_from_object" in said


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_without_arguments_an_example_says_how_it_is_called(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit) as end:
        run(monkeypatch, path.name)
    assert f"python examples/{path.name} my-" in str(end.value)
