"""`transforms.json` of nerfstudio and instant-ngp, with depth images.

::

    <scene>/transforms.json    fl_x fl_y cx cy w h k1 k2 p1 p2 camera_model, for all frames or in each
                               frames: [{file_path, depth_file_path, transform_matrix}, ...] in any order
            images/ depth/     wherever the paths say; depth 16-bit PNG or npy, 0.001 m per unit

`transform_matrix` is scene_from_camera of a camera with y up that looks along -z (docs.nerf.studio, "Data
conventions"; nerfstudio's dataparser has 1e-3 m as its default `depth_unit_scale_factor`, which some tools
write into the file). Some tools shrink the world: `applied_scale` undoes it, and where nothing is said,
`rpl check` sees that depth and poses disagree. The centre of the first pixel is (0.5, 0.5) there
(nerfstudio's cameras.py, `get_image_coords(pixel_offset=0.5)`), so half a pixel is taken off `cx cy`. There
are no times: 30 frames per second are assumed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import decoding, read_json
from rpl_data.formats.recordings.frame_files import Camera
from rpl_data.formats.recordings.matrices import rigid_or_none
from rpl_data.formats.recordings.phones import App, Phone, PhoneFrame
from rpl_data.formats.recordings.times import FRAME_RATE_HZ
from rpl_data.geometry import OPENGL_AXES, Transform
from rpl_data.types import DataError, Recording
from rpl_data.wording import counted

HALF_PIXEL = 0.5

LIST = "transforms.json"
_PINHOLE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")


def read_nerfstudio(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one scene, or the scenes in the folders of a folder, sorted by name.

    `Frame.index` is the position among the names of the colour images, sorted as numbers.

    Args:
        path: a folder with transforms.json, or with such folders.
        unpack: returns the folder for depth that is no 16-bit PNG, given the scene's name.
        names: which scenes to read, by folder name.
        metres_per_unit: unit of the depth images; that of the file or of a camera.txt, else 0.001, when None.
        camera: used instead of the file's.

    Raises:
        DataError: there is no such file, it is broken, names no depth, or a fisheye camera.
    """
    app = App(is_nerfstudio, LIST, _scene)
    return app.recordings(path, unpack=unpack, names=names, metres_per_unit=metres_per_unit, camera=camera)


def is_nerfstudio(folder: Path) -> bool:
    """Whether the folder has a transforms.json."""
    return (folder / LIST).is_file()


def _scene(name: str, folder: Path) -> Phone:
    with decoding(folder / LIST, "export it again"):
        said = read_json(folder / LIST)
        listed = [frame for frame in said["frames"] if "depth_file_path" in frame]
        without = len(said["frames"]) - len(listed)
        if not listed:
            raise DataError(f"{folder / LIST} names no depth image (depth_file_path); export depth as well")
        listed.sort(key=lambda frame: _key(str(frame["file_path"])))
        scale = float(said.get("applied_scale", 1.0))
        frames = [_frame(folder, index, said, frame, scale) for index, frame in enumerate(listed)]
        unit_m = float(said["depth_unit_scale_factor"]) if "depth_unit_scale_factor" in said else None
        size = (int(said["w"]), int(said["h"])) if "w" in said and "h" in said else None
    notes = [f"no times: {FRAME_RATE_HZ:g} frames per second assumed"]
    notes += [f"the world was scaled by {scale:g}, which is undone"] if scale != 1 else []
    skipped = [f"{counted(without, 'frame')} of the list without depth_file_path"] if without else []
    return Phone(
        name,
        folder,
        "nerfstudio",
        frames,
        camera_px=size,
        metres_per_unit=unit_m,
        notes=tuple(notes),
        skipped=tuple(skipped),
    )


def _key(name: str) -> tuple[list[int], str]:
    """Sorts names as numbers."""
    return [int(digits) for digits in re.findall(r"\d{1,18}", name)], name


def _frame(
    folder: Path, index: int, said: Mapping[str, Any], frame: Mapping[str, Any], scale: float
) -> PhoneFrame:
    pose = _pose(frame["transform_matrix"], scale)
    color, depth = _image(folder / str(frame["file_path"])), folder / str(frame["depth_file_path"])
    return PhoneFrame(index, index / FRAME_RATE_HZ, color, depth, None, _camera({**said, **frame}), pose)


def _image(path: Path) -> Path:
    """The colour image; instant-ngp and NeRF's own scenes leave the suffix out."""
    endings = (path, *(path.with_name(path.name + suffix) for suffix in (".png", ".jpg")))
    return next((ending for ending in endings if ending.is_file()), path)


def _pose(matrix: Any, scale: float) -> Transform | None:
    pose = rigid_or_none(np.asarray(matrix, dtype=float).ravel().tolist())
    if pose is None:
        return None
    pose[:3, 3] /= scale
    return pose @ OPENGL_AXES


def _camera(said: Mapping[str, Any]) -> Camera:
    """fx, fy, cx, cy and OpenCV's distortion of a frame."""
    model = str(said.get("camera_model", "OPENCV")).upper()
    if model not in _PINHOLE or said.get("is_fisheye"):
        raise DataError(f"{LIST}: the camera model is {model}; undistort the images first")
    if "fl_x" in said:
        fx = float(said["fl_x"])
    else:
        fx = float(said["w"]) / 2 / math.tan(float(said["camera_angle_x"]) / 2)
    fy = float(said.get("fl_y", fx))
    cx, cy = (float(said[key] if key in said else said[size] / 2) - HALF_PIXEL
              for key, size in (("cx", "w"), ("cy", "h")))  # fmt: skip
    if float(said.get("k4", 0.0)):
        raise DataError(f"{LIST}: k4 of the lens cannot be read; undistort the images first")
    distortion = tuple(float(said.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2", "k3"))
    return (fx, fy, cx, cy, *(distortion if any(distortion) else ()))
