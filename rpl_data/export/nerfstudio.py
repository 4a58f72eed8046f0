"""Posed images of each scene, for nerfstudio and, as COLMAP text, for Gaussian splatting.

::

    <folder>/<scene>/transforms.json                    cameras in OpenGL axes, metres
                     images/000000.jpg depth/000000.png
                     sparse/0/{cameras,images,points3D}.txt

Both count pixels so that the centre of the first one is (0.5, 0.5); ours is (0, 0), so the principal point
moves by half a pixel. Depth images are those of the recording; `depth_unit_scale_factor` gives their metres
per unit. Layouts: https://docs.nerf.studio/quickstart/data_conventions.html and
https://colmap.github.io/format.html (world-to-camera, quaternions w x y z).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.files import write_json, write_text
from rpl_data.formats.datasets.coco import intrinsics_from_coco
from rpl_data.formats.recordings.nerfstudio import HALF_PIXEL
from rpl_data.geometry import OPENGL_AXES, invert, to_quaternion_xyzw
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.types import DataError, Intrinsics

MOST_COEFFICIENTS = 4
"""k1, k2, p1, p2: nerfstudio's and COLMAP's OPENCV model holds no more."""


def export_nerfstudio(folder: Path, coco: Path, metres_per_unit: Mapping[str, float]) -> DialectSummary:
    """Write `folder` from all splits of an exported COCO folder; images are linked.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.

    Raises:
        DataError: a lens has more distortion than four coefficients hold, or the folder cannot be written.
    """
    scenes: dict[str, list[Json]] = {}
    images: dict[str, int] = {}
    for split in splits_of(coco):
        images[split.name] = len(split.images)
        for image in split.images:
            scenes.setdefault(image["scene"], []).append(image)
    with replacing(folder) as building:
        for scene, mine in scenes.items():
            ordered = sorted(mine, key=lambda image: int(image["frame"]))
            _write_scene(building / scene, coco, ordered, metres_per_unit[scene])
    return DialectSummary(images)


def _write_scene(folder: Path, coco: Path, images: Sequence[Json], metres_per_unit: float) -> None:
    camera = intrinsics_from_coco(images[0])
    lens = _lens(camera, images[0]["scene"])
    frames = []
    for image in images:
        files = {"file_path": ("images", coco / image["file_name"])}
        if image["depth_file_name"] is not None:
            files["depth_file_path"] = ("depth", coco / image["depth_file_name"])
        frame: Json = {}
        for key, (kind, source) in files.items():
            frame[key] = f"{kind}/{image['frame']:06d}{source.suffix}"
            link(source, folder / frame[key])
        pose = matrix_from_json(image["scene_from_camera"]) @ OPENGL_AXES
        frames.append(frame | {"transform_matrix": pose.tolist()})
    transforms = {
        "camera_model": "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + HALF_PIXEL,
        "cy": camera.cy + HALF_PIXEL,
        **dict(zip(("k1", "k2", "p1", "p2"), lens, strict=True)),
        "depth_unit_scale_factor": metres_per_unit,
        "frames": frames,
    }
    write_json(folder / "transforms.json", transforms)
    _write_colmap(folder / "sparse" / "0", images, camera, lens)


def _lens(camera: Intrinsics, scene: str) -> tuple[float, ...]:
    """Four coefficients of distortion; DataError where that is not all of it."""
    if any(camera.distortion[MOST_COEFFICIENTS:]):
        raise DataError(
            f"scene {scene} was taken by a lens with more than four coefficients of distortion, which "
            "nerfstudio and COLMAP do not take; undistort the recording first"
        )
    return (*camera.distortion, *(0.0,) * MOST_COEFFICIENTS)[:MOST_COEFFICIENTS]


def _write_colmap(folder: Path, images: Sequence[Json], camera: Intrinsics, lens: Sequence[float]) -> None:
    values = (camera.fx, camera.fy, camera.cx + HALF_PIXEL, camera.cy + HALF_PIXEL, *lens)
    write_text(folder / "cameras.txt", f"1 OPENCV {camera.width} {camera.height} {_words(values)}\n")
    lines = []
    for number, image in enumerate(images, start=1):
        camera_from_scene = invert(matrix_from_json(image["scene_from_camera"]))
        x, y, z, w = to_quaternion_xyzw(camera_from_scene)
        place = _words((w, x, y, z, *camera_from_scene[:3, 3]))
        name = f"{image['frame']:06d}{Path(image['file_name']).suffix}"
        lines.append(f"{number} {place} 1 {name}\n\n")  # the empty line: no points are seen in it
    write_text(folder / "images.txt", "".join(lines))
    write_text(folder / "points3D.txt", "")


def _words(values: Sequence[float]) -> str:
    return " ".join(f"{float(value):.12g}" for value in values)
