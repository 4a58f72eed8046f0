"""Polycam's raw data: ARKit's key frames with one JSON file each.

::

    <capture>/keyframes/images/<us>.jpg  cameras/<us>.json  depth/<us>.png  confidence/<us>.png
              keyframes/corrected_images/ corrected_cameras/     undistorted images, poses optimised

Source: github.com/PolyCam/polyform, README.md and polyform/core/capture_folder.py. Names are microseconds.
`fx fy cx cy width height t_00 ... t_23` are the camera and the upper rows of scene_from_camera, row by row,
in ARKit's axes. Depth is in mm, of its own size; confidence 0, 127 or 255, of which 0 is useless.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rpl_data.formats.recordings.frame_files import Camera, grouped
from rpl_data.formats.recordings.phones import (
    App,
    Phone,
    PhoneFrame,
    arkit_pose,
    has_confidence,
    json_or_empty,
)
from rpl_data.types import Recording

_KEYS = ("fx", "fy", "cx", "cy", *(f"t_{row}{column}" for row in range(3) for column in range(4)))


def read_polycam(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one capture, or the captures in the folders of a folder, sorted by name.

    Colour stays where it is; depth is written anew without what is of low confidence. Corrected images and
    cameras are preferred. `Frame.index` is the position of the key frame in time.

    Args:
        path: a capture, or a folder of captures.
        unpack: returns the folder for the depth images of a scene, given its name.
        names: which captures to read, by folder name.
        metres_per_unit: unit of the depth images; 0.001 by the format.
        camera: used instead of the app's.

    Raises:
        DataError: there is no capture, its files are broken, or no frame is complete.
    """
    app = App(is_polycam, "keyframes/depth", _capture)
    return app.recordings(path, unpack=unpack, names=names, metres_per_unit=metres_per_unit, camera=camera)


def is_polycam(folder: Path) -> bool:
    """Whether the folder is a capture of this app."""
    return (folder / "keyframes/depth").is_dir()


def _capture(name: str, folder: Path) -> Phone:
    place = folder / "keyframes"
    corrected = (place / "corrected_cameras").is_dir() and (place / "corrected_images").is_dir()
    prefix = "corrected_" if corrected else ""
    stamps = sorted(
        int(path.stem) for path in (place / f"{prefix}cameras").glob("*.json") if path.stem.isdigit()
    )
    frames, broken, sizes = [], [], set()
    marked = has_confidence(place)
    for index, stamp in enumerate(stamps):
        said = json_or_empty(place / f"{prefix}cameras/{stamp}.json")
        values = _numbers(said)
        if values is None:
            broken.append(index)
            continue
        sizes.add((int(said.get("width", 0)), int(said.get("height", 0))))
        confidence = place / f"confidence/{stamp}.png"
        frames.append(
            PhoneFrame(
                index,
                stamp * 1e-6,
                place / f"{prefix}images/{stamp}.jpg",
                place / f"depth/{stamp}.png",
                confidence if marked else None,
                tuple(values[:4]),
                arkit_pose(values[4:]),
            )
        )
    which = "corrected" if corrected else "uncorrected: the session was too long for Polycam to correct"
    return Phone(
        name,
        folder,
        "polycam",
        frames,
        camera_px=sizes.pop() if len(sizes) == 1 and (0, 0) not in sizes else None,
        notes=(f"images and cameras are {which}",),
        skipped=tuple(grouped(broken, "with a camera file that is damaged")),
    )


def _numbers(said: Mapping[str, Any]) -> list[float] | None:
    """The camera and the pose of a frame; None where a number is missing, or is none."""
    values = [float(x) for x in map(said.get, _KEYS) if isinstance(x, (int, float)) and math.isfinite(x)]
    return values if len(values) == len(_KEYS) else None
