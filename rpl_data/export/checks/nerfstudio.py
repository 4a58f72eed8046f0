"""Check of posed images for nerfstudio and COLMAP; the layout is described in `export.nerfstudio`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.rules import Rules, at_least, between, one_of, pixel, positive, rigid, sized
from rpl_data.geometry import OPENGL_AXES, from_quaternion_xyzw, invert
from rpl_data.json_arrays import Json, each, number, text

LENS = ("k1", "k2", "p1", "p2")
RULES: Rules = {
    "camera_model": one_of(["OPENCV"], "OPENCV"),
    "w": at_least(1),
    "h": at_least(1),
    "fl_x": positive,
    "fl_y": positive,
    "cx": pixel,
    "cy": pixel,
    **{key: between(-1e4, 1e4) for key in LENS},
    "depth_unit_scale_factor": positive,
    "frames": each(lambda entry: entry),
}
POSE_DIFFERENCE = 1e-6
"""By how much the two files' poses may differ: COLMAP's text has 12 digits."""


def looks_like_nerfstudio(folder: Path) -> bool:
    """Whether a folder has scenes in both layouts, without the points that COLMAP would have found.

    Any other folder with transforms.json is a recording like others.
    """
    points = [path.parent / "sparse" / "0" / "points3D.txt" for path in folder.glob("*/transforms.json")]
    return any(path.is_file() and not path.stat().st_size for path in points)


def check_nerfstudio(findings: Findings) -> None:
    """Check each scene."""
    scenes = sorted(path.name for path in findings.folder.iterdir() if path.is_dir())
    if not scenes:
        findings.add("", "", "", "there is no scene")
    for scene in scenes:
        file = f"{scene}/transforms.json"
        data = findings.json_objects(file)
        if not data or not findings.fields(data, RULES, file, ""):
            continue
        poses = {}
        for row, frame in enumerate(data["frames"]):
            found = _check_frame(findings, scene, frame, f"frame number {row}", (data["w"], data["h"]))
            if found is not None:
                poses[found[0]] = found[1]
        if len(poses) < len(data["frames"]) and all(isinstance(frame, dict) for frame in data["frames"]):
            names = [frame.get("file_path") for frame in data["frames"]]
            if len(set(map(str, names))) < len(names):
                findings.add(file, "", "frames", "an image is listed twice")
        _check_colmap(findings, scene, data, poses)


def _matrix(values: Any) -> None:
    """Rule: four rows of four numbers, a rigid transform."""
    sized(4, sized(4))(values)
    rigid([number(value) for row in values for value in row])


def _check_frame(
    findings: Findings, scene: str, frame: Any, record: str, size: Sequence[int]
) -> tuple[str, np.ndarray] | None:
    """Name of the image and its pose ``scene_from_camera``."""
    file = f"{scene}/transforms.json"
    if not findings.fields(frame, {"file_path": text, "transform_matrix": _matrix}, file, record):
        return None
    for key, kind in (("file_path", "color"), ("depth_file_path", "depth")):
        if key not in frame:
            if (findings.folder / scene / "depth").is_dir():
                findings.add(file, record, key, "missing, though there are depth images")
        elif findings.rule(file, record, key, text, frame[key]) and findings.named(
            f"{scene}/{frame[key]}", file, record, key
        ):
            findings.image(f"{scene}/{frame[key]}", size=size, like=f"{file}, w and h", kind=kind)
    return Path(frame["file_path"]).name, np.array(frame["transform_matrix"]) @ OPENGL_AXES


def _check_colmap(findings: Findings, scene: str, data: Json, poses: dict[str, np.ndarray]) -> None:
    """COLMAP's text says the same as transforms.json."""
    place = f"{scene}/sparse/0"
    words = [line.split() for line in findings.lines(f"{place}/cameras.txt") if not line.startswith("#")]
    camera = [1, data["w"], data["h"], *(data[key] for key in ("fl_x", "fl_y", "cx", "cy", *LENS))]
    try:
        (one,) = words
        given = [float(word) for word in (one[0], *one[2:])]
        if one[1] != "OPENCV" or not np.allclose(given, camera, rtol=1e-9, atol=1e-9):
            raise ValueError(f"expected the camera of transforms.json, found {' '.join(one):.120}")
    except (ValueError, IndexError) as error:
        findings.add(f"{place}/cameras.txt", "line 1", "numbers", str(error))
    findings.lines(f"{place}/points3D.txt")
    lines = findings.lines(f"{place}/images.txt")
    seen: set[str] = set()
    ids: set[str] = set()
    for row in range(0, len(lines), 2):
        record = f"line {row + 1}"
        try:
            number, w, x, y, z, *translation, which, name = lines[row].split()
            tx, ty, tz = (float(value) for value in translation)
            turn = np.array([float(value) for value in (x, y, z, w)])
            found = from_quaternion_xyzw(turn, np.array([tx, ty, tz]))
            if which != "1" or name in seen or number in ids:
                raise ValueError(f"expected camera 1 and each image once, found {which} {name}")
            if int(number) < 0 or abs(np.linalg.norm(turn) - 1) > POSE_DIFFERENCE:
                raise ValueError(f"expected a number and a unit quaternion, found {lines[row]:.60}")
        except (ValueError, TypeError) as error:
            findings.add(
                f"{place}/images.txt", record, "", f"expected id, qw qx qy qz, t, camera, name: {error}"
            )
            continue
        seen.add(name)
        ids.add(number)
        if name not in poses:
            findings.add(
                f"{place}/images.txt", record, "name", f"{scene}/transforms.json has it in no frame: {name}"
            )
        elif np.abs(found - invert(poses[name])).max() > POSE_DIFFERENCE * (1 + np.abs(poses[name]).max()):
            findings.add(f"{place}/images.txt", record, "pose", f"transforms.json has another one for {name}")
    for name in sorted(poses.keys() - seen):
        findings.add(f"{place}/images.txt", "", "name", f"{name} is missing")
