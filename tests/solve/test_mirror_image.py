"""The mirror image of an object in each image, and how well clicks fit it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpl_data.geometry import rigid, transform
from rpl_data.solve.click_rays import rays_of
from rpl_data.solve.mirror_image import Mirrored, mirrored_cost
from rpl_data.solve.refit import read_as_named, refit
from rpl_data.types import Click, Observation

SQUARE_AND_TOP = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0], [0.02, 0.03, 0.06]])
PIXEL_RAD = 1 / 600


def in_mirror(xy):
    """Left for right about the middle of all points."""
    return np.column_stack([xy[:, 0].min() + xy[:, 0].max() - xy[:, 0], xy[:, 1]])


def clicked(pose, change, *, covariance_m2=0.0):
    """One click per keypoint, in a camera at the origin of the scene, where `change` puts them."""
    points = transform(pose, SQUARE_AND_TOP)
    observations = [
        Observation(
            Click("it", k, "00", 0, 0.0, 0.0), np.array([x, y, 1.0]), np.eye(4), np.array([]), np.array([]),
            PIXEL_RAD,
        )
        for k, (x, y) in enumerate(change(points[:, :2] / points[:, 2:]))
    ]  # fmt: skip
    return Mirrored(
        rays=rays_of(observations, ["00"]),
        column=np.arange(5),
        points=SQUARE_AND_TOP,
        covariance=covariance_m2 * np.eye(15),
        centre=points.mean(axis=0) + [0.01, -0.01, 0.02],
        sigma_px=2.0,
    )


@pytest.mark.parametrize("seed", range(3))
def test_clicks_in_a_mirror_fit_and_right_clicks_do_not(seed):
    """Near the camera: from afar a mirror image in one frame is that of the object turned about."""
    pose = rigid(Rotation.random(rng=np.random.default_rng(seed)).as_matrix(), np.array([0, 0, 0.3]))
    assert mirrored_cost(clicked(pose, in_mirror), most=100.0) == pytest.approx(0, abs=0.05)
    assert mirrored_cost(clicked(pose, lambda xy: xy), most=100.0) == np.inf


def test_keypoints_that_are_known_badly_weigh_less():
    pose = rigid(Rotation.from_euler("xyz", [0.4, 2.0, 0.3]).as_matrix(), np.array([0, 0, 0.7]))

    def bent(xy):
        return in_mirror(xy) + [[4 * PIXEL_RAD, 0], [0, 0], [0, 0], [0, 0], [0, 0]]

    exact = mirrored_cost(clicked(pose, bent), most=100.0)
    unsure = mirrored_cost(clicked(pose, bent, covariance_m2=0.003**2), most=100.0)
    assert 0 < 2 * unsure < exact < 4  # a click of 2 px deviation is off by 4 px, and the pose follows


def test_a_known_model_without_a_click_in_use_stays_where_it_is():
    scene = clicked(rigid(np.eye(3), np.array([0, 0, 0.7])), in_mirror)
    nothing = read_as_named(scene.rays)._replace(ray_used=np.zeros(5, bool), depth_used=np.zeros(5, bool))
    fit = refit(scene.rays, nothing, np.eye(4)[None], SQUARE_AND_TOP, hold_points=True)
    assert fit.cost == 0 and np.array_equal(fit.scene_from_model[0], np.eye(4))
