"""MeshLab's picked points (.pp): keypoints marked on a mesh, in the mesh's own frame and unit.

::

    <!DOCTYPE PickedPoints>
    <PickedPoints>
     <DocumentData>...</DocumentData>
     <point x="0.1" y="0" z="1e-05" active="1" name="0"/>
    </PickedPoints>

The order of the attributes differs between writers, names may be text, and `active="0"` marks a point of a
template that nobody picked; its coordinates mean nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float64

from rpl_data.files import decoding, read_text, write_text
from rpl_data.types import DataError
from rpl_data.types.keypoint_names import are_numbers, keypoint_rows


@dataclass(frozen=True)
class PickedPoints:
    """Keypoints picked on a mesh.

    Attributes:
        names: their names, in order.
        points_mesh: one row per name, metres, in the mesh's frame; NaN where not picked.
    """

    names: tuple[str, ...]
    points_mesh: Float64[np.ndarray, "k 3"]


def read_picked_points(path: Path, *, metres_per_unit: float = 1.0) -> PickedPoints:
    """Read the points of a .pp file.

    Where all names are whole numbers, as MeshLab assigns them, they are the numbers of the keypoints: rows
    follow them, and a number missing between two becomes a row of NaN. Other names keep the file's order.

    Args:
        path: the file.
        metres_per_unit: unit of the mesh, which the file does not hold. 0.001 for a mesh in millimetres.

    Raises:
        DataError: not XML, no PickedPoints, no points, a coordinate that is not a finite number, or a name
            used twice.
    """
    with decoding(path, "pick the keypoints in MeshLab and save again"):
        points = _points(path)
        return _numbered(path, points, metres_per_unit)


def _numbered(path: Path, points: dict[str, np.ndarray], metres_per_unit: float) -> PickedPoints:
    """The points in the order of their numbers, where all names are numbers."""
    names = list(points)
    if all(name.isascii() and name.isdigit() for name in names):
        numbered = {int(name): point for name, point in points.items()}
        if len(numbered) < len(names) or max(numbered) >= 10_000:
            raise DataError(f"{path}: the numbers of the points are {', '.join(names)}; give each its own")
        names = [str(number) for number in range(min(numbered), max(numbered) + 1)]
        points = {name: numbered.get(int(name), np.full(3, np.nan)) for name in names}
    return PickedPoints(tuple(names), np.array(list(points.values())) * metres_per_unit)


def picked_in_order(
    names: Sequence[str], points: Float64[np.ndarray, "n 3"], keypoints: Sequence[str], *, source: str
) -> Float64[np.ndarray, "k 3"]:
    """Sort picked points: one row per keypoint, NaN where not picked; matched by name, or number from 0.

    Raises:
        DataError: a picked point has neither the name nor the number of a keypoint, or the numbers do not
            begin at 0, so that nobody can tell whether the first is keypoint 0 or 1.
    """
    rows = keypoint_rows(keypoints)
    explained = f"name the points like the keypoints ({', '.join(keypoints)}) or number them from 0"
    counted_rows = are_numbers(keypoints) or not set(names) <= set(keypoints)
    if counted_rows and all(name.isdecimal() for name in names) and "0" not in names:
        raise DataError(
            f"{source}: its points are numbered from {names[0]}, keypoints from 0, so each may be the one "
            f"before; {explained}, with a point 0 that is not active where it was not picked"
        )
    ordered = np.full((len(keypoints), 3), np.nan)
    for name, point in zip(names, points, strict=True):
        row = rows.get(name)
        if row is None:
            raise DataError(f"{source}: picked point {name!r} is not a keypoint; {explained}")
        ordered[row] = point
    return ordered


def _points(path: Path) -> dict[str, np.ndarray]:
    """Read the points by name, in the order of the file."""
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise DataError(f"{path} is not a PickedPoints file of MeshLab: {error}") from error
    if root.tag != "PickedPoints":
        raise DataError(f"{path} holds <{root.tag}>; expected <PickedPoints>, as MeshLab saves picked points")
    points: dict[str, np.ndarray] = {}
    for number, element in enumerate(root.iter("point")):
        name = element.get("name", "").strip()
        if not name or name in points:
            raise DataError(f"{path}: point {number} has no name of its own (name={name!r}); rename it")
        points[name] = _position(path, name, element)
    if not points:
        raise DataError(f"{path} has no points; pick the keypoints in MeshLab and save again")
    return points


def _position(path: Path, name: str, element: ElementTree.Element) -> np.ndarray:
    if element.get("active", "1").strip() in ("0", "false"):
        return np.full(3, np.nan)
    try:
        position = np.array([float(element.attrib[axis]) for axis in "xyz"])
    except (KeyError, ValueError) as error:
        raise DataError(f"{path}: point {name!r} needs numbers x, y and z, found {element.attrib}") from error
    if not np.isfinite(position).all():
        raise DataError(f"{path}: point {name!r} is not finite: {position}; pick it again")
    return position


def write_picked_points(
    path: Path, names: Sequence[str], points_mesh: Float64[np.ndarray, "k 3"], *, mesh_file: str = ""
) -> None:
    """Write points given in metres for a mesh in metres; a row of NaN is written as not picked.

    Args:
        path: the file to write.
        names: one per row.
        points_mesh: points in the mesh's frame.
        mesh_file: name of the mesh, which MeshLab shows.
    """
    lines = [_point_line(name, point) for name, point in zip(names, points_mesh, strict=True)]
    document = f" <DocumentData>\n  <DataFileName name={quoteattr(mesh_file)}/>\n </DocumentData>\n"
    write_text(
        path, "<!DOCTYPE PickedPoints>\n<PickedPoints>\n" + document + "".join(lines) + "</PickedPoints>\n"
    )


def _point_line(name: str, point: np.ndarray) -> str:
    picked = bool(np.isfinite(point).all())
    x, y, z = (float(value) if picked else 0.0 for value in point)
    return f' <point x="{x!r}" y="{y!r}" z="{z!r}" active="{int(picked)}" name={quoteattr(name)}/>\n'
