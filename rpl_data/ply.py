"""Surfaces as binary PLY, to be written whole: Open3D's writer reports success on a full disk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from rpl_data.types import Mesh, PointCloud

Floats = Float64[np.ndarray, "n 3"]
Colors = UInt8[np.ndarray, "n 3"]


def mesh_to_ply(mesh: Mesh) -> bytes:
    """Vertices, with colours where known, and triangles."""
    header, vertices = _vertices([("xyz", mesh.vertices)], mesh.colors)
    faces = f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\n"
    return _file(header + faces, vertices + _faces(mesh.triangles))


def cloud_to_ply(cloud: PointCloud) -> bytes:
    """Points with normals, and with colours where known."""
    return _file(*_vertices([("xyz", cloud.points), (("nx", "ny", "nz"), cloud.normals)], cloud.colors))


def _file(elements: str, content: bytes) -> bytes:
    return f"ply\nformat binary_little_endian 1.0\n{elements}end_header\n".encode("ascii") + content


def _vertices(columns: Sequence[tuple[Sequence[str], Floats]], colors: Colors | None) -> tuple[str, bytes]:
    """The header and the content of the vertex element."""
    fields = [(name, "<f8") for names, _ in columns for name in names]
    if colors is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
    table = np.empty(len(columns[0][1]), dtype=fields)
    for names, values in [*columns, *([] if colors is None else [(("red", "green", "blue"), colors)])]:
        for name, column in zip(names, values.T, strict=True):
            table[name] = column
    kinds = {"<f8": "double", "u1": "uchar"}
    properties = "".join(f"property {kinds[kind]} {name}\n" for name, kind in fields)
    return f"element vertex {len(table)}\n{properties}", table.tobytes()


def _faces(triangles: Int64[np.ndarray, "m 3"]) -> bytes:
    table = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    table["count"], table["corners"] = 3, triangles
    return table.tobytes()
