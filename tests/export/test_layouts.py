"""Layouts of older datasets, read by our own reader and, by hand, as their loaders read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from labelled_scenes import BOX, CAMERA, CAN, labelled_scene
from pycocotools import mask as masks
from scipy.io import loadmat

from rpl_data.evaluate.truth import box_mesh
from rpl_data.export import ExportScene, export_coco, export_linemod, export_ycb_video
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import read_coco
from rpl_data.formats.recordings.ycb_video import read_ycb_video
from rpl_data.geometry import from_rotvec
from rpl_data.meshes import save_mesh
from rpl_data.types import DataError, Trajectory

PLAIN = CAMERA.__class__(150.0, 151.0, 79.5, 59.5, 160, 120)
UNITS = {"a": 0.001, "b": 0.0002}


@pytest.fixture(scope="module")
def coco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes whose camera moves; scene b is for test, in another depth unit and with JPEGs."""
    root = tmp_path_factory.mktemp("layouts")
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.05)])
    save_mesh(root / "box.ply", box_mesh(corners))
    scenes = []
    for seed, name in enumerate(UNITS):
        made = labelled_scene(root / "recording", name, seed=seed, suffix=(".png", ".jpg")[seed])
        moves = [from_rotvec(np.array([0.0, 0.1 * n, 0.0]), np.array([0.01 * n, 0, 0])) for n in range(6)]
        scene = replace(made.scene, intrinsics=PLAIN, metres_per_unit=UNITS[name])
        scenes.append(ExportScene(scene, Trajectory(np.arange(6), np.array(moves)), made.labels))
    meshes = {"box": root / "box.ply"}
    export_coco(root / "coco", scenes, [BOX, CAN], split=SplitRule(("b",), 0.0), meshes=meshes)
    return root / "coco"


def test_ycb_video_reads_back(coco: Path, tmp_path: Path) -> None:
    summary = export_ycb_video(tmp_path / "ycb", coco, UNITS)
    empty, without_model = summary.messages
    assert empty.startswith("2 images without an object: in data/, but in no list")
    assert without_model == "can has no dense model, so no models/can"
    recordings = read_ycb_video(tmp_path / "ycb")
    labels = 0
    for split, recording, name in zip(("train", "test"), recordings, UNITS, strict=True):
        data = read_coco(coco / f"{split}.json")
        images = {image["id"]: image for image in data["images"]}
        assert (recording.scene.intrinsics, recording.scene.metres_per_unit) == (PLAIN, UNITS[name])
        assert [frame.index for frame in recording.scene.frames] == [1, 2, 3, 4, 5, 6]
        given = np.reshape([image["scene_from_camera"] for image in data["images"]], (-1, 4, 4))
        assert recording.trajectory is not None and recording.skipped == ()
        np.testing.assert_allclose(recording.trajectory.scene_from_camera, given, atol=1e-12)
        for one in data["annotations"]:
            named = ("box", "can")[one["category_id"] - 1]
            pose = recording.true_poses[named][images[one["image_id"]]["frame"] + 1]
            np.testing.assert_allclose(pose.ravel(), one["camera_from_object"], atol=1e-12)
            labels += 1
    assert labels == summary.instances == 20


