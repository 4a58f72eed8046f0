"""Recordings of a ZED camera, as its SDK exports them: images of the left camera with depth in millimetres.

::

    <scene>/left000123.png       the rectified left image
            depth000123.png      16 bit, millimetres, at the pixels of the left image

Its own files (.svo, .svo2) are read by its SDK alone, which needs an NVIDIA graphics card. Bags of
zed-ros-wrapper are ROS bags like others.
Source: stereolabs/zed-sdk, recording/export/svo/python/svo_export.py, mode 4.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from rpl_data.formats.recordings.camera_file import told_of
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    without_poses,
)
from rpl_data.formats.recordings.scene_folders import chosen, scene_folders
from rpl_data.formats.recordings.times import FRAME_RATE_HZ
from rpl_data.types import DataError, Recording

_LEFT = re.compile(r"left(\d{6})\.png")
_SVO = (".svo", ".svo2")


def read_zed(
    path: Path,
    *,
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one exported folder, or those in a folder, sorted by name.

    Args:
        path: a folder with left<number>.png and depth<number>.png, or with such folders.
        names: which scenes to read, by folder name.
        metres_per_unit: unit of the depth images; that of camera.txt when not given, else 0.001.
        camera: the rectified left camera; needed, unless a camera.txt beside the images holds it: the export
            does not.

    Raises:
        DataError: there is no such folder, no camera, or only the camera's own file, with how to export it.
    """
    path = path.absolute()
    found = scene_folders(path, has_export)
    if not found:
        _refuse_svo(path)
        raise DataError(f"{path} has no left<number>.png with depth<number>.png, nor has any folder in it")
    return [
        _read_scene(name, folder, metres_per_unit, camera)
        for name, folder in chosen(found, names, path).items()
    ]


def has_export(folder: Path) -> bool:
    """Whether a folder holds images that ZED's SDK exported with depth."""
    return folder.is_dir() and any(
        folder.joinpath(f"depth{left[1]}.png").exists()
        for left in map(_LEFT.fullmatch, (file.name for file in folder.iterdir()))
        if left
    )


def is_zed(path: Path) -> bool:
    """Whether a path is a file of a ZED camera, or holds exported images of one."""
    if not path.is_dir():
        return path.suffix in _SVO
    return bool(scene_folders(path, has_export)) or any(path.glob("*.svo*"))


def _refuse_svo(path: Path) -> None:
    files = [path] if path.suffix in _SVO else sorted(path.glob("*.svo*"))
    if files:
        raise DataError(
            f"{files[0]} can be read by the ZED SDK only; export it (zed-sdk, recording/export/svo): `python "
            "svo_export.py --mode 4 --input_svo_file FILE --output_path_dir FOLDER`, and give that folder"
        )


def _read_scene(name: str, folder: Path, unit_m: float | None, camera: Camera | None) -> Recording:
    told = told_of(folder, camera=camera, metres_per_unit=unit_m)
    if told.camera is None:
        raise DataError(
            f"{folder}: ZED's export does not hold the camera; give `camera: [fx, fy, cx, cy]` in "
            "pixels, or write these numbers into camera.txt beside the images: those of the left camera in "
            "`get_camera_information().camera_configuration.calibration_parameters`"
        )
    pairs = []
    for file in sorted(folder.iterdir()):
        left = _LEFT.fullmatch(file.name)
        if left:
            number = int(left[1])
            pairs.append(Pair(number, number / FRAME_RATE_HZ, file, folder / f"depth{left[1]}.png"))
    listing = Listing(
        name,
        folder,
        "zed",
        pairs,
        told.camera,
        told.source,
        0.001 if told.metres_per_unit is None else told.metres_per_unit,
        notes=(f"no timestamps: {FRAME_RATE_HZ:g} frames per second assumed",),
    )
    return without_poses(examine(listing), "poses in ZED's export")
