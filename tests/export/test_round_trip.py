"""Random workspaces through every format that can be read back: poses, keypoints, masks, visibility.

`RPL_ROUND_TRIPS=200` makes as many instead of a few, and prints what was compared and the largest errors.
"""

from __future__ import annotations

import io
import json
import os
import tarfile
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from labelled_scenes import rle
from pycocotools import mask as masks

import rpl_data.export as exports
from rpl_data.export import ExportScene, export_coco
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import labels_from_coco, read_coco
from rpl_data.formats.recordings.bop import read_bop
from rpl_data.formats.recordings.ycb_video import read_ycb_video
from rpl_data.geometry import from_rotvec, invert, project, square_box, transform
from rpl_data.recordings.open import open_scenes
from rpl_data.types import (
    DataError,
    Frame,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    Scene,
    Trajectory,
)

EXAMPLES = int(os.environ.get("RPL_ROUND_TRIPS", "4"))
CLOSE_PX = 0.1
BENDS_LINES = ("bop", "ycb_video", "linemod", "foundationpose")
"""Layouts that cannot hold a lens with distortion."""


@dataclass
class Tally:
    """What was compared in a format: instances, and the largest errors."""

    instances: int = 0
    keypoint_px: float = 0.0
    masks: int = 0
    refused: int = 0


TALLIES: dict[str, Tally] = defaultdict(Tally)


@dataclass(frozen=True)
class Made:
    """A workspace's worth of labels.

    Attributes:
        labels: by scene and frame.
    """

    scenes: list[ExportScene]
    models: list[KeypointModel]
    labels: dict[tuple[str, int], FrameLabel] = field(default_factory=dict)

    def scene(self, name: str) -> ExportScene:
        return next(item for item in self.scenes if item.scene.name == name)

    def of(self, name: str) -> KeypointModel:
        return next(model for model in self.models if model.name == name)


@pytest.fixture(scope="module", autouse=True)
def _table() -> Iterator[None]:
    yield
    if "RPL_ROUND_TRIPS" in os.environ:
        print("\nformat           instances  masks  refused lenses  largest error of a keypoint, px")
        for name, tally in TALLIES.items():
            print(
                f"{name:16s} {tally.instances:9d} {tally.masks:6d} {tally.refused:15d}  "
                f"{tally.keypoint_px:.2g}"
            )


# Random labels ------------------------------------------------------------------------------------


def shape_of(seed: int) -> dict[str, object]:
    """How many of everything, and of what size."""
    rng = np.random.default_rng(seed)
    return {
        "width": int(rng.integers(33, 150)),
        "height": int(rng.integers(33, 120)),
        "bends": seed % 4 == 3,
        "objects": int(rng.integers(1, 4)),
        "scenes": int(rng.integers(1, 4)),
        "frames": int(rng.integers(1, 5)),
        "unit": float(rng.choice([0.001, 0.00025, 0.0001])),
        "suffix": str(rng.choice([".png", ".jpg"])),
        "val_fraction": float(rng.choice([0.0, 0.3])),
        "seed": seed,
    }


def made_of(folder: Path, shape: dict[str, object]) -> Made:
    rng = np.random.default_rng(shape["seed"])
    models = []
    for number in range(shape["objects"]):
        count = int(rng.integers(3, 7))
        points = rng.uniform(-0.1, 0.1, (count, 3))
        points[3:][rng.random(count - 3) < 0.4] = np.nan  # never clicked
        models.append(KeypointModel(f"object-{number}", tuple(map(str, range(count))), points))
    made = Made([], models)
    lens = (0.05, -0.02, 0.001, 0.002) if shape["bends"] else ()
    for number in range(shape["scenes"]):
        width, height = int(shape["width"]) + 10 * number, int(shape["height"])
        focal = float(rng.uniform(0.8, 2)) * width
        camera = Intrinsics(focal, 1.01 * focal, width / 2 - 1.3, height / 2 + 0.7, width, height, lens)
        made.scenes.append(_scene(folder, f"s{number}", camera, shape, made, rng))
    return made


