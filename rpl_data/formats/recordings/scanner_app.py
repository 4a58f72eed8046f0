"""3D Scanner App's "all data" export: ARKit's frames with one JSON file each.

::

    <scan>/frame_00012.jpg  frame_00012.json  depth_00012.png  conf_00012.png

`intrinsics` are K row by row, `cameraPoseARFrame` is scene_from_camera row by row in ARKit's axes, `time` in
seconds. Only some frames have an image. Depth is in mm, of its own size; confidence 0, 1 or 2. There is no
documentation by the maker (laan.com): this is what public readers agree on, pwais/psegs among them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.formats.recordings.frame_files import Camera, grouped
from rpl_data.formats.recordings.phones import (
    App,
    Phone,
    PhoneFrame,
    arkit_pose,
    json_or_empty,
)
from rpl_data.types import Recording
from rpl_data.wording import counted

RATE_HZ = 60.0
"""Assumed frame rate of versions that write no times."""

_FRAME = re.compile(r"frame_(\d{1,9})\.json")


def read_scanner_app(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one scan, or the scans in the folders of a folder, sorted by name.

    Colour stays where it is; depth is written anew without what is of low confidence. `Frame.index` is the
    number in the file's name.

    Args:
        path: a scan, or a folder of scans.
        unpack: returns the folder for the depth images of a scene, given its name.
        names: which scans to read, by folder name.
        metres_per_unit: unit of the depth images; 0.001 by the format.
        camera: used instead of the app's.

    Raises:
        DataError: there is no scan, its files are broken, or no frame is complete.
    """
    app = App(is_scanner_app, "frame_00000.json", _scan)
    return app.recordings(path, unpack=unpack, names=names, metres_per_unit=metres_per_unit, camera=camera)


def is_scanner_app(folder: Path) -> bool:
    """Whether the folder is a scan of this app."""
    return folder.is_dir() and any(_FRAME.fullmatch(path.name) for path in folder.glob("frame_*.json"))


def _scan(name: str, folder: Path) -> Phone:
    files = {int(found[1]): path for path in folder.glob("frame_*.json")
             if (found := _FRAME.fullmatch(path.name))}  # fmt: skip
    frames, broken, without = [], [], 0
    for index, path in sorted(files.items()):
        number = path.stem.removeprefix("frame_")
        color = path.with_suffix(".jpg")
        if not color.is_file():
            without += 1
            continue
        said = json_or_empty(path)
        lens, pose = _numbers(said.get("intrinsics"), 9), _numbers(said.get("cameraPoseARFrame"), 16)
        time_s = said.get("time", index / RATE_HZ)
        if not lens or not pose or not isinstance(time_s, (int, float)):
            broken.append(index)
            continue
        confidence = folder / f"conf_{number}.png"
        frames.append(
            PhoneFrame(
                index,
                float(time_s),
                color,
                folder / f"depth_{number}.png",
                confidence if confidence.is_file() else None,
                (lens[0], lens[4], lens[2], lens[5]),
                arkit_pose(pose),
            )
        )
    note = f"{counted(without, 'frame')} without a colour image: the app stores one for some frames only"
    skipped = tuple(grouped(broken, "with a camera file that is damaged"))
    return Phone(name, folder, "scanner_app", frames, notes=(note,) if without else (), skipped=skipped)


def _numbers(value: Any, count: int) -> list[float]:
    """A list of so many finite numbers; empty for anything else."""
    listed = isinstance(value, list) and len(value) == count
    whole = listed and all(isinstance(x, (int, float)) and np.isfinite(x) for x in value)
    return [float(x) for x in value] if whole else []
