"""RapidPoseLabels' sparse_model.txt: the keypoints in the frame of the first scene (the paper's F_w).

::

    <SparseObjectPoints>
        <point x="0.1" y="-0.2" z="1e-05" name="0"/>
    </SparseObjectPoints>
    <GraspPoint> four rows of a matrix, [0.1, 0.2, 0.3, 0.4] each </GraspPoint>

The file looks like XML but is not (it has two roots); the original's reader loses exponents and signs.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rpl_data.files import decoding, read_text, write_text
from rpl_data.geometry import Points, Transform, transform
from rpl_data.types import DataError, Solution

_NUMBER = re.compile(r"[-+0-9.eE]+")
_ATTRIBUTE = re.compile(r"\b(\w{1,20})\s{0,9}=\s{0,9}[\"']([^\"']{0,60})[\"']")
MOST_POINTS = 10_000
"""A greater number in a file is a fault; every number below it costs a row."""


def read_sparse_model(path: Path) -> Points:
    """Read the keypoints: one row each, metres, first scene's frame; NaN for a number the file leaves out.

    When a file was appended to, the last model counts; a grasp point is ignored.

    Raises:
        DataError: there is no model, or a point without finite x, y, z or with a name used twice.
    """
    block = _last_block(read_text(path), "SparseObjectPoints")
    if block is None:
        raise DataError(
            f"{path} holds no <SparseObjectPoints> block; expected a sparse model of RapidPoseLabels"
        )
    points: dict[int, list[float]] = {}
    for words in re.split(r"<point\b", block)[1:]:
        element = f"<point{words.partition('>')[0][:300]}>"
        attributes = dict(_ATTRIBUTE.findall(element))
        try:
            number = int(attributes["name"])
            xyz = [float(attributes[axis]) for axis in "xyz"]
        except (KeyError, ValueError) as error:
            raise DataError(f"{path}: {element} needs numbers x, y, z and a whole number name") from error
        if not np.isfinite(xyz).all() or not 0 <= number < MOST_POINTS or number in points:
            raise DataError(
                f"{path}: {element} is not finite, or its name is used twice or is not from 0 to "
                f"{MOST_POINTS - 1}"
            )
        points[number] = xyz
    if not points:
        raise DataError(f"{path}: the last <SparseObjectPoints> block has no points")
    model = np.full((max(points) + 1, 3), np.nan)
    model[list(points)] = list(points.values())
    return model


def _last_block(text: str, name: str) -> str | None:
    """What stands between the last whole pair of tags of that name; None where there is none.

    Searched from the end, in time proportional to the length of the text; a pattern that tries every
    beginning takes the square of it.
    """
    end = text.rfind(f"</{name}>")
    start = text.rfind(f"<{name}>", 0, max(end, 0))
    return text[start + len(name) + 2 : end] if 0 <= start < end else None


def write_sparse_model(path: Path, points_world: Points, world_from_grasp: Transform | None = None) -> None:
    """Write keypoints given in the first scene's frame; those without a position are left out.

    Args:
        world_from_grasp: a grasp frame in the same frame; the columns of its rotation are the axes (the
            original writes them as rows).
    """
    lines = [
        '\t<point x="{!r}" y="{!r}" z="{!r}" name="{}"/>\n'.format(*map(float, point), number)
        for number, point in enumerate(points_world)
        if np.isfinite(point).all()
    ]
    grasp = "" if world_from_grasp is None else _grasp_block(world_from_grasp)
    write_text(path, "<SparseObjectPoints>\n" + "".join(lines) + "</SparseObjectPoints>\n" + grasp)


def _grasp_block(world_from_grasp: Transform) -> str:
    rows = "".join(f"\t{[float(value) for value in row]!r}\n" for row in world_from_grasp)
    return f"<GraspPoint>\n{rows}</GraspPoint>\n"


def read_grasp(path: Path) -> Transform | None:
    """`world_from_grasp` of the last grasp point of a file of ours; None without one."""
    block = _last_block(read_text(path), "GraspPoint")
    if block is None:
        return None
    with decoding(path, "export the model again"):
        values = [float(number) for number in _NUMBER.findall(block)]
    if len(values) != 16 or not np.isfinite(values).all():
        raise DataError(f"{path}: its <GraspPoint> holds {len(values)} numbers; expected 4 rows of 4")
    matrix: Transform = np.array(values).reshape(4, 4)
    return matrix


def points_in_first_scene(solution: Solution) -> Points:
    """The keypoints in the frame of the first scene by name, the paper's F_w."""
    first = min(solution.scene_from_object)
    return transform(solution.scene_from_object[first], solution.model.points_object)
