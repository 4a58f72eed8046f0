"""The segmentation figure end to end on the tiny workspace, and the rules it is drawn by."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace
from training.masks.scores import ClassScore, SplitScore
from training.masks.settings import MaskSettings, comparable, load_settings
from training.reproduce.__main__ import main
from training.reproduce.segmentation import experiment
from training.reproduce.segmentation.experiment import (
    given,
    segmentation,
    sources_of,
    train_round,
    with_weights,
)
from training.reproduce.segmentation.page import verdict
from training.reproduce.segmentation.progress import Progress
from training.train_masks import train_masks

SETTINGS = """
network: {backbone: resnet18, size_px: 64, channels: 32, hidden: 64, proposals: 20, rois: 16, detections: 5}
learning: {epochs: 2, batch: 4, optimizer: adamw}
weights: scratch
head_epochs: 0
machine: {workers: 0, accelerator: cpu}
"""


def scored(mean_iou: float | None) -> SplitScore:
    row = ClassScore("can", 5, mean_iou, 0, 0, None, None, None)
    return SplitScore(5, mean_iou, None, None, None, None, (row,))


@pytest.fixture(scope="module", autouse=True)
def short_rounds() -> Iterator[None]:
    """One epoch of one source, then one of the other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment, "ROUND_EPOCHS", 1)
        yield


@pytest.fixture(scope="module")
def workspace(tiny_workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A copy: the true labels are exported into it."""
    root = tmp_path_factory.mktemp("segmentation") / "tiny"
    shutil.copytree(tiny_workspace.root, root)
    return Workspace(root)


@pytest.fixture(scope="module")
def command(workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What has made the figure, and would make it again."""
    folder = tmp_path_factory.mktemp("figure")
    preset, out = folder / "quick.yaml", folder / "out"
    preset.write_text(SETTINGS)
    command = ["segmentation", str(workspace.root), "--out", str(out), "--preset", str(preset)]
    assert main(command) == 0
    return command


def test_figure_page_and_numbers(workspace: Workspace, command: list[str]) -> None:
    out = Path(command[3])
    found = json.loads((out / "segmentation.json").read_text())
    assert set(found["scores"]) == {"val", "test"} and set(found["scores"]["test"]) == {"OURS", "MANUAL"}
    assert found["progress"]["epochs"] == 2 and len(found["progress"]["history"]) == 2
    assert found["progress"]["cpu_seconds"] > 0
    assert found["verdict"]["test"]["valid"] is False  # two epochs of eleven images teach nothing
    images = json.loads((workspace.export("coco_truth") / "test.json").read_text())["images"]
    assert found["scores"]["test"]["OURS"]["images"] == len(images) == 6
    assert cv2.imread(str(out / "segmentation.png")) is not None
    page = (out / "segmentation.html").read_text()
    assert "The comparison does not count" in page and page.count("data:image/png") >= 3
    assert main(command) == 0  # nothing is left to train
    assert json.loads((out / "segmentation.json").read_text())["scores"] == found["scores"]


def test_an_interrupted_run_goes_on_as_if_it_had_not_been(
    workspace: Workspace, command: list[str], tmp_path: Path
) -> None:
    """It stops after OURS of the second round, before MANUAL."""
    preset = Path(command[5])
    settings, sources = load_settings(preset), sources_of(workspace.root)
    train_round(sources, settings, Progress(comparable(settings)), tmp_path)
    train_masks(sources["OURS"], tmp_path / "ours", **given(settings), resume=True, until=2)
    segmentation(workspace.root, tmp_path, preset)
    straight, paused = (
        json.loads((f / "segmentation.json").read_text()) for f in (Path(command[3]), tmp_path)
    )
    assert straight["scores"] == paused["scores"]
    assert straight["progress"]["history"] == paused["progress"]["history"]


def test_other_settings_do_not_go_on(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.yaml").write_text(SETTINGS.replace("adamw", "adamw, rate: 0.5"))
    assert main([*command[:5], str(tmp_path / "other.yaml")]) == 1
    assert "other settings" in capsys.readouterr().err


def test_sources_must_have_the_same_images(tiny_workspace: Workspace, tmp_path: Path) -> None:
    shutil.copytree(tiny_workspace.root, tmp_path / "tiny")
    sources = sources_of(tmp_path / "tiny")
    data = json.loads((sources["MANUAL"] / "train.json").read_text())
    gone = data["images"].pop()["id"]
    data["annotations"] = [a for a in data["annotations"] if a["image_id"] != gone]
    (sources["MANUAL"] / "train.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match="other training images"):
        sources_of(tmp_path / "tiny")


def test_the_comparison_counts_from_half_on() -> None:
    counted = verdict({"OURS": scored(0.56), "MANUAL": scored(0.6)})
    assert counted["valid"] and counted["within_5_points"]
    assert counted["ours_minus_manual_points"] == pytest.approx(-4)
    assert not verdict({"OURS": scored(0.54), "MANUAL": scored(0.6)})["within_5_points"]
    assert not verdict({"OURS": scored(0.49), "MANUAL": scored(0.49)})["valid"]
    assert verdict({"OURS": scored(None), "MANUAL": scored(None)})["ours_minus_manual_points"] is None


def test_a_random_backbone_is_not_frozen() -> None:
    papers = MaskSettings()
    scratch, others = with_weights(papers, "scratch"), with_weights(papers, "resnet101.pth")
    assert (scratch.weights, scratch.head_epochs) == ("scratch", 0)
    assert (others.weights, others.head_epochs) == ("resnet101.pth", papers.head_epochs)