def _scene(
    folder: Path,
    name: str,
    camera: Intrinsics,
    shape: dict[str, object],
    made: Made,
    rng: np.random.Generator,
) -> ExportScene:
    (folder / name).mkdir(parents=True)
    frames, poses, labels = [], [], []
    still = [
        (
            model,
            from_rotvec(rng.uniform(-2, 2, 3), np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(0.6, 1.2)])),
            "" if number == 1 else str(number),
        )
        for model in made.models
        for number in range(1, 1 + int(rng.choice([1, 1, 2, 3])))
    ]
    for index in range(shape["frames"]):
        color, depth = folder / name / f"c{index}{shape['suffix']}", folder / name / f"d{index}.png"
        size = (camera.height, camera.width)
        cv2.imwrite(str(color), rng.integers(0, 255, (*size, 3), dtype=np.uint8))
        cv2.imwrite(str(depth), rng.integers(0, 4000, size, dtype=np.uint16))
        frames.append(Frame(index, index / 30, color, depth))
        scene_from_camera = from_rotvec(rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.05, 0.05, 3))
        poses.append(scene_from_camera)
        seen = [] if rng.random() < 0.2 else still
        taken = np.zeros(size, bool)
        instances = [
            _instance(model, name, invert(scene_from_camera) @ pose, camera, taken, rng)
            for model, pose, name in seen
        ]
        labels.append(FrameLabel(name, index, index / 30, tuple(one for one in instances if one is not None)))
        made.labels[name, index] = labels[-1]
    scene = Scene(name, camera, float(shape["unit"]), tuple(frames))
    return ExportScene(scene, Trajectory(np.arange(len(poses)), np.array(poses)), labels)


def _instance(
    model: KeypointModel,
    name: str,
    pose: np.ndarray,
    camera: Intrinsics,
    taken: np.ndarray,
    rng: np.random.Generator,
) -> InstanceLabel | None:
    """An ellipse around the keypoints, cut by the border, by the objects before it, and by something else."""
    uv = project(camera, transform(pose, model.points_object))
    full = np.zeros((camera.height, camera.width), np.uint8)
    center = np.nanmean(uv, axis=0)
    axes = np.maximum(np.nanmax(uv, axis=0) - np.nanmin(uv, axis=0), 2)
    if not np.isfinite(center).all() or np.abs(center).max() > 1e4:
        return None
    cv2.ellipse(full, (tuple(map(float, center)), tuple(map(float, axes)), 0.0), 1, -1)
    seen = (full > 0) & ~taken
    if rng.random() < 0.3:
        seen[:, int(center[0]) :] = False
    if not seen.any():
        return None
    taken |= seen
    inside = (uv >= -0.5).all(axis=1) & (uv < np.array([camera.width, camera.height]) - 0.5).all(axis=1)
    visibility = np.where(model.known, np.where(inside, rng.integers(1, 3, len(uv)), 1), 0)
    x0, y0, w, h = cv2.boundingRect(full)
    return InstanceLabel(
        object=model.name,
        camera_from_object=pose,
        keypoints_px=uv,
        visibility=visibility,
        sigma_px=np.where(model.known, 0.5, np.nan),
        square_box=square_box(uv[model.known]),
        box=(0.0, 0.0, 1.0, 1.0),
        box_full=(float(x0), float(y0), float(x0 + w), float(y0 + h)),
        mask=rle(seen),
        mask_full=rle(full > 0),
        visib_fract=float(seen.sum() / full.sum()),
        truncated=bool(full[:, [0, -1]].any() or full[[0, -1]].any()),
        quality=float(rng.uniform(0.3, 1)),
        instance=name,
    )


# Comparisons --------------------------------------------------------------------------------------


def agree_keypoints(name: str, found: np.ndarray, label: InstanceLabel) -> None:
    """Compare pixels of the labelled keypoints, NaN where a format has none."""
    both = (label.visibility > 0) & np.isfinite(found).all(axis=1)
    apart = np.abs(found[both] - label.keypoints_px[both])
    assert (apart < CLOSE_PX).all(), f"{name}: {apart.max()} px"
    tally = TALLIES[name]
    tally.keypoint_px = max(tally.keypoint_px, float(apart.max(initial=0)))
    tally.instances += 1


