"""Points spread evenly over a mesh."""

from __future__ import annotations

import numpy as np

from rpl_data.meshes import sampled
from rpl_data.types import Mesh


def test_points_lie_on_the_triangles_in_proportion_to_their_areas() -> None:
    """Two triangles in z = 0 and z = 1, the second with three times the area of the first."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [3, 0, 1], [0, 1, 1]], float)
    points = sampled(Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]])), count=4000)
    upper = points[:, 2] > 0.5
    np.testing.assert_allclose(points[:, 2], upper, atol=1e-12)
    assert abs(upper.mean() - 0.75) < 0.03
    u, v = points[upper, 0] / 3, points[upper, 1]
    assert (u >= 0).all() and (v >= 0).all() and (u + v <= 1 + 1e-12).all()
    np.testing.assert_allclose([u.mean(), v.mean()], 1 / 3, atol=0.02)  # the centroid


def test_the_same_points_every_time() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(sampled(mesh, count=5), sampled(mesh, count=5))
