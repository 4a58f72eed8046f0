"""The segmentation figure end to end on the tiny workspace, and the rules it is drawn by."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from rpl_data.types import DataError
from rpl_data.workspace import Workspace
from training.mask_scores import ClassScore, SplitScore
from training.mask_settings import Settings
from training.reproduce.__main__ import main
from training.reproduce.segmentation import Progress, replanned, sources_of
from training.reproduce.segmentation_page import verdict

SETTINGS = """
settings:
  model: {backbone: resnet18, size_px: 64, channels: 32, hidden: 64, proposals: 20, rois: 16, detections: 5}
  weights: scratch
  epochs: 2
  head_epochs: 0
  batch: 4
  optimizer: adamw
  workers: 0
  accelerator: cpu
"""


def scored(mean_iou: float | None) -> SplitScore:
    row = ClassScore("can", 5, mean_iou, 0, 0, None, None, None)
    return SplitScore(5, mean_iou, None, None, None, None, (row,))


@pytest.fixture
def workspace(tiny_workspace: Workspace, tmp_path: Path) -> Workspace:
    """A copy: the true labels are exported into it."""
    shutil.copytree(tiny_workspace.root, tmp_path / "tiny")
    return Workspace(tmp_path / "tiny")


def test_figure_page_and_numbers(
    workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "quick.yaml").write_text(SETTINGS)
    out = tmp_path / "out"
    command = [
        "segmentation",
        str(workspace.root),
        "--out",
        str(out),
        "--preset",
        str(tmp_path / "quick.yaml"),
    ]
    assert main(command) == 0
    found = json.loads((out / "segmentation.json").read_text())
    assert set(found["scores"]) == {"val", "test"} and set(found["scores"]["test"]) == {"OURS", "MANUAL"}
    assert found["progress"]["epochs"] == 2 and len(found["progress"]["history"]) == 2
    assert found["verdict"]["test"]["valid"] is False  # two epochs of eleven images teach nothing
    images = json.loads((workspace.export("coco_truth") / "test.json").read_text())["images"]
    assert found["scores"]["test"]["OURS"]["images"] == len(images) == 6
    assert cv2.imread(str(out / "segmentation.png")) is not None
    page = (out / "segmentation.html").read_text()
    assert "The comparison does not count" in page and page.count("data:image/png") >= 3
    assert main(command) == 0  # nothing is left to train
    assert json.loads((out / "segmentation.json").read_text())["scores"] == found["scores"]


def test_sources_must_have_the_same_images(workspace: Workspace) -> None:
    sources = sources_of(workspace.root)
    data = json.loads((sources["MANUAL"] / "train.json").read_text())
    gone = data["images"].pop()["id"]
    data["annotations"] = [a for a in data["annotations"] if a["image_id"] != gone]
    (sources["MANUAL"] / "train.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match="other training images"):
        sources_of(workspace.root)


def test_the_plan_follows_the_budget() -> None:
    settings = Settings(epochs=20, head_epochs=0, cooldown=0.25)
    at = Progress(epochs=4, plan=20, seconds=400.0)
    assert replanned(at, settings, budget_s=10_000) == 20
    assert replanned(at, settings, budget_s=1_000) == 9  # 900 s of them for training, 100 s an epoch
    slow = replace(at, plan=9, seconds=300.0)  # the machine became faster
    assert replanned(slow, settings, budget_s=1_000) == 12
    falling = replace(at, epochs=8, plan=9, seconds=600.0)  # the rate falls towards epoch 9 already
    assert replanned(falling, settings, budget_s=1_000) == 9
    assert replanned(replace(at, seconds=5_000.0), settings, budget_s=1_000) == 4


def test_the_comparison_counts_from_half_on() -> None:
    counted = verdict({"OURS": scored(0.56), "MANUAL": scored(0.6)})
    assert counted["valid"] and counted["within_5_points"]
    assert counted["ours_minus_manual_points"] == pytest.approx(-4)
    assert not verdict({"OURS": scored(0.54), "MANUAL": scored(0.6)})["within_5_points"]
    assert not verdict({"OURS": scored(0.49), "MANUAL": scored(0.49)})["valid"]
    assert verdict({"OURS": scored(None), "MANUAL": scored(None)})["ours_minus_manual_points"] is None
