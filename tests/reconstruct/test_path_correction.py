"""Paths that stray are put right by the images, paths that hold are left, and the judge tells them apart."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_scenes import CAMERA, errors, orbit, scene_of, shot

from rpl_data.drift.drift import measure_drift
from rpl_data.geometry import from_rotvec, invert
from rpl_data.images import read_depth_m
from rpl_data.reconstruct.path_correction import choose_keyframes, correct_path
from rpl_data.reconstruct.path_judge import PathErrors, compare_paths, is_better
from rpl_data.reconstruct.view import View, Viewer
from rpl_data.recordings.open import open_scenes
from rpl_data.twin.drift import Drift, drifted
from rpl_data.types import DepthImage, Frame, GreyImage, Trajectory

COUNT = 16


@pytest.fixture(scope="module")
def shots() -> list[tuple[GreyImage, DepthImage]]:
    rng = np.random.default_rng(1)
    return [shot(pose, boxes=True, contrast=10.0, rng=rng) for pose in orbit(COUNT)]


@pytest.fixture(scope="module")
def look(shots: list[tuple[GreyImage, DepthImage]]) -> Callable[[Frame], View]:
    viewer = Viewer(CAMERA)
    return lambda frame: viewer.look(*shots[frame.index])


def straying() -> Trajectory:
    """The true path with a drift of 15 mm and 1 degree; the first pose is exact."""
    times_s = np.arange(COUNT) / 3
    drift = Drift(metres=0.015, degrees=1.0)
    poses = drifted(orbit(COUNT), times_s, drift, rng=np.random.default_rng(3))
    return Trajectory(np.arange(COUNT), poses)


def true_path() -> Trajectory:
    return Trajectory(np.arange(COUNT), orbit(COUNT))


def scatter_mm(path: Trajectory) -> float:
    """How far the path strays from the truth once it begins where the truth does, at its worst."""
    first = orbit(COUNT)[0] @ invert(path.scene_from_camera[0])
    return float(errors(Trajectory(path.frames, first @ path.scene_from_camera), orbit(COUNT))[0].max())


def test_a_path_that_strays_is_put_right(look: Callable[[Frame], View]) -> None:
    found = correct_path(scene_of(COUNT), straying(), look)
    assert scatter_mm(straying()) > 8
    assert scatter_mm(found.trajectory) < 1.0
    assert found.tied.all()
    assert found.most_px > 0.5


def test_a_path_that_holds_hardly_moves(look: Callable[[Frame], View]) -> None:
    found = correct_path(scene_of(COUNT), true_path(), look)
    assert scatter_mm(found.trajectory) < 0.5
    assert found.most_px < 0.2


def test_frames_without_depth_move_with_their_neighbours(look: Callable[[Frame], View]) -> None:
    scene = scene_of(COUNT)
    frames = list(scene.frames)
    frames[5] = Frame(5, frames[5].timestamp_s, Path("c"), None)
    scene = type(scene)("made", CAMERA, 0.001, tuple(frames))
    found = correct_path(scene, straying(), look)
    assert found.trajectory.frames.tolist() == list(range(COUNT))
    assert not found.tied[5] and found.tied[[4, 6]].all()
    assert scatter_mm(found.trajectory) < 4


def test_keyframes_are_new_views_only() -> None:
    poses = [from_rotvec(np.zeros(3), np.array([x, 0.0, 0.0])) for x in (0.0, 0.01, 0.05, 0.1, 0.11, 0.0)]
    assert choose_keyframes(poses) == [0, 3]


def test_the_judge_prefers_the_true_path(shots: list[tuple[GreyImage, DepthImage]]) -> None:
    def read(frame: Frame) -> tuple[GreyImage, DepthImage]:
        grey, depth_m = shots[frame.index]
        return cv2.resize(grey, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_CUBIC), depth_m

    found = compare_paths(scene_of(COUNT), {"given": straying(), "true": true_path()}, read)
    assert found["true"].color_px < 0.5 < found["given"].color_px
    assert is_better(found["true"], found["given"])
    assert not is_better(found["given"], found["true"])


def test_a_slide_along_a_wall_is_drift_though_depth_does_not_see_it(
    shots: list[tuple[GreyImage, DepthImage]], look: Callable[[Frame], View]
) -> None:
    poses = orbit(COUNT)
    poses[:, 0, 3] += np.linspace(0, 0.04, COUNT)  # to the right, along the wall
    sliding, scene = Trajectory(np.arange(COUNT), poses), scene_of(COUNT)

    def read(frame: Frame) -> DepthImage:
        return shots[frame.index][1]

    blind = measure_drift(scene, sliding, read)
    seeing = measure_drift(scene, sliding, read, corrected=correct_path(scene, sliding, look).trajectory)
    held = measure_drift(
        scene, true_path(), read, corrected=correct_path(scene, true_path(), look).trajectory
    )
    assert blind.whole_m < 0.01
    assert 0.025 < seeing.whole_m < 0.045
    assert held.whole_m < 0.002


def test_views_of_other_sides_do_not_pass_for_drift(real_data: Path) -> None:
    for recording in open_scenes(real_data / "hollow/skillet", "rpl"):
        assert recording.trajectory is not None  # the true poses: 58 and 65 mm by depth of all views
        assert (
            measure_drift(
                recording.scene, recording.trajectory, partial(read_depth_m, recording.scene)
            ).whole_m
            < 0.005
        )


def test_better_is_clearly_better_in_both_together() -> None:
    assert not is_better(PathErrors(1.0, 0.003), PathErrors(1.05, 0.003))
    assert is_better(
        PathErrors(0.6, 0.0041), PathErrors(0.5, 0.0078)
    )  # a little worse in one, far better in the other
    assert is_better(PathErrors(float("nan"), 0.003), PathErrors(float("nan"), 0.006))
    assert not is_better(PathErrors(float("nan"), float("nan")), PathErrors(1.0, 0.003))


def test_a_path_under_which_nothing_can_be_compared_is_worse() -> None:
    nothing, depth_alone = PathErrors(float("nan"), float("nan")), PathErrors(float("nan"), 0.003)
    assert is_better(depth_alone, nothing) and not is_better(nothing, nothing)
    assert str(depth_alone) == "3.0 mm in depth" and not str(nothing)
    assert str(PathErrors(2.14, 0.003)) == "2.1 px in colour and 3.0 mm in depth"
