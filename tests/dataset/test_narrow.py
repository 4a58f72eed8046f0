"""Datasets filtered, split anew, and counted."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from labelled_scenes import BOX, CAN, exported, labelled_scene
from pycocotools.coco import COCO

from rpl_data.dataset import Wanted, convert_dataset, dataset_stats, filter_dataset, split_dataset
from rpl_data.dataset.stats_table import stats_table
from rpl_data.export import ExportScene, export_coco
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import read_coco
from rpl_data.types import DataError


@pytest.fixture(scope="module")
def three_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three scenes of six frames at 30 Hz; the first frame of each shows nothing."""
    root = tmp_path_factory.mktemp("three")
    made = [labelled_scene(root / "recording", name, seed=10 * n) for n, name in enumerate("xyz")]
    scenes = [ExportScene(each.scene, each.trajectory, each.labels) for each in made]
    export_coco(root / "coco", scenes, [BOX, CAN], split=SplitRule(("z",), 0.0))
    return root / "coco"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("scene", "../../outside"),
        ("file_name", "../ra/desk/c1.png"),
        ("depth_file_name", "/etc/hostname"),
    ],
)
def test_a_dataset_of_others_reaches_nothing_outside(tmp_path: Path, key: str, value: str) -> None:
    folder = exported(tmp_path)
    data = json.loads((folder / "train.json").read_text())
    data["images"][1][key] = value
    (folder / "train.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match="outside the dataset|cannot be the name of a scene"):
        filter_dataset(tmp_path / "work/deep/out", folder, Wanted())
    assert {path.name for path in tmp_path.iterdir()} <= {"recording", "coco", "work"}
    assert not (tmp_path / "work/outside").exists() and not (tmp_path / "work/deep/out").exists()


def test_chosen_objects_are_numbered_anew(three_scenes: Path, tmp_path: Path) -> None:
    written = filter_dataset(tmp_path / "out", three_scenes, Wanted(objects=("can",), scenes=("x", "z")))
    assert written.images == {"train": 5, "test": 5}  # without the frame that shows nothing
    data = read_coco(tmp_path / "out/train.json")
    assert [(c["id"], c["name"]) for c in data["categories"]] == [(1, "can")]
    assert {a["category_id"] for a in data["annotations"]} == {1}
    assert len(COCO(str(tmp_path / "out/test.json")).getAnnIds(catIds=[1])) == 5


def test_a_rate_keeps_the_first_frame_of_every_period(three_scenes: Path, tmp_path: Path) -> None:
    filter_dataset(tmp_path / "out", three_scenes, Wanted(rate_hz=10.0, scenes=("y",)))
    frames = [image["frame"] for image in read_coco(tmp_path / "out/train.json")["images"]]
    assert frames == [0, 3]  # of 0 to 5 at 30 Hz


def test_hidden_instances_are_ignored_not_forgotten(three_scenes: Path, tmp_path: Path) -> None:
    data = json.loads((three_scenes / "train.json").read_text())
    low = [a for a in data["annotations"] if a["category_id"] == 1 and a["visib_fract"] < 0.51]
    written = filter_dataset(tmp_path / "out", three_scenes, Wanted(min_visibility=0.51))
    assert low and any("iscrowd" in line or "each object" in line for line in written.messages)
    kept = json.loads((tmp_path / "out/train.json").read_text())["annotations"]
    assert all(a["iscrowd"] == int(a["visib_fract"] < 0.51) for a in kept)
    read_coco(tmp_path / "out/train.json")  # our own reader takes it, crowds apart
    convert_dataset(tmp_path / "each", tmp_path / "out", "coco_per_object")
    for number, name in enumerate(("box", "can"), start=1):
        mine = [a | {"category_id": 1} for a in kept if a["category_id"] == number]
        alone = json.loads((tmp_path / "each" / name / "train.json").read_text())["annotations"]
        assert sorted(alone, key=lambda a: a["id"]) == mine


def test_quality_leaves_out_whole_images(three_scenes: Path, tmp_path: Path) -> None:
    with_all = filter_dataset(tmp_path / "all", three_scenes, Wanted(min_quality=0.75))
    assert sum(with_all.images.values()) == 18
    written = filter_dataset(tmp_path / "none", three_scenes, Wanted(min_quality=0.76))
    assert sum(written.images.values()) == 3  # the frames that show nothing
    assert "left out: 15 images with a label of a quality below 0.76" in written.messages[0]


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ({"objects": ("cup",)}, "no object cup in the dataset; it has box, can"),
        ({"scenes": ("q",)}, "no scene q in the dataset; it has x, y, z"),
        ({"rate_hz": 0.0}, "positive number of images per second"),
        ({"min_visibility": 1.5}, "min_visibility must be 0 to 1"),
    ],
)
def test_what_cannot_be_is_said(three_scenes: Path, tmp_path: Path, wanted: dict, said: str) -> None:
    with pytest.raises(DataError, match=said):
        filter_dataset(tmp_path / "out", three_scenes, Wanted(**wanted))
    assert not list(tmp_path.iterdir())