def agree_pose(name: str, pose: np.ndarray, camera: Intrinsics, made: Made, label: InstanceLabel) -> None:
    """Compare a pose by where it puts the keypoints in the image."""
    points = made.of(label.object).points_object
    agree_keypoints(name, project(camera, transform(pose, points)), label)


def agree_mask(name: str, found: np.ndarray, expected: object) -> None:
    np.testing.assert_array_equal(found > 0, masks.decode(expected) > 0, err_msg=name)
    TALLIES[name].masks += 1


def label_of(made: Made, scene: str, frame: int, object_name: str, pose: np.ndarray) -> InstanceLabel:
    """The label of an object that stands nearest: few layouts name instances."""
    found = [item for item in made.labels[scene, frame].instances if item.object == object_name]
    return min(found, key=lambda item: np.linalg.norm(item.camera_from_object[:3, 3] - pose[:3, 3]))


def agree_counts(name: str, read: Counter[str], labels: FrameLabel) -> None:
    """Compare how many instances of each object there are."""
    assert read == Counter(item.object for item in labels.instances), name


def read_coco_labels(folder: Path, made: Made, coco: Path) -> None:
    for split in ("train", "val"):
        if (folder / f"{split}.json").exists():
            for label in labels_from_coco(read_coco(folder / f"{split}.json")):
                expected = made.labels[label.scene, label.frame].instances
                for one, given_label in zip(label.instances, expected, strict=True):
                    assert (one.object, one.instance) == (given_label.object, given_label.instance)
                    np.testing.assert_array_equal(one.camera_from_object, given_label.camera_from_object)
                    np.testing.assert_array_equal(one.visibility, given_label.visibility)
                    assert one.visib_fract == given_label.visib_fract
                    agree_keypoints("coco", one.keypoints_px, given_label)
                    for mask, other in ((one.mask, given_label.mask), (one.mask_full, given_label.mask_full)):
                        agree_mask("coco", masks.decode(mask), other)


def read_yolo(folder: Path, made: Made, coco: Path) -> None:
    """Lines as Ultralytics reads them: shares of the image, polygons cut off to whole pixels."""
    for path in sorted((folder / "pose/labels").glob("*/*.txt")):
        scene, frame = path.stem.split("_")
        camera, size = made.scene(scene).scene.intrinsics, made.scene(scene).scene.intrinsics
        other = folder / "segment/labels" / path.parent.name / path.name
        instances = made.labels[scene, int(frame)].instances
        for label, line, outline in zip(
            instances, path.read_text().splitlines(), other.read_text().splitlines(), strict=True
        ):
            numbers = np.array(line.split(), float)
            assert made.models[int(numbers[0])].name == label.object
            keypoints = numbers[5:].reshape(-1, 3)[: len(label.visibility)]
            uv = keypoints[:, :2] * [camera.width, camera.height] - 0.5
            uv[keypoints[:, 2] == 0] = np.nan
            agree_keypoints("yolo", uv, label)
            shown = keypoints[:, 2] > 0
            np.testing.assert_array_equal(keypoints[shown, 2], label.visibility[shown])
            polygon = np.array(outline.split()[1:], np.float32).reshape(-1, 2) * [size.width, size.height]
            drawn = np.zeros((size.height, size.width), np.uint8)
            cv2.fillPoly(drawn, [polygon.astype(np.int32)], 1)
            mask = masks.decode(label.mask)
            if cv2.connectedComponents(mask)[0] == 2:  # else joined by a line
                agree_mask("yolo", drawn, label.mask)


