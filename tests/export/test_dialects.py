"""The dialects of an exported COCO folder: YOLO's text and BOP's folders, judged by hand and by OpenCV."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from labelled_scenes import BOX, CAMERA, CAN, LAST_FRAME, instance, labelled_scene, rle
from PIL import Image, ImageDraw
from pycocotools import mask as masks

from rpl_data.evaluate.truth import box_mesh
from rpl_data.export import (
    ExportScene,
    export_bop,
    export_bop_onboarding,
    export_coco,
    export_okt,
    export_yolo,
)
from rpl_data.export.bop_instances import Silhouettes, write_instance
from rpl_data.export.bop_onboarding import Video, opposite_sides
from rpl_data.export.checks import check_export
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import CocoObject, read_coco
from rpl_data.formats.datasets.yolo import LINES, detect_line, pose_line, segment_line
from rpl_data.formats.recordings.bop import read_bop
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.pipeline.stages.export import refuse_unknown_exports
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.types import DataError, Intrinsics

PLAIN = CAMERA.__class__(150.0, 151.0, 79.5, 59.5, 160, 120)
SIZE = np.array([0.2, 0.2, 0.05])


@pytest.fixture(scope="module")
def coco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four scenes of six frames, one of them for test; the box has a mesh, the can has none."""
    root = tmp_path_factory.mktemp("dialects")
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.05)])
    save_mesh(root / "box.ply", box_mesh(corners))
    scenes = []
    for seed, name in enumerate(("a", "b", "c", "d")):
        made = labelled_scene(root / "recording", name, seed=seed)
        scene = made.scene.__class__(name, PLAIN, 0.001, made.scene.frames)
        scenes.append(ExportScene(scene, made.trajectory, made.labels))
    rule = SplitRule(val_fraction=0.2)
    export_coco(root / "coco", scenes, [BOX, CAN], split=rule, meshes={"box": root / "box.ply"})
    return root / "coco"


# YOLO ---------------------------------------------------------------------------------------------

IMAGE = {"width": 100, "height": 50}
CATEGORIES = [{"keypoints": ["a", "b", "c"]}, {"keypoints": ["a"]}]


def annotation(mask: np.ndarray, **more: object) -> dict[str, object]:
    encoded = masks.encode(np.asfortranarray(mask.astype(np.uint8)))
    return {"category_id": 2, "bbox": masks.toBbox(encoded).tolist(), "segmentation": encoded} | more


def test_lines_by_hand() -> None:
    """A rectangle of the columns 10-29 and the rows 20-29; the centre of pixel (0, 0) is half a pixel in."""
    mask = np.zeros((50, 100), bool)
    mask[20:30, 10:30] = True
    one = annotation(mask, keypoints=[9.5, 19.5, 2])
    assert detect_line(IMAGE, one, CATEGORIES) == "1 0.200000 0.500000 0.200000 0.200000"
    pose = "1 0.200000 0.500000 0.200000 0.200000 0.100000 0.400000 2 0 0 0 0 0 0"
    assert pose_line(IMAGE, one, CATEGORIES) == pose
    corners = np.array(segment_line(IMAGE, one, CATEGORIES).split()[1:], float).reshape(-1, 2) * [100, 50]
    first, last = (10.495, 20.495), (29.495, 29.495)
    assert sorted(map(tuple, corners.round(3))) == [first, (first[0], last[1]), (last[0], first[1]), last]


@pytest.mark.parametrize("keypoint", [[-0.6, 10, 2], [10, 49.6, 1], [0, 0, 0]])
def test_keypoints_outside_or_unknown_are_zero(keypoint: list[float]) -> None:
    """Ultralytics drops an image with a number below 0 or above 1 as corrupt."""
    mask = np.zeros((50, 100), bool)
    mask[20:30, 10:30] = True
    line = pose_line(IMAGE, annotation(mask, keypoints=keypoint), CATEGORIES[1:])
    assert line.split()[5:] == ["0", "0", "0"]


