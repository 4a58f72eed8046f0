"""Scenes held out of the training split: named, the same every time, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest
from labelled_scenes import BOX, CAN, labelled_scene

from rpl_data.export import export_coco
from rpl_data.export.split import SplitRule
from rpl_data.files import read_json, write_json
from rpl_data.torch import InstanceDataset, KeypointDataset
from rpl_data.torch.datamodule import KeypointDataModule
from rpl_data.torch.detection import DetectionDataset
from rpl_data.torch.scenes import hold_out_scenes
from rpl_data.types import DataError


@pytest.fixture(scope="module")
def coco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Boxes in the scenes a, b and c, cans in a and b; some frames are for validation."""
    folder = tmp_path_factory.mktemp("scenes")
    shown = {"a": (BOX, CAN), "b": (BOX, CAN), "c": (BOX,)}
    scenes = [
        labelled_scene(folder / "recording", name, objects=objects, seed=number)
        for number, (name, objects) in enumerate(shown.items())
    ]
    export_coco(folder / "coco", scenes, [BOX, CAN], split=SplitRule(test_scenes=0, val_fraction=0.4))
    return folder / "coco"


def scenes_of(dataset: KeypointDataset | None) -> set[str]:
    assert dataset is not None
    return {place.rpartition("/")[0] for place in dataset._rows.places.tolist()}


def test_unseen_scenes_are_nowhere_in_training(coco: Path) -> None:
    data = KeypointDataModule(coco, object="box", validate_scenes=1, input_px=32, heatmap_px=8)
    assert data.scenes == (("a", "b"), ("c",))
    assert scenes_of(data.train) == {"a", "b"} and scenes_of(data.unseen) == {"c"}
    assert "c" not in scenes_of(data.val)  # where its random frames would be neighbours of unseen ones
    assert isinstance(data.val_dataloader(), list) and data.unseen is not None and data.unseen.augment is None
    whole = len(KeypointDataset(coco, split="train", object="box"))
    assert len(data.train) + len(data.unseen) == whole
    for kind in (InstanceDataset, DetectionDataset):
        kept = [len(kind(coco, split="train", scenes=each)) for each in (("a", "b"), ("c",), None)]
        assert kept[0] + kept[1] == kept[2] and min(kept) > 0


def test_every_object_keeps_a_scene(coco: Path) -> None:
    assert hold_out_scenes(coco, 0) == (None, ())
    assert hold_out_scenes(coco, 2) == (("a",), ("b", "c"))
    assert hold_out_scenes(coco, 1, object="can") == (("a",), ("b",))
    with pytest.raises(DataError, match="of the 2 training scenes in .* only 1 can be held out"):
        hold_out_scenes(coco, 2, object="can")
    with pytest.raises(DataError, match="give 0 or more"):
        hold_out_scenes(coco, -1)


def test_rendered_images_show_all_scenes_so_none_is_held_out(coco: Path, tmp_path: Path) -> None:
    data = read_json(coco / "train.json")
    data["images"][0]["origin"] = "synthetic"
    write_json(tmp_path / "train.json", data)
    with pytest.raises(DataError, match="none would be unseen"):
        hold_out_scenes(tmp_path, 1)
