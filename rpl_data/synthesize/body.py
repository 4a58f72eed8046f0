"""An object ready to be rendered: its painted mesh, indexed for ray casting, and its keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, Int64

from rpl_data.geometry import Points
from rpl_data.keypoint_surface import KeypointSurface
from rpl_data.meshes import vertex_normals
from rpl_data.raycast import RayScene
from rpl_data.synthesize.painted import PaintedMesh


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
    def _normals(self) -> Float32[np.ndarray, "n 3"]:
        return vertex_normals(self.painted.mesh).astype(np.float32)

    def normals_at(
        self, triangle: Int64[np.ndarray, " k"], uv: Float32[np.ndarray, "k 2"]
    ) -> Float32[np.ndarray, "k 3"]:
        """Smooth normals at barycentric coordinates of triangles, object frame; about of length 1."""
        a, b, c = self.painted.triangles[triangle].T
        u, v = uv[:, :1], uv[:, 1:]
        mixed: Float32[np.ndarray, "k 3"] = (
            (1 - u - v) * self._normals[a] + u * self._normals[b] + v * self._normals[c]
        )
        return mixed

    def __getstate__(self) -> dict[str, Any]:
        """What worker processes receive: without the indexes, which each makes for itself."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}