def drawn_by_others(mask: np.ndarray) -> dict[str, np.ndarray]:
    """What readers make of the line: corners cut off to whole pixels or rounded, by OpenCV or Pillow."""
    height, width = mask.shape
    words = segment_line({"width": width, "height": height}, annotation(mask), CATEGORIES).split()
    outline = np.array(words[1:], np.float32).reshape(-1, 2) * np.array([width, height], np.float32)
    assert len(outline) >= 3
    cut, rounded = np.zeros((2, height, width), np.uint8)
    cv2.fillPoly(cut, [outline.astype(np.int32)], 1)
    cv2.fillPoly(rounded, [outline.round().astype(np.int32)], 1)
    pillow = Image.new("L", (width, height))
    ImageDraw.Draw(pillow).polygon(outline.ravel().tolist(), fill=1, outline=1)
    return {"cut": cut > 0, "rounded": rounded > 0, "pillow": np.asarray(pillow) > 0}


@pytest.mark.parametrize("thick", [1, 2, 3, 7])
def test_other_readers_draw_the_mask_pixel_for_pixel(thick: int) -> None:
    """Rods, thin ones too, rings with their holes, single pixels."""
    rng = np.random.default_rng(thick)
    rod, ring, dot = np.zeros((3, 97, 131), np.uint8)
    cv2.line(rod, tuple(rng.integers(5, 90, 2)), tuple(rng.integers(5, 90, 2)), 1, thick)
    cv2.ellipse(ring, ((60, 45), (70, 50), float(rng.uniform(0, 90))), 1, -1)
    for at in ((45, 45), (75, 40)):
        cv2.circle(ring, at, 3 * thick // 2, 0, -1)
    dot[thick, 130 - thick :] = 1
    for mask in (rod, ring, dot):
        for reader, drawn in drawn_by_others(mask > 0).items():
            wrong = np.count_nonzero(drawn != (mask > 0))
            beside_the_line_to_a_hole = 5 if reader == "pillow" and mask is ring else 0
            assert wrong <= beside_the_line_to_a_hole, reader


def test_an_object_in_parts_is_one_polygon() -> None:
    mask = np.zeros((50, 100), np.uint8)
    cv2.circle(mask, (20, 25), 12, 1, -1)
    cv2.circle(mask, (20, 25), 4, 0, -1)
    cv2.rectangle(mask, (60, 10), (90, 40), 1, -1)
    cv2.rectangle(mask, (40, 2), (46, 8), 1, -1)
    drawn = drawn_by_others(mask > 0)["cut"].astype(np.uint8)
    assert not (mask & ~drawn).any()
    lines = drawn & ~mask  # between the parts, a pixel wide
    assert 0 < lines.sum() < 60
    assert not cv2.morphologyEx(lines, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)).any()


def test_a_yolo_folder(coco: Path, tmp_path: Path) -> None:
    summary = export_yolo(tmp_path / "yolo", coco)
    assert set(summary.images) == {"train", "val", "test"} and sum(summary.images.values()) == 24
    for task in LINES:
        root = tmp_path / "yolo" / task
        data = yaml.safe_load((root / "data.yaml").read_text())
        assert data["names"] == {0: "box", 1: "can"}
        assert data.get("kpt_shape") == ([4, 3] if task == "pose" else None)
        for split, count in summary.images.items():
            images = sorted((root / data[split]).iterdir())
            assert len(images) == count
            for image in images:
                text = (root / "labels" / split / f"{image.stem}.txt").read_text()
                if image.stem.endswith("_000000"):
                    assert text == ""  # nothing in it: a background image
                for line in text.splitlines():
                    numbers = [float(word) for word in line.split()]
                    assert numbers[0] in (0, 1) and all(0 <= n <= 1 for n in numbers[1:5])
                    expected = {"detect": 5, "pose": 5 + 3 * 4}.get(task, len(numbers))
                    assert len(numbers) == expected
    linked = tmp_path / f"yolo/pose/images/train/a_{LAST_FRAME:06d}.png"
    if linked.exists():
        assert linked.read_bytes() == (coco / f"images/a/{LAST_FRAME:06d}.png").read_bytes()


