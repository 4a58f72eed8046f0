"""The layout of YCB-Video (Xiang et al., PoseCNN), for trainers that read nothing else.

::

    <folder>/data/0000/000001-color.png     one folder per scene; images are numbered from 1
                       000001-depth.png     16 bit, metres = value / factor_depth
                       000001-label.png     number of the object seen in each pixel, 0 = none
                       000001-box.txt       name, then the visible box: x1 y1 x2 y2
                       000001-meta.mat      see `_meta`
             image_sets/{classes,train,val,test,keyframe}.txt
             models/<object>/points.xyz     metres, object frame
                             textured.obj   with its texture

Layout: the toolbox https://github.com/yuxng/YCB_Video_toolbox and the loader of
https://github.com/j96w/DenseFusion. `vertmap`, the object coordinates of each pixel, is not written. That
loader has the two cameras of YCB-Video, 640 x 480 px, and lists of its own written into it: give it
`intrinsic_matrix` of the meta files and the lists here.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.color_images import write_color
from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import replacing
from rpl_data.export.texture import save_textured
from rpl_data.export.views import numbered, refuse_lens, write_depth
from rpl_data.files import write_bytes, write_text
from rpl_data.formats.datasets.coco import CocoObject, intrinsics_from_coco, objects_from_coco
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.geometry import invert, project
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.meshes import load_mesh, sampled
from rpl_data.wording import counted

MODEL_POINTS = 2620
"""As many as the points.xyz of the dataset have; its loaders draw 500 or 2600 of them."""

MAT_HEADING = 116
"""Bytes of text at the start of a MATLAB file, which would hold the time it was written."""


def export_ycb_video(folder: Path, coco: Path, metres_per_unit: Mapping[str, float]) -> DialectSummary:
    """Write `folder` from an exported COCO folder; images that are PNG already are linked.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.

    Raises:
        DataError: a lens has distortion, or the folder cannot be written.
    """
    sequences = {scene: f"{number:04d}" for number, scene in enumerate(sorted(metres_per_unit))}
    images: dict[str, int] = {}
    left_out: Counter[str] = Counter()
    empty: set[str] = set()
    instances = 0
    with replacing(folder) as building:
        for split in splits_of(coco):
            objects = objects_from_coco(split.data)
            names = []
            for image in split.images:
                mine = split.annotations.get(image["id"], [])
                several = len({one["category_id"] for one in mine}) < len(mine)
                left_out["without depth"] += image["depth_file_name"] is None
                left_out["with several instances of an object, which label.png cannot tell apart"] += several
                if several or image["depth_file_name"] is None:
                    continue
                refuse_lens(image, "YCB-Video's layout")
                names.append(f"{sequences[image['scene']]}/{image['frame'] + 1:06d}")
                if not mine:
                    empty.add(names[-1])
                _write_frame(building / "data" / names[-1], coco, image, mine, objects, metres_per_unit)
                instances += len(mine)
            _write_list(building, split.name, [name for name in names if name not in empty])
            images[split.name] = len(names)
        _write_list(building, "classes", [item.model.name for item in objects])
        without_mesh = _write_models(building / "models", coco, objects)
    lines = [f"{counted(count, 'image')} left out, {why}" for why, count in left_out.items() if count]
    if empty:
        lines.append(
            f"{counted(len(empty), 'image')} without an object: in data/, but in no list, since readers "
            "draw an object of each image that is listed"
        )
    return DialectSummary(images, instances, (*lines, *without_mesh))


def _write_list(folder: Path, name: str, lines: Sequence[str]) -> None:
    """Write a list; what is asked for in evaluations is called keyframe."""
    for called in (name, *(["keyframe"] if name == "test" else [])):
        write_text(folder / "image_sets" / f"{called}.txt", "".join(f"{line}\n" for line in lines))


def _write_frame(
    stem: Path,
    coco: Path,
    image: Json,
    annotations: Sequence[Json],
    objects: Sequence[CocoObject],
    metres_per_unit: Mapping[str, float],
) -> None:
    unit_m = metres_per_unit[image["scene"]]
    write_color(coco / image["file_name"], stem.with_name(f"{stem.name}-color"), "png")
    write_depth(coco / image["depth_file_name"], stem.with_name(f"{stem.name}-depth.png"), unit_m, unit_m)
    label = numbered(image, annotations, [one["category_id"] for one in annotations])
    write_bytes(stem.with_name(f"{stem.name}-label.png"), encoded(label, "png"))
    boxes = []
    for one in annotations:
        x, y, width, height = one["bbox"]
        name = objects[one["category_id"] - 1].model.name
        boxes.append(f"{name} {x:.2f} {y:.2f} {x + width:.2f} {y + height:.2f}\n")
    write_text(stem.with_name(f"{stem.name}-box.txt"), "".join(boxes))
    write_bytes(stem.with_name(f"{stem.name}-meta.mat"), _mat(_meta(image, annotations, unit_m)))


def _meta(image: Json, annotations: Sequence[Json], metres_per_unit: float) -> dict[str, Any]:
    """The arrays of meta.mat.

    `center` (n, 2): the objects' origins in the image, px; `cls_indexes` (n, 1): their numbers, from 1;
    `factor_depth`; `intrinsic_matrix` (3, 3); `poses` (3, 4, n): camera_from_object, metres;
    `rotation_translation_matrix` (3, 4): camera_from_scene, metres.
    """
    camera = intrinsics_from_coco(image)
    poses = np.array([matrix_from_json(one["camera_from_object"]) for one in annotations]).reshape(-1, 4, 4)
    return {
        "center": project(camera, np.ascontiguousarray(poses[:, :3, 3])),
        "cls_indexes": np.array([[one["category_id"]] for one in annotations], np.uint8).reshape(-1, 1),
        "factor_depth": np.array([[1 / metres_per_unit]]),
        "intrinsic_matrix": camera.matrix,
        "poses": np.moveaxis(poses[:, :3], 0, 2),
        "rotation_translation_matrix": invert(matrix_from_json(image["scene_from_camera"]))[:3],
    }


def _mat(arrays: Mapping[str, Any]) -> bytes:
    """A MATLAB file; the same arrays give the same bytes."""
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, dict(arrays), do_compression=True)
    return b"MATLAB 5.0 MAT-file, made by rpl-data".ljust(MAT_HEADING) + file.getvalue()[MAT_HEADING:]


def _write_models(folder: Path, coco: Path, objects: Sequence[CocoObject]) -> list[str]:
    """Write the models; returns lines about objects without one."""
    lines = []
    for item in objects:
        if item.mesh is None:
            lines.append(f"{item.model.name} has no dense model, so no models/{item.model.name}")
            continue
        mesh = load_mesh(coco / item.mesh)
        points = "".join(
            f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in sampled(mesh, count=MODEL_POINTS).tolist()
        )
        write_text(folder / item.model.name / "points.xyz", points)
        save_textured(mesh, [folder / item.model.name / "textured.obj"])
    return lines
