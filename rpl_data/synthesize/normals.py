"""Normals for shading: those of a fused mesh waver by the noise of depth, which light would show as dents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rpl_data.geometry import Points
from rpl_data.meshes import vertex_normals
from rpl_data.types import Mesh

ROUNDS = 12
"""Rounds of averaging with neighbours; each reaches one edge of a triangle farther."""
SAME_FACE = 0.8
"""Cosine above which neighbouring normals belong to one face: edges of an object stay sharp."""


def steady_normals(mesh: Mesh) -> Points:
    """Unit normals of the vertices, averaged within faces; 0 where a vertex has no triangle."""
    normals = vertex_normals(replace(mesh, colors=None))
    sides = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    a, b = np.unique(sides, axis=0).T
    for _ in range(ROUNDS):
        alike = np.maximum(np.einsum("nd,nd->n", normals[a], normals[b]) - SAME_FACE, 0)
        summed = 0.1 * normals
        for axis in range(3):
            summed[:, axis] += np.bincount(a, alike * normals[b, axis], len(normals))
            summed[:, axis] += np.bincount(b, alike * normals[a, axis], len(normals))
        normals = summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-12)
    return normals