# BOP ----------------------------------------------------------------------------------------------


def test_a_bop_folder_reads_back(coco: Path, tmp_path: Path) -> None:
    """Its own reader gives the cameras, the poses and the depth unit of the labels."""
    units = {name: 0.001 for name in "abcd"}
    summary = export_bop(tmp_path / "bop", coco, units)
    assert summary.messages == ("can has no dense model, so no models/*.ply",)
    for split in summary.images:
        data = read_coco(coco / f"{split}.json")
        scenes = {recording.scene.name: recording for recording in read_bop(tmp_path / "bop" / split)}
        assert sum(len(found.scene.frames) for found in scenes.values()) == len(data["images"])
        by_id = {image["id"]: image for image in data["images"]}
        for one in data["annotations"]:
            image = by_id[one["image_id"]]
            recording = scenes[f"{'abcd'.index(image['scene']) + 1:06d}"]
            assert (recording.scene.intrinsics, recording.scene.metres_per_unit) == (PLAIN, 0.001)
            pose = recording.true_poses[f"obj_{one['category_id']:06d}"][image["frame"]]
            np.testing.assert_allclose(pose.ravel(), one["camera_from_object"], atol=1e-9)


def test_masks_and_numbers_of_bop(coco: Path, tmp_path: Path) -> None:
    export_bop(tmp_path / "bop", coco, {name: 0.001 for name in "abcd"})
    (scene,) = (tmp_path / "bop/test").iterdir()
    info = json.loads((scene / "scene_gt_info.json").read_text())
    truth = json.loads((scene / "scene_gt.json").read_text())
    in_coco = json.loads((scene / "scene_gt_coco.json").read_text())
    assert info["0"] == truth["0"] == []
    entries_of = {
        image["id"]: iter([a for a in in_coco["annotations"] if a["image_id"] == image["id"]])
        for image in in_coco["images"]
    }
    for frame, entries in info.items():
        for number, entry in enumerate(entries):
            name = f"{int(frame):06d}_{number:06d}.png"
            full, visible = (cv2.imread(str(scene / f / name), -1) for f in ("mask", "mask_visib"))
            x, y, w, h = cv2.boundingRect(full)  # OpenCV counts to the far edge
            assert entry["bbox_obj"] == [x, y, w - 1, h - 1]
            assert entry["px_count_all"] == entry["px_count_valid"] == cv2.countNonZero(full)
            coco_one = next(entries_of[int(frame)])
            np.testing.assert_array_equal(masks.decode(plain(coco_one["segmentation"])), visible > 0)
            assert coco_one["bbox"] == [x, y, w, h] and coco_one["ignore"] == (entry["visib_fract"] < 0.1)
            assert entry["px_count_visib"] == cv2.countNonZero(visible)
            assert entry["visib_fract"] == pytest.approx(cv2.countNonZero(visible) / cv2.countNonZero(full))
    targets, images = (
        json.loads((tmp_path / f"bop/test_targets_bop{year}.json").read_text()) for year in (19, 24)
    )
    assert len(targets) == sum(map(len, truth.values())) == 10
    assert {(t["scene_id"], t["im_id"]) for t in targets} == {(t["scene_id"], t["im_id"]) for t in images}
    assert all(set(target) == {"scene_id", "im_id"} for target in images) and len(images) == 5


def plain(rle: dict[str, object]) -> dict[str, object]:
    """Run lengths as pycocotools decodes them."""
    return masks.frPyObjects(rle, *rle["size"])  # type: ignore[misc]


