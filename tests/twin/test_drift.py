"""The drift is as large as it says, smooth, and starts at nothing."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import invert, rotation_angle_rad
from rpl_data.twin.drift import Drift, drifted
from rpl_data.types import DataError

TIMES = np.arange(0, 8, 1 / 30)


def errors(drift: Drift, seed: int, times: np.ndarray = TIMES) -> np.ndarray:
    """camera_from_drifted_camera of a camera that stands still."""
    still = np.broadcast_to(np.eye(4), (len(times), 4, 4)).copy()
    return drifted(still, times, drift, rng=np.random.default_rng(seed))


def test_the_end_has_strayed_as_far_as_asked() -> None:
    ends = np.array([errors(Drift(0.005, 0.3), seed)[-1] for seed in range(400)])
    metres = np.sqrt((ends[:, :3, 3] ** 2).sum(axis=1).mean())
    degrees = np.rad2deg(np.sqrt(np.mean([rotation_angle_rad(end[:3, :3]) ** 2 for end in ends])))
    assert metres == pytest.approx(0.005, rel=0.1)
    assert degrees == pytest.approx(0.3, rel=0.1)


def test_it_starts_exact_and_grows_like_a_walk() -> None:
    paths = np.array([errors(Drift(), seed)[:, :3, 3] for seed in range(200)])
    spread = np.sqrt((paths**2).sum(axis=2).mean(axis=0))
    assert spread[0] == 0
    quarter, whole = spread[len(TIMES) // 4], spread[-1]
    assert 0.35 < quarter / whole < 0.65  # a walk: half


def test_neighbouring_frames_agree() -> None:
    path = errors(Drift(0.005, 0.3), 0)
    steps = np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.0005  # a white walk of 5 mm in 240 frames takes steps of 0.3 mm, up to 1 mm
    turns = np.diff(np.diff(path[:, :3, 3], axis=0), axis=0)
    assert np.linalg.norm(turns, axis=1).mean() < 0.2 * steps.mean()


def test_the_error_is_in_the_camera_not_in_the_scene() -> None:
    """A path far from the scene's origin drifts no more than one near it."""
    far = np.broadcast_to(np.eye(4), (len(TIMES), 4, 4)).copy()
    far[:, :3, 3] = [100.0, 0.0, 0.0]
    there = drifted(far, TIMES, Drift(), rng=np.random.default_rng(3))
    np.testing.assert_allclose(invert(far) @ there, errors(Drift(), 3), atol=1e-10)


def test_short_paths_and_no_drift() -> None:
    assert np.array_equal(errors(Drift(0.0, 0.0), 0), np.broadcast_to(np.eye(4), (len(TIMES), 4, 4)))
    assert len(errors(Drift(), 0, TIMES[:1])) == 1 and len(errors(Drift(), 0, TIMES[:2])) == 2
    with pytest.raises(DataError, match="must not be negative"):
        Drift(metres=-0.1)