def read_bop_folder(folder: Path, made: Made, coco: Path) -> None:
    scenes = sorted(item.scene.name for item in made.scenes)
    for split in sorted(path for path in folder.iterdir() if path.name in ("train", "val")):
        for recording in read_bop(split):
            name = scenes[int(recording.scene.name) - 1]
            place = split / recording.scene.name
            truth, info = (
                json.loads((place / f"scene_{kind}.json").read_text()) for kind in ("gt", "gt_info")
            )
            for frame, entries in truth.items():
                called = Counter(made.models[entry["obj_id"] - 1].name for entry in entries)
                agree_counts("bop", called, made.labels[name, int(frame)])
                for row, (entry, numbers) in enumerate(zip(entries, info[frame], strict=True)):
                    pose = millimetres(entry)
                    label = label_of(made, name, int(frame), made.models[entry["obj_id"] - 1].name, pose)
                    if called[label.object] == 1:
                        ours = recording.true_poses[f"obj_{entry['obj_id']:06d}"][int(frame)]
                        np.testing.assert_allclose(ours, pose, atol=1e-9)
                    agree_pose("bop", pose, recording.scene.intrinsics, made, label)
                    assert numbers["visib_fract"] == pytest.approx(label.visib_fract)
                    for kind, expected in (("mask", label.mask_full), ("mask_visib", label.mask)):
                        agree_mask(
                            "bop", cv2.imread(f"{place}/{kind}/{int(frame):06d}_{row:06d}.png", -1), expected
                        )


def millimetres(entry: dict[str, list[float]]) -> np.ndarray:
    """The pose of an entry of BOP or LINEMOD."""
    pose = np.eye(4)
    pose[:3, :3] = np.resize(entry["cam_R_m2c"], (3, 3))
    pose[:3, 3] = np.array(entry["cam_t_m2c"]) / 1000
    return pose


def shows_each_object_once(label: FrameLabel) -> bool:
    return set(Counter(item.object for item in label.instances).values()) == {1}


def read_ycb(folder: Path, made: Made, coco: Path) -> None:
    names = [model.name for model in made.models]
    scenes = sorted(item.scene.name for item in made.scenes)
    if not list(folder.glob("data/*/*-color.png")):  # label.png cannot tell instances of one object apart
        assert not any(shows_each_object_once(label) for label in made.labels.values())
        return
    for recording in read_ycb_video(folder):
        name = scenes[int(recording.scene.name)]
        for object_name, poses in recording.true_poses.items():
            for frame, pose in poses.items():
                label = label_of(made, name, frame - 1, object_name, pose)
                agree_pose("ycb_video", pose, recording.scene.intrinsics, made, label)
                drawn = cv2.imread(str(folder / f"data/{recording.scene.name}/{frame:06d}-label.png"), -1)
                agree_mask("ycb_video", drawn == names.index(object_name) + 1, label.mask)


def read_linemod(folder: Path, made: Made, coco: Path) -> None:
    sources = yaml.safe_load((folder / "names.yml").read_text())
    for number, said in sources.items():
        place = folder / f"data/{number:02d}"
        truth, cameras = (yaml.safe_load((place / f"{kind}.yml").read_text()) for kind in ("gt", "info"))
        for index, source in enumerate(said["frames"]):
            scene, frame = source.split("/")
            pose = millimetres(truth[index][0])
            label = label_of(made, scene, int(frame.partition("_")[0]), said["name"], pose)
            fx, _, cx, _, fy, cy, *_ = cameras[index]["cam_K"]
            size = made.scene(scene).scene.intrinsics
            camera = Intrinsics(fx, fy, cx, cy, size.width, size.height)
            agree_pose("linemod", pose, camera, made, label)
            agree_mask("linemod", cv2.imread(str(place / f"mask/{index:04d}.png"), -1)[..., 0], label.mask)


def read_foundationpose(folder: Path, made: Made, coco: Path) -> None:
    for place in sorted(folder.glob("ob_*")):
        model = made.models[int(place.name[3:]) - 1]
        matrix = np.loadtxt(place / "K.txt")
        for index, source in enumerate(yaml.safe_load((place / "select_frames.yml").read_text())["frames"]):
            scene, frame = source.split("/")
            pose = np.linalg.inv(np.loadtxt(place / f"cam_in_ob/{index:06d}.txt"))
            label = label_of(made, scene, int(frame.partition("_")[0]), model.name, pose)
            assert label.instance == frame.partition("_instance_")[2]
            size = made.scene(scene).scene.intrinsics
            camera = Intrinsics(
                matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], size.width, size.height
            )
            agree_pose("foundationpose", pose, camera, made, label)
            agree_mask("foundationpose", cv2.imread(str(place / f"mask/{index:06d}.png"), -1), label.mask)