def test_ycb_video_as_its_loaders_read_it(coco: Path, tmp_path: Path) -> None:
    export_ycb_video(tmp_path / "ycb", coco, UNITS)
    sets = {path.stem: path.read_text().split() for path in (tmp_path / "ycb/image_sets").iterdir()}
    assert sets["classes"] == ["box", "can"] and sets["keyframe"] == sets["test"] and len(sets["test"]) == 5
    data = read_coco(coco / "test.json")
    shown = {one["image_id"] for one in data["annotations"]}  # a reader draws an object of each
    images = [image for image in data["images"] if image["id"] in shown]
    for name, image in zip(sets["test"], images, strict=True):
        stem = tmp_path / "ycb/data" / name
        color, depth, label = (
            cv2.imread(f"{stem}-{kind}.png", cv2.IMREAD_UNCHANGED) for kind in ("color", "depth", "label")
        )
        assert color.shape == (120, 160, 3) and depth.dtype == np.uint16 and label.dtype == np.uint8
        mine = [one for one in data["annotations"] if one["image_id"] == image["id"]]
        meta = loadmat(f"{stem}-meta.mat")
        assert meta["poses"].shape == (3, 4, len(mine)) and meta["center"].shape == (len(mine), 2)
        np.testing.assert_array_equal(meta["cls_indexes"].ravel(), [one["category_id"] for one in mine])
        assert meta["factor_depth"][0][0] == 5000  # 0.2 mm
        lines = Path(f"{stem}-box.txt").read_text().splitlines()
        for row, (one, line) in enumerate(zip(mine, lines, strict=True)):
            np.testing.assert_array_equal(label == one["category_id"], masks.decode(one["segmentation"]) > 0)
            origin = meta["intrinsic_matrix"] @ meta["poses"][:, 3, row]
            np.testing.assert_allclose(meta["center"][row], origin[:2] / origin[2])
            x, y, w, h = one["bbox"]
            assert (
                line == f"{sets['classes'][one['category_id'] - 1]} {x:.2f} {y:.2f} {x + w:.2f} {y + h:.2f}"
            )
    points = np.loadtxt(tmp_path / "ycb/models/box/points.xyz")
    assert points.shape == (2620, 3)
    np.testing.assert_allclose([points.min(0), points.max(0)], [[-0.1, -0.1, 0], [0.1, 0.1, 0.05]], atol=2e-3)
    assert (tmp_path / "ycb/models/box/textured.obj").exists()
    export_ycb_video(tmp_path / "again", coco, UNITS)
    metas = [(tmp_path / folder / "data/0000/000003-meta.mat").read_bytes() for folder in ("ycb", "again")]
    assert metas[0] == metas[1]


def test_linemod_as_its_loaders_read_it(coco: Path, tmp_path: Path) -> None:
    summary = export_linemod(tmp_path / "lm", coco, UNITS)
    assert summary.images == {"train": 10, "test": 10} and summary.instances == 20
    data = {split: read_coco(coco / f"{split}.json") for split in ("train", "test")}
    frames = yaml.safe_load((tmp_path / "lm/names.yml").read_text())
    for number in (1, 2):
        place = tmp_path / f"lm/data/{number:02d}"
        truth, cameras = (yaml.safe_load((place / f"{name}.yml").read_text()) for name in ("gt", "info"))
        for split, entries in data.items():
            for stem in (place / f"{split}.txt").read_text().split():
                scene, frame = frames[number]["frames"][int(stem)].split("/")
                image = next(i for i in entries["images"] if (i["scene"], i["frame"]) == (scene, int(frame)))
                (one,) = (
                    a
                    for a in entries["annotations"]
                    if (a["image_id"], a["category_id"]) == (image["id"], number)
                )
                (said,) = truth[int(stem)]
                assert said["obj_id"] == number and said["obj_bb"] == one["bbox_full"]
                pose = np.reshape(one["camera_from_object"], (4, 4))
                np.testing.assert_allclose(np.resize(said["cam_R_m2c"], (3, 3)), pose[:3, :3], atol=1e-9)
                np.testing.assert_allclose(said["cam_t_m2c"], 1000 * pose[:3, 3], atol=1e-9)
                assert cameras[int(stem)] == {"cam_K": PLAIN.matrix.ravel().tolist(), "depth_scale": 1.0}
                color, depth, mask = (
                    cv2.imread(str(place / kind / f"{stem}.png"), -1) for kind in ("rgb", "depth", "mask")
                )
                assert color.shape == mask.shape == (120, 160, 3) and depth.dtype == np.uint16
                assert (depth == (1000 if scene == "a" else 200)).all()  # stored in 0.2 mm, read in mm
                seen = masks.decode(one["segmentation"])[..., None] > 0
                np.testing.assert_array_equal(mask == 255, np.broadcast_to(seen, mask.shape))
    lines = (tmp_path / "lm/models/obj_01.ply").read_text().splitlines()
    count, start = int(lines[3].split()[-1]), lines.index("end_header") + 1
    vertices = np.array([line.split()[:3] for line in lines[start : start + count]], float)
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [[-100, -100, 0], [100, 100, 50]])
    info = yaml.safe_load((tmp_path / "lm/models/models_info.yml").read_text())
    assert list(info) == [1] and info[1]["size_z"] == pytest.approx(50)
    assert len(lines) == start + count + 12


def test_a_lens_with_distortion_is_refused(tmp_path: Path) -> None:
    scene = labelled_scene(tmp_path / "recording", "desk")
    export_coco(tmp_path / "coco", [scene], [BOX, CAN], split=SplitRule(0, 0.0))
    for export in (export_ycb_video, export_linemod):
        with pytest.raises(DataError, match="lens with distortion"):
            export(tmp_path / "out", tmp_path / "coco", {"desk": 0.001})
    assert not (tmp_path / "out").exists()