@pytest.mark.parametrize("shift_px", [0, 60, 110])
def test_what_the_border_cuts_off_is_counted(shift_px: int, tmp_path: Path) -> None:
    """A box before the camera, moved out of the image: against the same render on a canvas of our own."""
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.05)])
    save_mesh(tmp_path / "box.ply", box_mesh(corners))
    pose = np.eye(4)
    pose[:3, 3] = [shift_px / 150.0 * 0.6, 0, 0.6]
    wide = Intrinsics(150.0, 151.0, 79.5 + 400, 59.5, 960, 120)
    rays = RayScene([load_mesh(tmp_path / "box.ply")])
    uncut = render_depth_m(rays, wide, pose, left_px=0, top_px=0, width=960, height=120) > 0
    inside = uncut[:, 400:560]
    run = masks.encode(np.asfortranarray(inside.astype(np.uint8)))
    image = {"cam_K": list(map(float, PLAIN.matrix.ravel())), "width": 160, "height": 120, "distortion": []}
    one = {
        "category_id": 1,
        "truncated": bool(inside[:, -1].any()),
        "camera_from_object": pose.ravel().tolist(),
        "segmentation": run,
        "segmentation_full": run,
    }
    whole = Silhouettes(tmp_path, [CocoObject(BOX, "box.ply")])
    info = write_instance(tmp_path, "one.png", image, one, None, whole)
    columns = np.flatnonzero(uncut.any(axis=0)) - 400
    assert abs(info["px_count_all"] - uncut.sum()) <= 0.01 * uncut.sum()
    assert abs(info["visib_fract"] - inside.sum() / uncut.sum()) < 0.01
    assert info["bbox_obj"][0] == columns[0] and info["bbox_obj"][2] == np.ptp(columns)


def test_models_of_bop_are_millimetres(coco: Path, tmp_path: Path) -> None:
    export_bop(tmp_path / "bop", coco, {name: 0.001 for name in "abcd"})
    mesh = load_mesh(tmp_path / "bop/models/obj_000001.ply")
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), 1000 * SIZE)
    info = json.loads((tmp_path / "bop/models/models_info.json").read_text())
    assert list(info) == ["1"]
    content = (tmp_path / "bop/models/obj_000001.ply").read_bytes()
    assert b"property double nx" in content[: content.index(b"end_header")]
    assert (tmp_path / "bop/models_eval/obj_000001.ply").exists()
    assert info["1"]["diameter"] == pytest.approx(1000 * np.linalg.norm(SIZE))
    assert (info["1"]["min_x"], info["1"]["size_z"]) == pytest.approx((-100, 50))


# ObjectKeypointTrainer ----------------------------------------------------------------------------


def test_an_okt_folder(coco: Path, tmp_path: Path) -> None:
    summary = export_okt(tmp_path / "okt", coco)
    assert summary.messages == ("box: keypoints left out, as they were never clicked: 1",)
    place = tmp_path / "okt/box"
    assert (place / "keypoints.txt").read_text().split() == ["a", "b", "c"]
    np.testing.assert_array_equal(np.load(place / "camera_matrix.npy"), PLAIN.matrix)
    lists = {name: (place / name).read_text().split() for name in ("train.txt", "valid.txt", "test.txt")}
    every = [Path(path) for paths in lists.values() for path in paths]
    assert len(set(every)) == len(every) == 20 and all(
        path.is_file() and path.is_absolute() for path in every
    )
    data = read_coco(coco / "train.json")
    (one, *_) = [a for a in data["annotations"] if a["category_id"] == 1]
    cx, cy, side = one["square_box"]
    np.testing.assert_allclose(np.loadtxt(place / "center/center_00000.txt"), [cx, cy])
    np.testing.assert_allclose(np.loadtxt(place / "scale/scales_00000.txt"), side / 200)
    labels = np.loadtxt(place / "label/label_00000.txt")
    np.testing.assert_allclose(labels, np.reshape(one["keypoints"], (-1, 3))[:3, :2])
    x, y, w, h = one["bbox"]
    words = (place / "bboxes/frame_00000.txt").read_text().split("\t")
    np.testing.assert_allclose(
        [float(n) for n in words], [0, (x + w / 2) / 160, (y + h / 2) / 120, w / 160, h / 120], atol=1e-6
    )
    mask = cv2.imread(str(place / "masks/mask_00000.png"), -1)
    np.testing.assert_array_equal(mask, masks.decode(one["segmentation"]) * 255)
    image = cv2.imread(lists["train.txt"][0])
    source = next(image["file_name"] for image in data["images"] if image["id"] == one["image_id"])
    assert np.abs(image.astype(int) - cv2.imread(str(coco / source))).mean() < 3


