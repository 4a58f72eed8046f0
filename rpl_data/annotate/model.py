"""Load a known model: its keypoints from a file, or a mesh to pick them on (paper, section III-F)."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rpl_data.annotate.surfaces import packed
from rpl_data.clicks.log import Annotation, Event
from rpl_data.formats.models.meshlab import PickedPoints, picked_in_order, read_picked_points
from rpl_data.formats.models.sparse_model import read_sparse_model
from rpl_data.geometry import Points
from rpl_data.json_arrays import Json, rows_to_json
from rpl_data.meshes import load_mesh, save_mesh, simplified
from rpl_data.types import DataError, Mesh
from rpl_data.workspace.workspace import Workspace

MESHES = (".ply", ".obj", ".off", ".stl")
LARGEST_M = 5.0
MOST_TRIANGLES = 12_000


def read_known_points(
    file_name: str, content: bytes, annotation: Annotation, *, metres_per_unit: float
) -> list[Event]:
    """Make the events that give an object the keypoints of a sparse_model.txt or MeshLab's picked points.

    Numbered keypoints keep the object's names when their number is equal.

    Raises:
        DataError: the file is broken, or so large that its unit must be another one.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"model{Path(file_name).suffix.lower()}"
        path.write_bytes(content)
        try:
            if path.suffix == ".pp":
                picked = read_picked_points(path, metres_per_unit=metres_per_unit)
                names, points = _by_name(picked, annotation.keypoints, file_name)
            else:
                points = read_sparse_model(path) * metres_per_unit
                names = [str(number) for number in range(len(points))]
        except DataError as error:
            raise DataError(str(error).replace(str(path), file_name)) from error
    refuse_large(points[np.isfinite(points).all(axis=1)], file_name)
    numbered = names == [str(number) for number in range(len(names))]
    if numbered and len(annotation.keypoints) == len(names):
        names = list(annotation.keypoints)
    named: list[Event] = [] if names == list(annotation.keypoints) else [{"op": "keypoints", "names": names}]
    return [*named, {"op": "model", "points": rows_to_json(points, 7), "source": file_name}]


def _by_name(picked: PickedPoints, keypoints: Sequence[str], file_name: str) -> tuple[list[str], Points]:
    """Picked points in the order of the object's keypoints where it has those; else as they were picked."""
    fewer = all(name.isdecimal() for name in picked.names) and len(picked.names) <= len(keypoints)
    if keypoints and (fewer or set(picked.names) <= set(keypoints)):
        points = picked_in_order(picked.names, picked.points_mesh, keypoints, source=file_name)
        return list(keypoints), points
    return list(picked.names), picked.points_mesh


def keep_mesh(
    workspace: Workspace, object_name: str, file_name: str, content: bytes, *, metres_per_unit: float
) -> None:
    """Store the user's mesh of the object, in metres; DataError when it is not a mesh or too large."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{Path(file_name).suffix.lower()}"
        path.write_bytes(content)
        try:
            mesh = load_mesh(path)
        except DataError as error:
            why = str(error).replace(str(path), file_name)
            raise DataError(f"{why}. Choose a mesh: {', '.join(MESHES)}") from error
    vertices = mesh.vertices * metres_per_unit
    refuse_large(vertices, file_name)
    save_mesh(workspace.given_mesh_file(object_name), Mesh(vertices, mesh.triangles, mesh.colors))


def refuse_large(points: Points, file_name: str) -> None:
    """Raise a DataError when an object is larger than a room, since it is then in millimetres."""
    size_m = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if size_m > LARGEST_M:
        raise DataError(
            f"the model of {file_name} would be {size_m:.0f} m large; is it in millimetres? "
            "Load it again with 0.001 metres per unit"
        )


def given_mesh_payload(workspace: Workspace, object_name: str) -> Json | None:
    """The mesh to pick keypoints on, in its own frame; simplifying it does not move its corners."""
    path = workspace.given_mesh_file(object_name)
    if not path.exists():
        return None
    mesh = simplified(load_mesh(path), most_triangles=MOST_TRIANGLES)
    return {"points": packed(mesh.vertices, "<f4"), "triangles": packed(mesh.triangles, "<u2")}
