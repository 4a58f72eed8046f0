"""Models of a BOP dataset: meshes in millimetres with normals, their sizes and symmetries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import write_bytes, write_json
from rpl_data.formats.datasets.coco import CocoObject
from rpl_data.json_arrays import Json
from rpl_data.meshes import load_mesh, mesh_to_ply, simplified
from rpl_data.symmetries import symmetries_to_json
from rpl_data.types import Mesh

EVALUATED_TRIANGLES = 5_000
"""Pose errors go over every vertex of `models_eval`: the benchmark's own have a few thousand."""


def write_models(folder: Path, coco: Path, objects: Sequence[CocoObject]) -> list[str]:
    """Write models/ and models_eval/ into `folder`; returns the objects without a mesh.

    Args:
        folder: folder of the dataset.
        coco: the exported COCO folder, where the meshes are.
        objects: the objects; numbered from 1.
    """
    info: Json = {}
    missing = []
    for number, item in enumerate(objects, start=1):
        if item.mesh is None:
            missing.append(item.model.name)
            continue
        mesh = load_mesh(coco / item.mesh)
        mesh = replace(mesh, vertices=1000 * mesh.vertices)
        few = simplified(mesh, most_triangles=EVALUATED_TRIANGLES)
        name = f"obj_{number:06d}.ply"
        write_bytes(folder / "models" / name, mesh_to_ply(mesh, normals=True))
        write_bytes(folder / "models_eval" / name, mesh_to_ply(few, normals=True))
        info[str(number)] = model_info(mesh) | symmetries_to_json(item.symmetries, unit_m=0.001)
    for kind in ("models", "models_eval"):
        write_json(folder / kind / "models_info.json", info)
    return missing


def model_info(mesh: Mesh) -> Json:
    """Lowest corner, size and diameter in the unit of the mesh, by the names of models_info.json."""
    low, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    edges = {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    sizes = {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}
    return edges | sizes | {"diameter": _diameter(mesh.vertices)}


def _diameter(points: Float64[np.ndarray, "n 3"]) -> float:
    """Largest distance between two points, which are corners of the convex hull."""
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import pdist

    return float(pdist(points[ConvexHull(points).vertices]).max())
