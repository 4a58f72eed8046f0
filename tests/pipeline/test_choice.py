"""Exports of fewer labels than the recipe's own: other folders, the same splits."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from labelled_scenes import BOX, CAN, instance

from rpl_data.cli.main import main
from rpl_data.pipeline.build import context_of, fresh_steps
from rpl_data.pipeline.choice import ExportChoice, splits_like
from rpl_data.pipeline.stages.export import export_chosen
from rpl_data.types import DataError, FrameLabel
from rpl_data.workspace.workspace import Workspace


def frames_of(file: Path) -> set[tuple[str, int]]:
    return {(image["scene"], image["frame"]) for image in json.loads(file.read_text())["images"]}


def test_one_split_of_one_object_goes_to_a_folder_of_its_own(
    tiny_workspace: Workspace, capsys: pytest.CaptureFixture[str]
) -> None:
    context = context_of(tiny_workspace)
    (name, *_) = context.object_names
    before = {path: path.read_bytes() for path in tiny_workspace.export("coco").glob("*.json")}
    at = ["--workspace", str(tiny_workspace.root)]
    assert main(["export", "--format", "yolo", "--object", name, "--split", "val", *at]) == 0
    folder = tiny_workspace.export(f"only_object-{name}_split-val")
    assert f"{folder / 'yolo'}: " in capsys.readouterr().out
    assert not (folder / "coco/train.json").exists() and (folder / "yolo/pose/labels/val").is_dir()
    assert frames_of(folder / "coco/val.json") == frames_of(tiny_workspace.export("coco") / "val.json")
    data = json.loads((folder / "coco/val.json").read_text())
    assert [item["name"] for item in data["categories"]] == [name]
    assert before == {path: path.read_bytes() for path in tiny_workspace.export("coco").glob("*.json")}
    assert "export/coco" in fresh_steps(context.recipe, tiny_workspace)


def test_what_cannot_be_chosen_is_refused(
    tiny_workspace: Workspace, capsys: pytest.CaptureFixture[str]
) -> None:
    context = context_of(tiny_workspace)
    for choice, message in (
        (ExportChoice(object="cup"), "there is no object 'cup' to export; the recipe has "),
        (ExportChoice(min_quality=1.5), r"must be in \[0, 1\)"),
        (ExportChoice(min_quality=0.999999), "would be left out"),
        (ExportChoice(color="png"), "as they were recorded; --color is for bop, bop_onboarding"),
    ):
        with pytest.raises(DataError, match=message):
            export_chosen(context, "coco", choice)
    for name in ("yolo", "coco"):
        with pytest.raises(DataError, match=f"{name} has colour images as they were recorded"):
            export_chosen(context, name, ExportChoice(color="png"))
    for name in ("bop_onboarding", "foundationpose"):
        with pytest.raises(DataError, match="no training images"):
            export_chosen(context, name, ExportChoice(split="val"))
    left = [path.name for path in (tiny_workspace.root / "export").glob("only_*") if not any(path.iterdir())]
    assert not left, "a refused export leaves an empty folder"
    assert main(["export", "--split", "val", "--workspace", str(tiny_workspace.root)]) == 1
    assert "add `--format`" in capsys.readouterr().err


def test_frames_that_the_recipe_left_out_never_train_in_a_test_scene() -> None:
    split_of = splits_like({("a", 0): "train", ("a", 1): "val", ("b", 0): "test"})
    asked = [("a", 0), ("a", 1), ("a", 7), ("b", 0), ("b", 7), ("c", 7)]
    assert [split_of(frame) for frame in asked] == ["train", "val", "train", "test", "test", "train"]


def test_labels_of_other_objects_and_splits_are_dropped() -> None:
    labels = [FrameLabel("a", n, 0.0, (instance(BOX, 0.0), instance(CAN, 0.2))) for n in range(4)]
    split_of = splits_like({("a", 1): "val", ("a", 3): "val"})
    chosen = list(ExportChoice(object="can", split="val").chosen(labels, split_of))
    assert [(one.frame, [item.object for item in one.instances]) for one in chosen] == [
        (1, ["can"]),
        (3, ["can"]),
    ]
    assert list(ExportChoice().chosen(labels, split_of)) == labels
