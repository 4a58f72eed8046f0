"""Small hand-made scenes with labels, for the tests of what comes after labelling."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from pycocotools import mask as masks

from rpl_data.export import ExportScene, export_coco
from rpl_data.export.split import SplitRule
from rpl_data.geometry import box_around, from_rotvec, project, square_box, transform
from rpl_data.types import Frame, FrameLabel, InstanceLabel, Intrinsics, KeypointModel, Scene, Trajectory

CAMERA = Intrinsics(150.0, 151.0, 79.5, 59.5, 160, 120, (0.01, -0.02, 0.0, 0.0))
BOX = KeypointModel(
    "box",
    ("a", "b", "c", "d"),
    np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0.05], [np.nan, np.nan, np.nan]]),
    ((0, 1), (1, 2)),
)
CAN = KeypointModel(
    "can", ("top", "left", "right"), np.array([[0, -0.1, 0], [-0.05, 0, 0], [0.05, 0.05, 0.0]])
)

LAST_FRAME = 5
"""Of `exported`; it shows both objects."""


def rle(mask):
    encoded = masks.encode(np.asfortranarray(mask.astype(np.uint8)))
    return {"size": list(encoded["size"]), "counts": encoded["counts"].decode()}


def instance(model, x_m, *, turn_rad=0.3, visible=True):
    """An object 1 m ahead, `x_m` to the right: its mask is the rectangle around its keypoints."""
    pose = from_rotvec(np.array([0.1, 0.2, turn_rad]), np.array([x_m, 0.0, 1.0]))
    uv = project(CAMERA, transform(pose, model.points_object))
    x0, y0, x1, y1 = np.round(box_around(uv[model.known])).astype(int)
    full = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    full[y0:y1, x0:x1] = True
    seen = full & visible
    seen[:, : (x0 + x1) // 2] = False
    visibility = np.where(model.known, 2, 0)
    visibility[0] = 1
    return InstanceLabel(
        object=model.name,
        camera_from_object=pose,
        keypoints_px=uv,
        visibility=visibility,
        sigma_px=np.where(model.known, 0.5, np.nan),
        square_box=square_box(uv[model.known]),
        box=(float((x0 + x1) // 2), float(y0), float(x1), float(y1)) if visible else None,
        box_full=(float(x0), float(y0), float(x1), float(y1)),
        mask=rle(seen),
        mask_full=rle(full),
        visib_fract=float(seen.sum() / full.sum()),
        truncated=False,
        quality=0.75,
    )


def smooth_image(seed):
    """Colours that vary slowly, so that sampling between pixels hardly matters."""
    coarse = np.random.default_rng(seed).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    return cv2.resize(coarse, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_CUBIC)


def labelled_scene(folder: Path, name: str, *, frames=6, objects=(BOX, CAN), suffix=".png", seed=0):
    """A scene on disk whose first frame shows nothing and the others every object."""
    (folder / name).mkdir(parents=True)
    taken, labels = [], []
    for index in range(frames):
        color, depth = folder / name / f"c{index}{suffix}", folder / name / f"d{index}.png"
        cv2.imwrite(str(color), smooth_image(seed + index))
        cv2.imwrite(str(depth), np.full((CAMERA.height, CAMERA.width), 1000, dtype=np.uint16))
        taken.append(Frame(index, index / 30, color, depth))
        instances = tuple(
            instance(model, 0.2 * (-1) ** (number + 1), turn_rad=0.1 * index + seed)
            for number, model in enumerate(objects if index else ())
        )
        labels.append(FrameLabel(name, index, index / 30, instances))
    poses = Trajectory(np.arange(frames), np.tile(np.eye(4), (frames, 1, 1)))
    return ExportScene(Scene(name, CAMERA, 0.001, tuple(taken)), poses, labels)


def two_boxes(folder: Path, name: str = "desk") -> ExportScene:
    """A scene with two instances of the box."""
    scene = labelled_scene(folder, name, objects=(BOX, BOX))
    labels = [
        replace(
            label,
            instances=tuple(
                replace(one, instance=called)
                for one, called in zip(label.instances, ("", "2"), strict=bool(label.instances))
            ),
        )
        for label in scene.labels
    ]
    return replace(scene, labels=labels)


def exported(folder: Path, *, models=(BOX, CAN), suffix=".png", frames=6, **rule):
    """An exported COCO folder of one scene, everything in train unless the rule says more."""
    scene = labelled_scene(folder / "recording", "desk", frames=frames, objects=models, suffix=suffix)
    export_coco(folder / "coco", [scene], list(models), split=SplitRule(**{"val_fraction": 0.0} | rule))
    return folder / "coco"
