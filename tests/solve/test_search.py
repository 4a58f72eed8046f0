"""Scenes that a wrong depth put elsewhere are found again, and what cannot be told is said."""

import numpy as np
import pytest
from clicked_scenes import cameras, click_scene, pose

from rpl_data.geometry import from_rotvec, transform
from rpl_data.solve.bundle_adjustment import State
from rpl_data.solve.near_ties import describe_near_ties, widened_for_near_ties
from rpl_data.solve.search import Alternative
from rpl_data.solve.solve import solve

ANGLES = np.arange(7) * 0.9
RIM = np.column_stack([0.04 * np.cos(ANGLES), 0.04 * np.sin(ANGLES), [0, 0.09, 0, 0.09, 0, 0.09, 0]])
NAMES = tuple("abcdefg")
FAR_WALL_M = 0.03 + 0.012 * np.arange(7)
"""How far behind each keypoint the far wall is."""


def hollow(random, behind_in_last):
    """Five scenes of a cup: every click sees both walls; in the last, some clicks see the far wall only."""
    truth = {f"{s:02d}": pose(random) for s in range(5)}
    observations = []
    for name, at in truth.items():
        seen = [0, 1, 3, 4, 6] if name == "04" else range(7)

        def depths(k, frame, z, name=name):
            near = z + random.normal(0, 0.002)
            far = near + FAR_WALL_M[k]
            return [far] if name == "04" and k in behind_in_last else [near, far]

        observations += click_scene(
            name, RIM, at, cameras(1), random, noise_px=1.5, depths=depths, keypoints=seen
        )
    return truth, observations


@pytest.mark.parametrize(("seed", "behind"), [(0, [0, 3]), (2, [1, 4]), (9, [1, 4]), (11, [1, 4])])
def test_background_depths_of_one_frame_do_not_carry_its_scene_away(seed, behind):
    """Joining scenes one after another ends 19 to 70 mm off in these."""
    truth, observations = hollow(np.random.default_rng(seed), behind)
    solution = solve("cup", NAMES, observations)
    at = transform(solution.scene_from_object["04"], solution.model.points_object)
    off_mm = 1000 * np.linalg.norm(at - transform(truth["04"], RIM), axis=1)
    assert off_mm.mean() < 10


def alternative(shift_m, excess):
    state = State(np.tile(np.eye(4), (2, 1, 1)), RIM)
    there = state.scene_from_model.copy()
    there[1] = from_rotvec(np.zeros(3), np.array([shift_m, 0, 0]))
    return state, Alternative(1, State(there, RIM), excess)


def test_a_near_tie_is_said_with_scene_and_distance():
    known = np.ones(7, dtype=bool)
    state, near = alternative(0.052, 2.0)
    said = describe_near_ties([near], state, ["03", "04"], known)
    assert list(said) == ["04"]
    assert said["04"].startswith("scene 04: its clicks fit almost as well with the object 52 mm away")
    for shift_m, excess in ((0.052, 20.0), (0.002, 2.0)):  # clearly worse; the same in effect
        state, other = alternative(shift_m, excess)
        assert describe_near_ties([other], state, ["03", "04"], known) == {}


def test_a_tie_widens_the_covariance_by_half_the_squared_distance():
    """Two answers that are equally likely, 50 mm apart: the second moment about one is 50^2 / 2."""
    state, tie = alternative(0.05, 0.0)
    before = np.tile(1e-6 * np.eye(3), (7, 1, 1))
    after = widened_for_near_ties(before, [tie], state, 1)
    assert after[:, 0, 0] == pytest.approx(1e-6 + 0.05**2 / 2)
    assert after[:, 1, 1] == pytest.approx(1e-6)
    np.testing.assert_array_equal(widened_for_near_ties(before, [tie], state, 0), before)


def test_keypoints_are_right_although_the_far_wall_was_measured():
    _, observations = hollow(np.random.default_rng(3), [1, 4])
    points = solve("cup", NAMES, observations).model.points_object
    assert error_mm_of(points) < 6


def error_mm_of(points):
    from rpl_data.geometry import fit_rigid

    fit = fit_rigid(RIM, points)
    return 1000 * np.linalg.norm(transform(fit, points) - RIM, axis=1).max()