def test_an_okt_label_holds_keypoints_outside_the_image(tmp_path: Path) -> None:
    """COCO does not label them, but this layout has a line per keypoint: the pose says where they are."""
    scene = labelled_scene(tmp_path / "recording", "desk", frames=2, objects=(BOX,))
    outside = replace(instance(BOX, 0.45), visibility=np.array([2, 0, 1, 0]))  # b is right of the image
    labels = [scene.labels[0], replace(scene.labels[1], instances=(outside,))]
    export_coco(tmp_path / "coco", [replace(scene, labels=labels)], [BOX], split=SplitRule(val_fraction=0.0))
    assert export_okt(tmp_path / "okt", tmp_path / "coco").images["train"] == 2
    written = np.loadtxt(tmp_path / "okt/box/label/label_00000.txt")
    np.testing.assert_allclose(written, outside.keypoints_px[:3], atol=1e-3)
    assert written[1, 0] > CAMERA.width


def test_a_lens_with_distortion_is_refused_and_nothing_stays(tmp_path: Path) -> None:
    scene = labelled_scene(tmp_path / "recording", "desk")
    export_coco(tmp_path / "coco", [scene], [BOX, CAN], split=SplitRule(val_fraction=0.0))
    with pytest.raises(DataError, match="cannot hold lens distortion"):
        export_bop(tmp_path / "bop", tmp_path / "coco", {"desk": 0.001})
    assert not (tmp_path / "bop").exists()
    with pytest.raises(DataError, match="holds no exported COCO files"):
        export_yolo(tmp_path / "yolo", tmp_path / "nowhere")


def test_dialects_are_made_of_coco() -> None:
    refuse_unknown_exports(["yolo", "coco", "bop"])
    with pytest.raises(DataError, match=r"is made from `coco`; write `export: \[coco, yolo\]`"):
        refuse_unknown_exports(["yolo"])
    with pytest.raises(DataError, match="unknown export 'voc'"):
        refuse_unknown_exports(["coco", "voc"])


def test_colour_in_one_format_where_readers_replace_rgb_in_a_path(coco: Path, tmp_path: Path) -> None:
    for color, suffix in (("jpg", ".jpg"), ("png", ".png")):
        export_bop(tmp_path / color, coco, {name: 0.001 for name in "abcd"}, color)
        found = sorted((tmp_path / color).glob("*/*/rgb/*"))
        assert {path.suffix for path in found} == {suffix} and len(found) == 24
        (scene,) = (tmp_path / color / "test").iterdir()
        listed = json.loads((scene / "scene_gt_coco.json").read_text())["images"]
        assert all((scene / image["file_name"]).is_file() for image in listed)
    assert all(Path(str(path).replace("rgb", "depth")).is_file() for path in found)
    for path in found:
        jpeg = tmp_path / "jpg" / path.relative_to(tmp_path / "png").with_suffix(".jpg")
        assert np.abs(cv2.imread(str(jpeg)).astype(int) - cv2.imread(str(path))).mean() < 3