def read_webdataset(folder: Path, made: Made, coco: Path) -> None:
    for shard in sorted(folder.glob("*.tar")):
        with tarfile.open(shard) as tar:
            content = {item.name: tar.extractfile(item).read() for item in tar}  # type: ignore[union-attr]
        for name in (name for name in content if name.endswith(".json")):
            record = json.loads(content[name])
            drawn = cv2.imdecode(np.frombuffer(content[f"{name[:-5]}.mask.png"], np.uint8), -1)
            labels = made.labels[record["scene"], record["frame"]].instances
            for number, (one, label) in enumerate(zip(record["annotations"], labels, strict=True), start=1):
                agree_flat("webdataset", one["keypoints"], one["camera_from_object"], label)
                agree_mask("webdataset", drawn == number, label.mask)


def read_huggingface(folder: Path, made: Made, coco: Path) -> None:
    for file in sorted(folder.glob("*/metadata.jsonl")):
        for line in io.StringIO(file.read_text()):
            row = json.loads(line)
            labels, columns = made.labels[row["scene"], row["frame"]].instances, row["objects"]
            for number, label in enumerate(labels):
                agree_flat(
                    "huggingface", columns["keypoints"][number], columns["camera_from_object"][number], label
                )
                assert columns["visib_fract"][number] == label.visib_fract


def agree_flat(name: str, keypoints: list[float], pose: list[float], label: InstanceLabel) -> None:
    rows = np.reshape(keypoints, (-1, 3))
    np.testing.assert_array_equal(rows[:, 2], label.visibility)
    np.testing.assert_allclose(np.reshape(pose, (4, 4)), label.camera_from_object, atol=1e-12)
    agree_keypoints(name, np.where(rows[:, 2:] > 0, rows[:, :2], np.nan), label)


def read_nerfstudio(folder: Path, made: Made, coco: Path) -> None:
    """Cameras only: the objects stand still in a scene, so one label's place there serves all its frames."""
    for item in open_scenes(folder, "nerfstudio", unpack=(folder / "unpacked").joinpath):
        scene = made.scene(item.scene.name)
        assert item.trajectory is not None
        for row, frame in enumerate(sorted(frame.index for frame in scene.scene.frames)):
            at = item.trajectory.scene_from_camera[row]
            for label in made.labels[item.scene.name, frame].instances:
                scene_from_object = scene.trajectory.at(frame) @ label.camera_from_object
                agree_pose("nerfstudio", invert(at) @ scene_from_object, item.scene.intrinsics, made, label)


READERS: dict[str, Callable[[Path, Made, Path], None]] = {
    "yolo": read_yolo,
    "bop": read_bop_folder,
    "ycb_video": read_ycb,
    "linemod": read_linemod,
    "foundationpose": read_foundationpose,
    "webdataset": read_webdataset,
    "huggingface": read_huggingface,
    "nerfstudio": read_nerfstudio,
}
UNITS = ("bop", "ycb_video", "linemod", "foundationpose", "nerfstudio")


@pytest.mark.parametrize("seed", range(EXAMPLES))
def test_what_is_written_is_read_again(seed: int) -> None:
    shape = shape_of(seed)
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root)
        made = made_of(folder / "recording", shape)
        coco = folder / "coco"
        rule = SplitRule(0, float(shape["val_fraction"]))
        export_coco(coco, made.scenes, made.models, split=rule)
        read_coco_labels(coco, made, coco)
        units = {item.scene.name: item.scene.metres_per_unit for item in made.scenes}
        for name, read in READERS.items():
            write = getattr(exports, f"export_{name}")
            more = (units,) if name in UNITS else ()
            if shape["bends"] and name in BENDS_LINES:
                with pytest.raises(DataError, match="distortion|no training image"):
                    write(folder / name, coco, *more)
                    held = shows_each_object_once if name == "ycb_video" else lambda label: label.instances
                    assert not any(held(label) for label in made.labels.values())
                    raise DataError("without a label there is no lens to refuse: distortion")
                TALLIES[name].refused += 1
                continue
            try:
                write(folder / name, coco, *more)
            except DataError as error:
                assert name == "foundationpose" and "no training image" in str(error)
                continue
            read(folder / name, made, coco)
