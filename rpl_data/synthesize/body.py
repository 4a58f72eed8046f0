"""An object ready to be rendered: its painted mesh, indexed for ray casting, and its keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from rpl_data.geometry import Points
from rpl_data.keypoint_surface import KeypointSurface
from rpl_data.raycast import RayScene
from rpl_data.synthesize.normals import steady_normals
from rpl_data.synthesize.painted import PaintedMesh, steps_of, texel_positions
from rpl_data.types import Mesh

SAME_MODEL_M = 1e-4
"""Keypoints that are nearer than this to where they were are those of the same solve."""


@dataclass(frozen=True)
class Body:
    """An object; the index for ray casting is made when it is first used, and stays in its process.

    Attributes:
        points_object: the keypoints, NaN where never clicked.
    """

    name: str
    painted: PaintedMesh
    points_object: Float64[np.ndarray, "k 3"]

    @cached_property
    def rays(self) -> RayScene:
        """The mesh, indexed."""
        return RayScene([self.painted.mesh], threads=1)

    @cached_property
    def around(self) -> KeypointSurface:
        """The surface around the keypoints, by which they are seen or hidden."""
        return KeypointSurface.around(self.rays, self.points_object)

    @cached_property
    def hull(self) -> Points:
        """Vertices of the convex hull, object frame."""
        from scipy.spatial import ConvexHull

        vertices = self.painted.vertices
        corners: Points = vertices[ConvexHull(vertices, qhull_options="QJ").vertices]
        return corners

    @cached_property
    def radius_m(self) -> float:
        """Largest distance of the surface from the origin of the object frame."""
        return float(np.linalg.norm(self.painted.vertices, axis=1).max())

    @cached_property
    def colors(self) -> UInt8[np.ndarray, "n 3"]:
        """RGB of all texels, triangle after triangle."""
        return self.painted.texels.reshape(-1, 3)

    @cached_property
    def normals(self) -> Float32[np.ndarray, "n 3"]:
        """Normals of all texels, object frame; about of length 1."""
        mesh, each = self.painted.mesh, self.painted.texels.shape[1]
        corners = Mesh(steady_normals(mesh), mesh.triangles)
        return texel_positions(corners, steps_of(each)).astype(np.float32)

    def __getstate__(self) -> dict[str, Any]:
        """What worker processes receive: without the indexes, which each makes for itself."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}
