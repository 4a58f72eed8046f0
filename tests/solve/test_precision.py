"""The expected error of a scene, and the further click that lowers it most."""

from dataclasses import replace

import numpy as np
import pytest
from clicked_scenes import click_scene
from scipy.spatial.transform import Rotation

from rpl_data.geometry import rays, rigid, transform
from rpl_data.solve.bundle_adjustment import State
from rpl_data.solve.click_rays import Noise, rays_of
from rpl_data.solve.precision import next_clicks
from rpl_data.solve.solve import register_scene, solve
from rpl_data.types import Click, Intrinsics, KeypointModel, Observation

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480)
NAMES = tuple("abcdef")
POINTS = np.array([[0, 0, 0], [50, 1, 0], [100, 0, 1], [20, 60, 0], [70, 50, 40], [10, 20, -40]]) / 1000


def clicked(scene, scene_from_object, keypoints, random, noise_px=2.0):
    """One click per keypoint in frame 0, seen by a camera at the scene's origin."""
    in_camera = transform(scene_from_object, POINTS)
    found = []
    for k in keypoints:
        u, v = in_camera[k, :2] / in_camera[k, 2] * 600 + [320, 240] + random.normal(0, noise_px, 2)
        found.append(
            Observation(
                Click("it", k, scene, 0, u, v),
                rays(CAMERA, np.array([[u, v]]))[0],
                np.eye(4),
                np.array([in_camera[k, 2] + random.normal(0, 0.006)]),
                np.array([0.006]),
                1 / 600,
            )
        )
    return found


def pose(random):
    return rigid(Rotation.random(rng=random).as_matrix(), np.array([0, 0, 0.6]))


def test_the_expected_error_is_the_error():
    """Over many draws the error of a new scene's keypoints has the size that was expected."""
    random = np.random.default_rng(1)
    model = KeypointModel("it", NAMES, POINTS)
    ratios = []
    for _ in range(40):
        at = pose(random)
        found = register_scene(model, clicked("new", at, range(5), random))
        errors = transform(found.scene_from_object, POINTS) - transform(at, POINTS)
        variance = np.trace(found.covariance_in_scene, axis1=1, axis2=2).mean()
        ratios.append((errors**2).sum(axis=1).mean() / variance)
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1, abs=0.25)


def test_three_clicks_nearly_on_a_line_place_a_scene_badly_and_one_off_it_is_asked_for():
    random = np.random.default_rng(2)
    observations = [o for s in range(3) for o in clicked(f"0{s}", pose(random), range(6), random, 0.5)]
    observations += clicked("03", pose(random), [0, 1, 2], random, 0.5)
    solution = solve("it", NAMES, observations)
    (weak,) = [s for s in solution.statements if s.kind == "weak scene"]
    said = (
        "scene 03: its clicks (keypoints 0 a, 1 b, 2 c) place the object badly, by them and its poses alone "
    )
    assert weak.text.startswith(said), "once it is aligned to surfaces, this is still true of its clicks"
    assert solution.expected_mm["03"] > 30 > 10 > solution.expected_mm["00"]
    best = solution.next_clicks[0]
    assert best.scene == "03" and best.keypoint in (3, 4, 5)
    assert f"marking keypoint {best.keypoint} {NAMES[best.keypoint]} in frame 0 should leave" in weak.text


def test_a_click_where_depth_is_worse_than_stated_brings_less():
    """Known to 4 mm along the line of sight; a depth good to 2 x 3 mm leaves the root of 16 x 36 / 52 mm."""
    at = rigid(np.eye(3), np.array([0, 0, 0.6]))
    points = np.array([[0.05, 0, 0], [0, 0, 0]])
    (only,) = click_scene("00", points, at, [np.eye(4)], np.random.default_rng(1), keypoints=[0])
    rays_there = rays_of([replace(only, depth_sigmas_m=np.array([0.003]))], ["00"])
    joint, in_scene = np.zeros((12, 12)), np.zeros((1, 2, 3, 3))
    joint[11, 11] = in_scene[0, 1, 2, 2] = 0.004**2  # z of keypoint 1, on the optical axis
    state = State(at[None], points)
    (found,) = next_clicks(rays_there, state, Noise(2.0, 2.0), joint, in_scene, [only.click], [0, 1], most=9)
    left_mm = np.sqrt(16 * 36 / 52)
    assert (found.keypoint, found.gain_mm) == (1, pytest.approx((4 - left_mm) / 2)), "mean of two keypoints"
    assert found.left_mm == pytest.approx(left_mm / np.sqrt(2))


@pytest.mark.parametrize("strayed_m", [0.0, 0.005])
def test_a_further_click_brings_what_was_foretold(strayed_m):
    """No click lowers what the poses of a scene stray: of 10 mm that are stated, 10 mm are left."""
    random = np.random.default_rng(3)
    poses = [pose(random) for _ in range(4)]
    observations = [o for s in range(3) for o in clicked(f"0{s}", poses[s], range(6), random, 0.5)]
    observations += clicked("03", poses[3], [0, 3, 4], random, 0.5)
    strayed = {f"0{s}": strayed_m for s in range(4)}
    before = solve("it", NAMES, observations, trajectory_sigma_m=strayed)
    best = next(n for n in before.next_clicks if n.scene == "03")
    observations += clicked("03", poses[3], [best.keypoint], random, 0.5)
    after = solve("it", NAMES, observations, trajectory_sigma_m=strayed)
    fell_mm = np.mean([before.expected_mm[s] - after.expected_mm[s] for s in before.expected_mm])
    assert best.gain_mm == pytest.approx(fell_mm, rel=0.5)
    assert best.left_mm == pytest.approx(after.expected_mm["03"], rel=0.1)
    assert after.expected_mm["03"] < before.expected_mm["03"]
