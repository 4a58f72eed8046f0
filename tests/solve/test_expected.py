"""Expected errors against numbers worked out by hand."""

import numpy as np
import pytest

from rpl_data.solve.expected import covariance_by_pose, expected_px
from rpl_data.types import Intrinsics, expected_mm

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480)


def test_two_millimetres_at_a_metre() -> None:
    covariance = np.stack([4e-6 * np.eye(3), np.full((3, 3), np.nan)])
    points = np.array([[0.0, 0.0, 1.0], [np.nan] * 3])
    assert expected_mm(covariance) == pytest.approx(2 * np.sqrt(3))
    # Across the axis 2 mm are 1.2 px; along it they move nothing.
    assert expected_px(covariance, points, CAMERA, np.eye(4)[None]) == pytest.approx(1.2 * np.sqrt(2))


def test_a_turn_moves_what_is_far_from_the_origin() -> None:
    pose_covariance = np.diag([0, 0, 0.01**2, 0, 0, 0])
    found = covariance_by_pose(pose_covariance, np.eye(4), np.array([[0.5, 0, 0]]), np.zeros((1, 3, 3)))
    np.testing.assert_allclose(found[0], np.diag([0, 0.005**2, 0]), atol=1e-12)
