"""The layout of LINEMOD as trainers read it (`Linemod_preprocessed`): one folder of images per object.

::

    <folder>/data/01/rgb/0000.png      8 bit
                     depth/0000.png    16 bit, millimetres
                     mask/0000.png     255 in all three channels where the object is seen
                     gt.yml            per image: cam_R_m2c (9 numbers, row-major), cam_t_m2c (mm), obj_bb
                                       (x, y, width, height of its box as if nothing hid it), obj_id
                     info.yml          per image: cam_K (9 numbers, row-major), depth_scale
                     {train,val,test}.txt
             models/obj_01.ply         text, millimetres; models_info.yml: sizes, mm
             names.yml                 names of the objects, and where their images are from

Layout: the loader `datasets/linemod/dataset.py` of https://github.com/j96w/DenseFusion, which takes the
number of vertices from the fourth line of a model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from rpl_data.export.bop_models import model_info
from rpl_data.export.color_images import write_color
from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import replacing
from rpl_data.export.views import MILLIMETRE, View, refuse_distortion, views_of, write_depth
from rpl_data.files import write_bytes, write_text
from rpl_data.formats.datasets.coco import CocoObject, objects_from_coco
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.meshes import load_mesh, vertex_normals
from rpl_data.types import Mesh
from rpl_data.wording import counted

GREY = (128, 128, 128)
"""Colour of models without colours: the layout has some."""


def export_linemod(folder: Path, coco: Path, metres_per_unit: Mapping[str, float]) -> DialectSummary:
    """Write `folder` from an exported COCO folder.

    An image that shows several instances of an object is there once for each, one without depth not at all.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.

    Raises:
        DataError: a lens has distortion, or the folder cannot be written.
    """
    images: dict[str, int] = {}
    written: dict[int, list[View]] = {}
    objects: Sequence[CocoObject] = ()
    converted: dict[int, Path] = {}
    labels = 0
    with replacing(folder) as building:
        for split in splits_of(coco):
            objects, images[split.name] = objects_from_coco(split.data), 0
            labels += len(split.data["annotations"])
            for number in range(1, len(objects) + 1):
                views, before = views_of(split, number), written.setdefault(number, [])
                refuse_distortion(views, "LINEMOD's layout")
                names = [f"{len(before) + row:04d}" for row in range(len(views))]
                place = building / "data" / f"{number:02d}"
                for name, view in zip(names, views, strict=True):
                    _write_images(place, name, view, coco, metres_per_unit, converted)
                write_text(place / f"{split.name}.txt", "".join(f"{name}\n" for name in names))
                before += views
                images[split.name] += len(views)
        for number, views in written.items():
            _write_truth(building / "data" / f"{number:02d}", number, views)
        lines = _write_models(building / "models", coco, objects)
        _write_yaml(building / "names.yml", _sources(objects, written))
    instances = sum(map(len, written.values()))
    if instances < labels:
        lines.append(f"{counted(labels - instances, 'label')} left out, in images without depth")
    return DialectSummary(images, instances, tuple(lines))


def _write_images(
    folder: Path,
    name: str,
    view: View,
    coco: Path,
    metres_per_unit: Mapping[str, float],
    converted: dict[int, Path],
) -> None:
    """Write the images of a view; `converted` has the colour images so far, by image id."""
    from pycocotools import mask as masks

    unit_m = metres_per_unit[view.image["scene"]]
    color = converted.get(view.image["id"], coco / view.image["file_name"])
    converted[view.image["id"]] = write_color(color, folder / "rgb" / name, "png")
    write_depth(coco / view.image["depth_file_name"], folder / "depth" / f"{name}.png", unit_m, MILLIMETRE)
    seen = masks.decode(view.annotation["segmentation"])
    write_bytes(folder / "mask" / f"{name}.png", encoded(np.repeat(255 * seen[..., None], 3, axis=2), "png"))


def _write_truth(folder: Path, number: int, views: Sequence[View]) -> None:
    """Write gt.yml and info.yml."""
    truth, cameras = {}, {}
    for index, view in enumerate(views):
        pose = matrix_from_json(view.annotation["camera_from_object"])
        truth[index] = [
            {
                "cam_R_m2c": pose[:3, :3].ravel().tolist(),
                "cam_t_m2c": (1000 * pose[:3, 3]).tolist(),
                "obj_bb": [round(side) for side in view.annotation["bbox_full"]],
                "obj_id": number,
            }
        ]
        cameras[index] = {"cam_K": view.camera.matrix.ravel().tolist(), "depth_scale": 1.0}
    _write_yaml(folder / "gt.yml", truth)
    _write_yaml(folder / "info.yml", cameras)


def _sources(objects: Sequence[CocoObject], written: Mapping[int, Sequence[View]]) -> dict[int, Json]:
    return {
        number: {
            "name": item.model.name,
            "frames": [f"{view.image['scene']}/{view.image['frame']:06d}" for view in written[number]],
        }
        for number, item in enumerate(objects, start=1)
    }


def _write_models(folder: Path, coco: Path, objects: Sequence[CocoObject]) -> list[str]:
    """Write the models and their sizes; returns lines about objects without one."""
    lines, info = [], {}
    for number, item in enumerate(objects, start=1):
        if item.mesh is None:
            lines.append(f"{item.model.name} has no dense model, so no models/obj_{number:02d}.ply")
            continue
        mesh = load_mesh(coco / item.mesh)
        in_mm = replace(mesh, vertices=1000 * mesh.vertices)
        write_text(folder / f"obj_{number:02d}.ply", _ply_text(in_mm))
        info[number] = model_info(in_mm)
    _write_yaml(folder / "models_info.yml", info)
    return lines


def _ply_text(mesh: Mesh) -> str:
    """A mesh as text, with normals and colours."""
    colors = np.full(mesh.vertices.shape, GREY) if mesh.colors is None else mesh.colors
    heading = ["ply", "format ascii 1.0", "comment millimetres", f"element vertex {len(mesh.vertices)}"]
    heading += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    heading += [f"property uchar {name}" for name in ("red", "green", "blue")]
    heading += [f"element face {len(mesh.triangles)}", "property list uchar int vertex_indices", "end_header"]
    rows = [
        f"{x:.4f} {y:.4f} {z:.4f} {nx:.4f} {ny:.4f} {nz:.4f} {red} {green} {blue}"
        for (x, y, z), (nx, ny, nz), (red, green, blue) in zip(
            mesh.vertices.tolist(), vertex_normals(mesh).tolist(), colors.tolist(), strict=True
        )
    ]
    faces = [f"3 {a} {b} {c}" for a, b, c in mesh.triangles.tolist()]
    return "\n".join([*heading, *rows, *faces, ""])


def _write_yaml(path: Path, content: object) -> None:
    write_text(path, yaml.dump(content, Dumper=DUMPER, default_flow_style=None, sort_keys=False))


DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""PyYAML's dumper in C, where it has one."""
