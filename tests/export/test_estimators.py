"""What model-free estimators read: files as their readers find them, poses and depth that fit together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from labelled_scenes import BOX, CAMERA, CAN, labelled_scene

from rpl_data.export import ExportScene, export_bundlesdf, export_coco, export_foundationpose
from rpl_data.export.dialect import splits_of
from rpl_data.export.foundationpose import reference_views
from rpl_data.export.split import SplitRule
from rpl_data.export.views import View, views_of, write_view
from rpl_data.types import DataError

PLAIN = CAMERA.__class__(150.0, 151.0, 79.5, 59.5, 160, 120)
UNITS = {"a": 0.001, "b": 0.0002}


@pytest.fixture(scope="module")
def coco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of six frames; scene b is for test."""
    root = tmp_path_factory.mktemp("estimators")
    scenes = []
    for seed, name in enumerate(UNITS):
        made = labelled_scene(root / "recording", name, seed=seed)
        scene = made.scene.__class__(name, PLAIN, UNITS[name], made.scene.frames)
        scenes.append(ExportScene(scene, made.trajectory, made.labels))
    export_coco(root / "coco", scenes, [BOX, CAN], split=SplitRule(("b",), 0.0))
    return root / "coco"


def test_reference_views_as_their_reader_finds_them(coco: Path, tmp_path: Path) -> None:
    folder = tmp_path / "views"
    summary = export_foundationpose(folder, coco, UNITS)
    data = json.loads((coco / "train.json").read_text())
    assert json.loads((folder / "names.json").read_text()) == {"ob_0000001": "box", "ob_0000002": "can"}
    written = 0
    for category in data["categories"]:
        place = folder / f"ob_{category['id']:07d}"
        np.testing.assert_allclose(np.loadtxt(place / "K.txt"), PLAIN.matrix)
        chosen = yaml.safe_load((place / "select_frames.yml").read_text())["frames"]
        colors = sorted((place / "rgb").glob("*.png"))
        assert len(colors) == len(chosen) == len(set(chosen))
        for color, source in zip(colors, chosen, strict=True):
            scene, frame = source.split("/")
            assert scene == "a"  # never a test scene
            image = next(i for i in data["images"] if (i["scene"], i["frame"]) == (scene, int(frame)))
            label = next(
                a
                for a in data["annotations"]
                if (a["image_id"], a["category_id"]) == (image["id"], category["id"])
            )
            other = {
                kind: str(color).replace("rgb", kind) for kind in ("depth_enhanced", "mask", "cam_in_ob")
            }
            pose = np.loadtxt(other["cam_in_ob"].replace(".png", ".txt"))
            np.testing.assert_allclose(
                pose @ np.reshape(label["camera_from_object"], (4, 4)), np.eye(4), atol=1e-8
            )
            depth, mask = (cv2.imread(other[kind], -1) for kind in ("depth_enhanced", "mask"))
            assert depth.dtype == np.uint16 and depth.shape == mask.shape == (120, 160)
            np.testing.assert_array_equal(depth, cv2.imread(str(coco / image["depth_file_name"]), -1))
            assert set(np.unique(mask)) == {0, 255} and (mask > 0).sum() == label["area"]
            written += 1
    assert written == summary.instances


def test_videos_hold_every_frame_of_a_scene(coco: Path, tmp_path: Path) -> None:
    folder = tmp_path / "videos"
    summary = export_bundlesdf(folder, coco, UNITS)
    data = json.loads((coco / "test.json").read_text())
    boxes = [a for a in data["annotations"] if a["category_id"] == 1]
    place = folder / "box" / "b"
    assert len(list((place / "rgb").iterdir())) == len(boxes) == len(list((place / "masks").iterdir()))
    image = next(i for i in data["images"] if i["id"] == boxes[0]["image_id"])
    name = f"{image['frame']:06d}"
    depth = cv2.imread(str(place / "depth" / f"{name}.png"), -1)
    raw = cv2.imread(str(coco / image["depth_file_name"]), -1)
    np.testing.assert_array_equal(depth, np.rint(raw * 0.2))  # 0.2 mm a unit
    pose = np.loadtxt(place / "annotated_poses" / f"{name}.txt")
    np.testing.assert_allclose(pose.ravel(), np.ravel(boxes[0]["camera_from_object"]), atol=1e-8)
    assert sum(summary.images.values()) == summary.instances


def test_saturated_depth_becomes_none_not_sixteen_metres(coco: Path, tmp_path: Path) -> None:
    train = next(splits_of(coco))
    (view, *_) = views_of(train, 1)
    color, depth = (tmp_path / name for name in ("color.png", "depth.png"))
    raw = np.full((120, 160), 4000, np.uint16)
    raw[0] = 65535
    cv2.imwrite(str(color), np.zeros((120, 160, 3), np.uint8))
    cv2.imwrite(str(depth), raw)
    image = view.image | {"file_name": "color.png", "depth_file_name": "depth.png", "scene": "a"}
    written = {kind: tmp_path / f"out/{kind}.png" for kind in ("color", "depth", "mask")}
    write_view(replace(view, image=image), tmp_path, **written, metres_per_unit={"a": 0.00025})
    found = cv2.imread(str(written["depth"]), -1)
    assert not found[0].any() and (found[1:] == 1000).all()


def _seen_from(direction: np.ndarray, *, quality: float = 0.8, width: int = 160) -> View:
    pose = np.eye(4)
    pose[:3, 3] = direction
    image = {
        "cam_K": [150.0, 0, 79.5, 0, 150.0, 59.5, 0, 0, 1],
        "width": width,
        "height": 120,
        "distortion": [],
    }
    return View(image, {"visib_fract": 1.0, "quality": quality}, pose)


def test_views_are_spread_and_of_one_camera() -> None:
    ring = np.radians(np.arange(0, 360, 1))
    around = [_seen_from(np.array([np.cos(a), np.sin(a), 0.0])) for a in ring]
    chosen = reference_views([*around, *[_seen_from(np.array([0, 0, 1.0]), width=80)] * 5], most=8)
    angles = np.sort([np.degrees(np.arctan2(*view.direction[1::-1])) % 360 for view in chosen])
    assert np.diff([*angles, angles[0] + 360]).min() >= 40 and all(v.camera.width == 160 for v in chosen)


def test_a_poor_label_is_taken_last() -> None:
    poor = [_seen_from(np.array([1.0, 0.01 * n, 0]), quality=0.05) for n in range(3)]
    good = [_seen_from(np.array([0.0, 1.0, 0.02 * n])) for n in range(3)]
    assert [view.annotation["quality"] for view in reference_views([*poor, *good], most=3)].count(0.8) >= 2


def test_a_path_that_leads_the_readers_astray_is_refused(coco: Path, tmp_path: Path) -> None:
    for export in (export_foundationpose, export_bundlesdf):
        with pytest.raises(DataError, match="replace `rgb` anywhere"):
            export(tmp_path / "rgb_views", coco, UNITS)
    assert not list(tmp_path.iterdir())


def test_images_without_depth_are_no_views(coco: Path) -> None:
    train = next(splits_of(coco))
    for image in train.images:
        image["depth_file_name"] = None
    assert views_of(train, 1) == []