def test_split_anew_keeps_every_image_and_no_scene_on_both_sides(three_scenes: Path, tmp_path: Path) -> None:
    written = split_dataset(tmp_path / "out", three_scenes, SplitRule(("x",), 0.2, seed=3))
    assert written.images == {"train": 10, "val": 2, "test": 6}
    scenes = {
        name: {image["scene"] for image in read_coco(tmp_path / f"out/{name}.json")["images"]}
        for name in written.images
    }
    assert scenes["test"] == {"x"} and scenes["train"] | scenes["val"] == {"y", "z"}
    again = split_dataset(tmp_path / "again", three_scenes, SplitRule(("x",), 0.2, seed=3))
    assert again.content_hash == written.content_hash


def test_an_object_that_is_only_to_be_ignored_in_a_scene_is_not_tested_there(
    three_scenes: Path, tmp_path: Path
) -> None:
    shutil.copytree(three_scenes, tmp_path / "in")
    data = json.loads((tmp_path / "in/train.json").read_text())
    can = next(each["id"] for each in data["categories"] if each["name"] == "can")
    shown = {image["id"] for image in data["images"] if image["scene"] == "x"}
    for label in data["annotations"]:
        label["iscrowd"] = int(label["category_id"] == can and label["image_id"] in shown)
    (tmp_path / "in/train.json").write_text(json.dumps(data))
    written = split_dataset(tmp_path / "out", tmp_path / "in", SplitRule(("x",), 0.0))
    assert any(line.startswith("no test scene for can") for line in written.messages)


def test_counts_are_those_of_the_files(three_scenes: Path, tmp_path: Path) -> None:
    found = dataset_stats(three_scenes)
    assert found["images"] == {"train": 12, "test": 6} and found["as_recorded"] is None
    assert found["scenes"]["x"] == {"split": ["train"], "images": 6, "instances": {"box": 5, "can": 5}}
    box = found["objects"]["box"]
    assert box["instances"] == 15 and box["scenes"] == 3
    assert box["keypoints"] == {"seen": 0.5, "hidden": 0.25, "unlabelled": 0.25}
    assert box["distance_m"]["least"] == pytest.approx(1.04**0.5, abs=1e-3)
    assert 0 < box["views"]["covered"] < 0.2 and box["views"]["widest_gap_deg"] > 90
    assert any(line.startswith("box") for line in stats_table(found))


def test_nothing_of_others_is_lost_where_a_dataset_is_written(three_scenes: Path, tmp_path: Path) -> None:
    """Many programs have a file of that name, and people put their notes beside a result."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "photo.jpg").write_bytes(b"dear")
    for content, why in (
        ('{"title": "photos"}', "is no dataset that `rpl dataset` wrote"),
        ("[]", "dataset.json is damaged"),
        ('{"content_hash": 1}', "dataset.json is damaged"),
    ):
        (out / "dataset.json").write_text(content)
        with pytest.raises(DataError, match=why):
            filter_dataset(out, three_scenes, Wanted(scenes=("x",)))
        assert (out / "photo.jpg").read_bytes() == b"dear"
    written = tmp_path / "written"
    filter_dataset(written, three_scenes, Wanted(scenes=("x",)))
    (written / "notes.txt").write_text("dear")
    with pytest.raises(DataError, match=r"edited since `rpl dataset` wrote it \(see notes.txt\)"):
        filter_dataset(written, three_scenes, Wanted(scenes=("x",)))
    assert (written / "notes.txt").read_text() == "dear"


def test_a_changed_dataset_is_noticed_and_not_replaced(three_scenes: Path, tmp_path: Path) -> None:
    for _ in range(2):  # as it was written, it is replaced
        filter_dataset(tmp_path / "out", three_scenes, Wanted(scenes=("x",)), images="copy")
    assert dataset_stats(tmp_path / "out")["as_recorded"] is True
    next((tmp_path / "out/images").rglob("*.png")).write_bytes(b"gone")
    assert dataset_stats(tmp_path / "out")["as_recorded"] is False
    with pytest.raises(DataError, match="out was edited since `rpl dataset` wrote it"):
        filter_dataset(tmp_path / "out", three_scenes, Wanted(scenes=("x",)), images="copy")


def test_a_dataset_is_converted_with_its_splits(three_scenes: Path, tmp_path: Path) -> None:
    written = convert_dataset(tmp_path / "yolo", three_scenes, "yolo")
    assert written.images == {"train": 12, "test": 6}
    labels = tmp_path / "yolo/detect/labels"
    for split in ("train", "test"):
        expected = len(read_coco(three_scenes / f"{split}.json")["annotations"])
        lines = [line for file in (labels / split).iterdir() for line in file.read_text().splitlines()]
        assert len(lines) == expected > 0
    with pytest.raises(DataError, match="exists and is not replaced"):
        convert_dataset(tmp_path / "yolo", three_scenes, "yolo")
    with pytest.raises(DataError, match="not converted to bop; expected one of yolo"):
        convert_dataset(tmp_path / "bop", three_scenes, "bop")
    with pytest.raises(DataError, match="one lies in the other"):
        convert_dataset(three_scenes / "yolo", three_scenes, "yolo")