def test_masks_of_bop_are_the_pixels_whose_centres_cam_k_puts_on_the_object(tmp_path: Path) -> None:
    """A box is convex, so its silhouette is the hull of its corners; pixel centres are whole numbers."""
    made = labelled_scene(tmp_path / "recording", "desk", frames=2, objects=(BOX,))
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.05)])
    save_mesh(tmp_path / "box.ply", box_mesh(corners))
    (label,) = made.labels[1].instances
    rays = RayScene([load_mesh(tmp_path / "box.ply")])
    area = {"left_px": 0, "top_px": 0, "width": 160, "height": 120}
    mask = rle(render_depth_m(rays, PLAIN, label.camera_from_object, **area) > 0)
    frame = replace(made.labels[1], instances=(replace(label, mask=mask, mask_full=mask),))
    scene = ExportScene(replace(made.scene, intrinsics=PLAIN), made.trajectory, [frame])
    meshes = {"box": tmp_path / "box.ply"}
    export_coco(tmp_path / "coco", [scene], [BOX], split=SplitRule(0, 0.0), meshes=meshes)
    export_bop(tmp_path / "bop", tmp_path / "coco", {"desk": 0.001})
    place = tmp_path / "bop/train/000001"
    camera = np.reshape(json.loads((place / "scene_camera.json").read_text())["1"]["cam_K"], (3, 3))
    (said,) = json.loads((place / "scene_gt.json").read_text())["1"]
    rotation = cv2.Rodrigues(np.reshape(said["cam_R_m2c"], (3, 3)))[0]
    model = load_mesh(tmp_path / "bop/models/obj_000001.ply").vertices
    outline = cv2.convexHull(
        cv2.projectPoints(model, rotation, np.array(said["cam_t_m2c"]), camera, None)[0].astype(np.float32)
    )
    for folder in ("mask", "mask_visib"):
        drawn = cv2.imread(str(place / folder / "000001_000000.png"), -1)
        inside = [
            [cv2.pointPolygonTest(outline, (float(u), float(v)), False) >= 0 for u in range(160)]
            for v in range(120)
        ]
        np.testing.assert_array_equal(drawn > 0, inside)


def test_onboarding_shows_an_object_from_both_sides(coco: Path, tmp_path: Path) -> None:
    units = {name: 0.001 for name in "abcd"}
    summary = export_bop_onboarding(tmp_path / "onboarding", coco, units, "png")
    assert summary.messages == ()
    root = tmp_path / "onboarding/onboarding_static"
    sides = [f"obj_{number:06d}_{side}" for number in (1, 2) for side in ("down", "up")]
    assert sorted(path.name for path in root.iterdir()) == sides
    said = json.loads((tmp_path / "onboarding/names.json").read_text())
    data = read_coco(coco / "train.json")
    for recording in read_bop(root):
        scene = said[recording.scene.name]["scene"]
        frames = {i["frame"] for i in data["images"] if i["scene"] == scene and i["frame"] > 0}
        assert {frame.index for frame in recording.scene.frames} == frames
        assert list(recording.true_poses) == [recording.scene.name[: len("obj_000001")]]


def test_a_moved_object_has_a_dynamic_video_and_no_static_one(coco: Path, tmp_path: Path) -> None:
    units = {name: 0.001 for name in "abcd"}
    export_bop_onboarding(tmp_path / "videos", coco, units, moving="abcd")
    assert not (tmp_path / "videos/onboarding_static").exists()
    (one, other) = read_bop(tmp_path / "videos/onboarding_dynamic")
    assert [list(each.true_poses) for each in (one, other)] == [["obj_000001"], ["obj_000002"]]
    assert check_export(tmp_path / "videos") == []
    shutil.rmtree(tmp_path / "videos/onboarding_dynamic/obj_000002")
    said = [str(fault) for fault in check_export(tmp_path / "videos")]
    assert said[0] == "names.json: obj_000002: there is no folder onboarding_dynamic/obj_000002"


def test_the_other_side_is_the_one_most_upside_down() -> None:
    ups = {"a": [0, 0, 1], "b": [0.8, 0, 0.6], "c": [0.6, 0, -0.8], "d": [1, 0, 0]}
    videos = [Video(name, ({},) * (name == "a"), np.array(up, float)) for name, up in ups.items()]
    sides = opposite_sides(videos)
    assert {side: video.scene for side, video in sides.items()} == {"up": "a", "down": "c"}
    assert list(opposite_sides(videos[:2])) == ["up"] and opposite_sides([]) == {}
