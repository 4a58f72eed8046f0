"""The algebra below tracking: motions, derivatives, and what noise is not allowed to claim."""

from __future__ import annotations

import numpy as np
import pytest
from made_scenes import CAMERA, orbit, shot

from rpl_data.geometry import from_rotvec
from rpl_data.reconstruct.alignment import align, approach
from rpl_data.reconstruct.comparison import AGREEING_SIGMAS, compare
from rpl_data.reconstruct.evidence import of_brightness, of_depth
from rpl_data.reconstruct.information import (
    Estimate,
    distances_m,
    motion_between,
    moved,
    size_m,
    weakest_sigma_m,
)
from rpl_data.reconstruct.model_map import Keyframe, ModelMap
from rpl_data.reconstruct.relocalise import keyframe_from_camera, landmarks_of
from rpl_data.reconstruct.view import View, Viewer

RNG = np.random.default_rng(3)
NOTHING_KNOWN = Estimate(np.eye(4), 1e-3 * np.eye(6))


def look(pose: np.ndarray, *, boxes: bool = True, contrast: float = 10.0, noise: float = 1.0) -> View:
    return Viewer(CAMERA).look(*shot(pose, boxes=boxes, contrast=contrast, rng=RNG, noise=noise))


def keyframe(pose: np.ndarray | None = None, **options) -> Keyframe:
    at = np.eye(4) if pose is None else pose
    return ModelMap().add(0, look(at, **options), at)


def test_motions_go_there_and_back() -> None:
    poses = orbit(5)
    for motion in (np.zeros(6), np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]), np.array([3.1, 0, 0, 0, 0, 0])):
        np.testing.assert_allclose(motion_between(poses[2], poses[2] @ moved(motion)), motion, atol=1e-12)
    expected = [size_m(motion_between(pose, poses[3])) for pose in poses]
    np.testing.assert_allclose(distances_m(poses, poses[3]), expected, atol=1e-7)


@pytest.mark.parametrize("axis", range(6))
def test_derivatives_are_those_of_small_steps(axis: int) -> None:
    """Brightness and depth in the keyframe, after a step and before it, against step times derivative."""
    there, pose = keyframe(orbit(24)[20], noise=0.0), orbit(24)[16]
    pixels, step = look(pose, noise=0.0).levels[0].pixels, np.zeros(6)
    step[axis] = 3e-4
    before, _ = compare(pixels, there, 0, pose @ moved(-step))
    after, _ = compare(pixels, there, 0, pose @ moved(step))
    at, axes = compare(pixels, there, 0, pose)
    use = before.smooth & at.smooth & after.smooth
    # Slopes of brightness are taken over three pixels, which rounds off its short waves by a tenth.
    for name, derivative, within in (("grey", at.grey_by_motion, 0.12), ("step", at.step_by_motion, 0.02)):
        change = (getattr(after, name) - getattr(before, name))[use]
        said = (2 * axes @ step @ derivative.astype(float))[use]
        large = np.abs(said) > np.median(np.abs(said))
        assert np.median(change[large] / said[large]) == pytest.approx(1, abs=within), name


def test_a_fit_finds_a_camera_that_stands_a_few_centimetres_away() -> None:
    there, pose = keyframe(), orbit(24)[3]
    view = look(pose)
    fit = align(view, there, approach(view, there, np.eye(4), NOTHING_KNOWN), NOTHING_KNOWN)
    assert size_m(motion_between(pose, fit.estimate.scene_from_camera)) < 1e-3
    assert fit.correlation > 0.9 and fit.agreeing > 0.9


def test_a_plain_wall_is_not_known_by_its_noise() -> None:
    """Depth holds three of six motions there, and noise must not hold the other three."""
    there, view = keyframe(boxes=False, contrast=0.0), look(np.eye(4), boxes=False, contrast=0.0)
    pixels = view.levels[0].pixels
    at, _ = compare(pixels, there, 0, np.eye(4))
    bright, deep = of_brightness(pixels, at), of_depth(at)
    assert weakest_sigma_m(bright.information + deep.information) < 0.01  # what it seems
    known = bright.above_noise(at) + deep.above_noise(at)
    assert weakest_sigma_m(known) > 0.02
    assert np.count_nonzero(np.linalg.eigvalsh(deep.above_noise(at)) > 1e4) == 3


def test_corners_say_where_a_lost_camera_is() -> None:
    pose = orbit(24)[8]
    here, there = look(pose), keyframe()
    found = keyframe_from_camera(here.levels[0], landmarks_of(here.levels[0]), there.landmarks)
    assert found is not None
    assert size_m(motion_between(pose, found)) < 0.03
    nothing = look(np.eye(4), boxes=False, contrast=0.0)
    assert keyframe_from_camera(nothing.levels[0], landmarks_of(nothing.levels[0]), there.landmarks) is None


def test_depth_agrees_within_its_noise_near_and_far() -> None:
    """Pixels on one ray, at 0.7 m and at 7 m, whose depth is off by 2 and by 4 mm or 100 times that."""
    for depth_m, off_m, agrees in (
        (0.7, 0.004, True),
        (0.7, 0.03, False),
        (7.0, 0.4, True),
        (7.0, 1.2, False),
    ):
        size = (CAMERA.height, CAMERA.width)
        grey = np.zeros((CAMERA.height // 2, CAMERA.width // 2), np.uint8)
        there, here = (
            Viewer(CAMERA).look(grey, np.full(size, d, np.float32)) for d in (depth_m, depth_m + off_m)
        )
        found, _ = compare(here.levels[0].pixels, ModelMap().add(0, there, np.eye(4)), 0, np.eye(4))
        assert found.seen.any() and (found.agrees[found.seen] == agrees).all(), (depth_m, off_m)
    assert AGREEING_SIGMAS * np.sqrt(2) * 1.5e-3 * 10**2 == pytest.approx(0.64, abs=0.01)  # at 7 m


def test_a_map_that_meets_no_point_knows_nothing() -> None:
    behind = from_rotvec(np.array([0.0, np.pi, 0.0]), np.array([0.0, 0.0, -5.0]))
    model, view = ModelMap(), look(np.eye(4))
    model.add(0, view, np.eye(4))
    found = model.align(view, behind)
    np.testing.assert_array_equal(found.scene_from_camera, behind)
    np.testing.assert_array_equal(found.information, np.zeros((6, 6)))
