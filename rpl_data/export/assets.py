"""The objects themselves, for viewers, simulators and pose estimators.

::

    <folder>/<object>_m.glb              metres, with a texture
             <object>_m.obj .mtl _albedo.png
             <object>_mm.ply             millimetres, every triangle, colours and normals of the vertices
             <object>.json               size, keypoints, whether it is closed

All are in the object frame of the labels' poses; the JSON file says which that is, and how much of the
surface is a guess that closes sides no camera saw.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import replacing
from rpl_data.export.texture import save_textured
from rpl_data.files import write_bytes, write_json
from rpl_data.formats.datasets.coco import CocoObject, objects_from_coco
from rpl_data.json_arrays import Json, numbers, rows_to_json
from rpl_data.meshes import load_mesh, mesh_to_ply
from rpl_data.symmetries import symmetries_to_json
from rpl_data.types import Mesh


def export_assets(folder: Path, coco: Path, guessed: Mapping[str, float] | None = None) -> DialectSummary:
    """Write `folder` from an exported COCO folder.

    Args:
        folder: its old content is replaced.
        coco: an exported COCO folder.
        guessed: share of each object's triangles that close sides no camera saw, where it is known.

    Raises:
        DataError: the COCO folder is missing or broken, or the folder cannot be written.
    """
    lines = []
    with replacing(folder) as building:
        for item in objects_from_coco(next(splits_of(coco)).data):
            if item.mesh is None:
                lines.append(f"{item.model.name} has no dense model, so no mesh")
                continue
            mesh = load_mesh(coco / item.mesh)
            name = item.model.name
            save_textured(mesh, [building / f"{name}_m.{suffix}" for suffix in ("glb", "obj")])
            in_mm = replace(mesh, vertices=1000 * mesh.vertices)
            write_bytes(building / f"{name}_mm.ply", mesh_to_ply(in_mm, normals=True))
            facts = _facts(item, mesh, (guessed or {}).get(name))
            write_json(building / f"{name}.json", facts)
            if (facts["guessed"] or 0) >= 0.005:
                lines.append(
                    f"{name}: {facts['guessed']:.0%} of the triangles close sides that no camera saw; their "
                    "shape and colour are a guess"
                )
            if not facts["closed"]:
                lines.append(f"{name}: the mesh is not closed; {facts['open_edges']} edges have one triangle")
    return DialectSummary({}, 0, tuple(lines))


def _facts(item: CocoObject, mesh: Mesh, guessed: float | None) -> Json:
    open_edges = _open_edges(mesh)
    return {
        "name": item.model.name,
        "unit": "metre",
        "frame": "the workspace's: origin at the centroid of the keypoints"
        if item.frame is None
        else "as `export: {frame: ...}` asked; frame_from_object leads to it from the workspace's",
        "frame_from_object": numbers(np.eye(4) if item.frame is None else item.frame),
        "size_m": np.ptp(mesh.vertices, axis=0).tolist(),
        "keypoints_m": dict(zip(item.model.keypoints, rows_to_json(item.model.points_object), strict=True)),
        "triangles": len(mesh.triangles),
        "closed": open_edges == 0,
        "open_edges": open_edges,
        "guessed": guessed,
        **symmetries_to_json(item.symmetries),
    }


def _open_edges(mesh: Mesh) -> int:
    """How many edges do not join exactly two triangles; 0 = closed."""
    corners = mesh.triangles
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    return sum(1 for count in Counter(map(tuple, edges.tolist())).values() if count != 2)
