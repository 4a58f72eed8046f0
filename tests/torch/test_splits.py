"""Datasets take the folder of an export and a split, and say why a split is not there."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from labelled_scenes import exported

from rpl_data.torch import DetectionDataset, InstanceDataset, KeypointDataModule, KeypointDataset
from rpl_data.torch.splits import split_file
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


@pytest.fixture(scope="module")
def two_scenes(tmp_path_factory: pytest.TempPathFactory, tiny_workspace: Workspace) -> Path:
    """The tiny export as if the test scene had never been recorded."""
    folder = tmp_path_factory.mktemp("two") / "coco"
    shutil.copytree(tiny_workspace.export("coco"), folder)
    (folder / "test.json").unlink()
    return folder


@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_a_folder_and_a_split_are_the_file(tiny_workspace: Workspace, split: str) -> None:
    coco = tiny_workspace.export("coco")
    count = len(json.loads((coco / f"{split}.json").read_text())["images"])
    for make in (KeypointDataset, InstanceDataset, DetectionDataset):
        assert len(make(str(coco), split=split)) == len(make(coco / f"{split}.json")) == count


def test_a_datamodule_takes_text(tiny_workspace: Workspace) -> None:
    data = KeypointDataModule(str(tiny_workspace.export("coco")), input_px=32, heatmap_px=8)
    assert len(data.train) == 11 and data.val is not None and len(data.val) == 1


def test_two_scenes_give_no_test_split(two_scenes: Path) -> None:
    why = r"no test split: it takes whole scenes .* come from only 2 scenes; record at least 3\. It has"
    with pytest.raises(DataError, match=why):
        KeypointDataset(two_scenes, split="test")
    with pytest.raises(DataError, match=why):
        InstanceDataset(two_scenes / "test.json")


def test_no_test_scene_was_asked_for(two_scenes: Path, tmp_path: Path) -> None:
    folder = tmp_path / "coco"
    shutil.copytree(two_scenes, folder)
    data = json.loads((folder / "train.json").read_text())
    data["images"][0]["scene"] = "another"
    (folder / "train.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match="asked for no test scene .* or none could be spared"):
        split_file(folder, "test")


def test_rendered_images_are_to_train_on(two_scenes: Path, tmp_path: Path) -> None:
    data = json.loads((two_scenes / "train.json").read_text())
    for image in data["images"]:
        image["origin"] = "synthetic"
    (tmp_path / "train.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match="no test split: `rpl synthesize` renders images to train on; take"):
        split_file(tmp_path, "test")


def test_what_is_wrong_with_the_place_is_said(tiny_workspace: Workspace, tmp_path: Path) -> None:
    coco = tiny_workspace.export("coco")
    for path, split, message in [
        (coco, None, "is a folder; say which split, one of train, val, test: split='train'"),
        (coco, "trian", "no trian split: the names are train, val and test"),
        (coco / "train.json", "train", "give its folder, or leave split='train' out"),
        (tiny_workspace.root, "train", "holds no exported dataset .*; give .*export/coco"),
        (tmp_path, "train", "holds no exported dataset .*; make it with `rpl build`"),
        (tmp_path / "nowhere", "train", "nowhere does not exist"),
    ]:
        with pytest.raises(DataError, match=message):
            split_file(path, split)


def test_no_validation_was_asked_for(tmp_path: Path) -> None:
    coco = exported(tmp_path)
    for name in ("val", "test"):
        (coco / f"{name}.json").unlink(missing_ok=True)
    with pytest.raises(DataError, match="no val split: the recipe asked for none"):
        split_file(coco, "val")


@pytest.mark.parametrize("dataset", [KeypointDataset, InstanceDataset])
def test_the_help_is_what_a_sample_holds(tiny_workspace: Workspace, dataset: type) -> None:
    """Every key with its type and its number of axes, as the table in the class's help has them."""
    sample = dataset(tiny_workspace.export("coco"), split="train")[0]
    fields = sample if isinstance(sample, dict) else sample[1]
    assert dataset.__doc__ is not None
    rows = [re.split("  +", line.strip()) for line in dataset.__doc__.splitlines()]
    table = {row[0]: row for row in rows if len(row) >= 3}
    for key, value in fields.items():
        columns = table[key]
        if isinstance(value, int):
            assert columns[1] == "int"
            continue
        assert columns[1] == str(value.dtype).removeprefix("torch."), key
        assert len(columns[2].split(",")) == value.ndim, key
