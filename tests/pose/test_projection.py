"""Derivatives of projections against differences, and variances worked out by hand."""

import numpy as np
import pytest

from rpl_data.geometry import project
from rpl_data.pose.projection import projected_variance, projection_by_point
from rpl_data.types import Intrinsics

CAMERA = Intrinsics(600.0, 500.0, 320.0, 240.0, 640, 480)


def test_derivatives_are_those_of_differences() -> None:
    points = np.array([[0.1, -0.2, 0.7], [-0.3, 0.1, 1.2]])
    found = projection_by_point(CAMERA, points)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        difference = (project(CAMERA, points + step) - project(CAMERA, points - step)) / 2e-6
        np.testing.assert_allclose(found[:, :, axis], difference, rtol=1e-6)


def test_a_millimetre_across_a_metre_away() -> None:
    """0.6 px in u and 0.5 px in v; along the optical axis it moves nothing. The frame is turned."""
    camera_from_frame = np.eye(4)
    camera_from_frame[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    covariance = 1e-6 * np.stack([np.eye(3), np.diag([1.0, 0, 0]), np.diag([0, 0, 1.0])])
    points = np.tile([0.0, 0.0, 1.0], (3, 1))
    found = projected_variance(CAMERA, camera_from_frame, points, covariance)
    assert found == pytest.approx([(0.36 + 0.25) / 2, 0.25 / 2, 0.0])
