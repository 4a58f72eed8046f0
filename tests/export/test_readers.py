"""Formats of other readers: shards, image folders, posed images."""

from __future__ import annotations

import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from labelled_scenes import BOX, CAN, labelled_scene
from pycocotools import mask as masks
from pycocotools.coco import COCO
from scipy.spatial.transform import Rotation

from rpl_data.export import (
    ExportScene,
    export_coco,
    export_coco_per_object,
    export_huggingface,
    export_nerfstudio,
    export_webdataset,
)
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import read_coco
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Intrinsics

LENS = Intrinsics(150.0, 151.0, 79.5, 59.5, 160, 120, (0.1, -0.02, 0.001, 0.002))


def exported(root: Path, lens: Intrinsics) -> Path:
    """One scene of six frames, all for training."""
    made = labelled_scene(root / "recording", "desk")
    scene = ExportScene(replace(made.scene, intrinsics=lens), made.trajectory, made.labels)
    export_coco(root / "coco", [scene], [BOX, CAN], split=SplitRule(0, 0.0))
    return root / "coco"


@pytest.fixture(scope="module")
def coco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("readers"), LENS)


def test_shards_hold_each_image_with_its_labels(coco: Path, tmp_path: Path) -> None:
    summary = export_webdataset(tmp_path / "shards", coco)
    data = read_coco(coco / "train.json")
    with tarfile.open(tmp_path / "shards/train-000000.tar") as tar:
        content = {name: tar.extractfile(name).read() for name in tar.getnames()}  # type: ignore[union-attr]
    keys = list(dict.fromkeys(name.split(".")[0] for name in content))
    assert len(keys) == summary.images["train"] == len(data["images"]) == 6
    assert [name.split(".")[0] for name in content] == [key for key in keys for _ in range(4)]  # together
    for key in keys:
        record = json.loads(content[f"{key}.json"])
        mine = [a for a in data["annotations"] if a["image_id"] == record["id"]]
        assert record["annotations"] == mine
        numbered = cv2.imdecode(np.frombuffer(content[f"{key}.mask.png"], np.uint8), -1)
        for number, one in enumerate(mine, start=1):
            np.testing.assert_array_equal(numbered == number, masks.decode(one["segmentation"]) > 0)
        assert content[f"{key}.depth.png"] == (coco / record["depth_file_name"]).read_bytes()
    export_webdataset(tmp_path / "again", coco)
    one, other = (tmp_path / f"{name}/train-000000.tar" for name in ("shards", "again"))
    assert one.read_bytes() == other.read_bytes()


def test_a_file_per_object_has_one_skeleton(coco: Path, tmp_path: Path) -> None:
    summary = export_coco_per_object(tmp_path / "each", coco)
    everything = read_coco(coco / "train.json")
    count = 0
    for number, name in enumerate(("box", "can"), start=1):
        data = read_coco(tmp_path / f"each/{name}/train.json")
        assert [(c["id"], c["name"]) for c in data["categories"]] == [(1, name)]
        mine = [a | {"category_id": 1} for a in everything["annotations"] if a["category_id"] == number]
        assert data["annotations"] == mine and data["images"] == everything["images"]
        assert all((tmp_path / "each" / name / image["file_name"]).is_file() for image in data["images"])
        assert COCO(str(tmp_path / f"each/{name}/train.json")).getCatIds() == [1]
        count += len(mine)
    assert summary.instances == count and summary.images == {"train": 12}


def test_an_image_folder_with_metadata(coco: Path, tmp_path: Path) -> None:
    export_huggingface(tmp_path / "hf", coco)
    place = tmp_path / "hf/train"
    lines = [json.loads(line) for line in io.StringIO((place / "metadata.jsonl").read_text())]
    data = read_coco(coco / "train.json")
    assert len(lines) == 6 and all((place / line["file_name"]).is_file() for line in lines)
    for line in lines:
        mine = [a for a in data["annotations"] if a["image_id"] == line["image_id"]]
        assert {len(column) for column in line["objects"].values()} == {len(mine)}
        assert line["objects"]["bbox"] == [one["bbox"] for one in mine]
    names = json.loads((tmp_path / "hf/categories.json").read_text())["categories"]
    assert names == ["box", "can"]


def test_posed_images_agree_with_the_labels(coco: Path, tmp_path: Path) -> None:
    """A point of the scene, by both layouts' own rules and by OpenCV with our camera: the same pixel."""
    export_nerfstudio(tmp_path / "nerf", coco, {"desk": 0.001})
    place = tmp_path / "nerf/desk"
    said = json.loads((place / "transforms.json").read_text())
    data = read_coco(coco / "train.json")
    poses = [line for line in (place / "sparse/0/images.txt").read_text().splitlines() if line]
    for image, frame, line in zip(data["images"], said["frames"], poses, strict=True):
        scene_from_camera = np.reshape(image["scene_from_camera"], (4, 4))
        point = scene_from_camera @ [0.03, -0.02, 0.5, 1.0]
        in_gl = np.linalg.inv(np.array(frame["transform_matrix"])) @ point
        w, x, y, z, *t = map(float, line.split()[1:8])
        in_colmap = Rotation.from_quat([x, y, z, w]).apply(point[:3]) + t
        np.testing.assert_allclose(in_gl[:3] * [1, -1, -1], in_colmap, atol=1e-9)
        np.testing.assert_allclose(in_colmap, [0.03, -0.02, 0.5], atol=1e-9)
        assert (place / "images" / line.split()[-1]).samefile(place / frame["file_path"])
    words = (place / "sparse/0/cameras.txt").read_text().split()
    assert words[:4] == ["1", "OPENCV", "160", "120"]
    np.testing.assert_allclose(list(map(float, words[4:])), [150, 151, 80, 60, *LENS.distortion])
    assert [said[k] for k in ("fl_x", "cx", "cy", "k1", "p2")] == [150, 80, 60, 0.1, 0.002]


def test_our_own_reader_finds_the_camera_and_the_poses_again(coco: Path, tmp_path: Path) -> None:
    export_nerfstudio(tmp_path / "nerf", coco, {"desk": 0.001})
    (found,) = open_scenes(tmp_path / "nerf", "nerfstudio", unpack=(tmp_path / "unpacked").joinpath)
    assert replace(found.scene.intrinsics, distortion=found.scene.intrinsics.distortion[:4]) == LENS
    images = read_coco(coco / "train.json")["images"]
    given = np.reshape([image["scene_from_camera"] for image in images], (-1, 4, 4))
    assert found.trajectory is not None
    np.testing.assert_allclose(found.trajectory.scene_from_camera, given, atol=1e-9)


def test_a_lens_of_five_coefficients_is_refused(tmp_path: Path) -> None:
    coco = exported(tmp_path, replace(LENS, distortion=(0.1, 0.0, 0.0, 0.0, 0.05)))
    with pytest.raises(DataError, match="more than four coefficients"):
        export_nerfstudio(tmp_path / "nerf", coco, {"desk": 0.001})
    assert not (tmp_path / "nerf").exists()
