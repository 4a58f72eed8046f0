"""Mending undoes exactly the fault it is named after."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpl_data.geometry import from_rotvec, invert, resized
from rpl_data.images import read_depth_m
from rpl_data.recordings.mend import Mend, mended, mended_poses
from rpl_data.types import DataError, DepthCamera, Frame, Intrinsics, Recording, Scene, Trajectory

POSES = np.array(
    [from_rotvec(np.array([0.3 * n, -0.2, 0.5]), np.array([0.1 * n, 0.2, -0.4])) for n in range(8)]
)


def recording() -> Recording:
    frames = tuple(Frame(n, n / 30, Path(f"rgb/{n}.png"), Path(f"depth/{n}.png")) for n in range(8))
    scene = Scene("a", Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480), 0.001, frames)
    return Recording(scene, Trajectory(np.arange(8), POSES))


def test_nothing_to_mend_changes_nothing() -> None:
    sound = recording()
    assert mended(sound, Mend()) is sound


def test_quaternions_stored_as_wxyz() -> None:
    stored = POSES.copy()
    quaternions_wxyz = np.roll(Rotation.from_matrix(POSES[:, :3, :3]).as_quat(), 1, axis=1)
    stored[:, :3, :3] = Rotation.from_quat(quaternions_wxyz).as_matrix()  # read as if x y z w
    np.testing.assert_allclose(mended_poses(stored, Mend(wxyz_quaternions=True)), POSES, atol=1e-12)


def test_poses_stored_the_other_way_round_and_for_opengl() -> None:
    stored = invert(POSES @ np.diag([1.0, -1.0, -1.0, 1.0]))
    found = mended_poses(stored, Mend(inverted_poses=True, opengl_cameras=True))
    np.testing.assert_allclose(found, POSES, atol=1e-12)


def test_a_missing_pose_stays_missing() -> None:
    stored = POSES.copy()
    stored[3] = np.nan
    found = mended_poses(stored, Mend(wxyz_quaternions=True, inverted_poses=True))
    assert np.isnan(found[3, :3, :3]).all()
    assert np.isfinite(np.delete(found, 3, axis=0)).all()


@pytest.mark.parametrize("lag", [2, -2])
def test_depth_of_a_frame_is_taken_from_where_it_is_stored(lag: int) -> None:
    found = mended(recording(), Mend(depth_lag=lag))
    assert [frame.depth for frame in found.scene.frames] == [
        Path(f"depth/{frame.index + lag}.png") for frame in found.scene.frames
    ]
    assert len(found.scene.frames) == 6
    assert found.trajectory is not None
    assert found.trajectory.frames.tolist() == [frame.index for frame in found.scene.frames]
    assert "2 frames left out" in found.notes[1]


def test_pose_of_a_frame_is_taken_from_where_it_is_stored() -> None:
    found = mended(recording(), Mend(pose_lag=3))
    assert found.trajectory is not None
    assert found.trajectory.frames.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(found.trajectory.at(1), POSES[4])


def test_a_recording_without_poses_is_mended_too() -> None:
    found = mended(replace(recording(), trajectory=None), Mend(depth_lag=1, inverted_poses=True))
    assert found.trajectory is None
    assert len(found.scene.frames) == 7


def test_a_lag_longer_than_the_recording_is_refused() -> None:
    with pytest.raises(DataError, match="no frames are left"):
        mended(recording(), Mend(depth_lag=8))


def test_depth_of_another_camera_is_put_on_the_colour_image(tmp_path: Path) -> None:
    """A depth pixel 100 right of and 50 below the middle lands 90 + 4 right of and 45 - 6 below it."""
    camera = Intrinsics(600.0, 600.0, 320.0, 240.0, 641, 481)
    raw = np.zeros((481, 641), np.uint16)
    raw[290 - 2 : 290 + 3, 420 - 2 : 420 + 3] = 800
    cv2.imwrite(str(tmp_path / "0.png"), raw)
    frame = Frame(0, 0.0, tmp_path / "rgb.png", tmp_path / "0.png")
    scene = Scene("a", camera, 0.001, (frame,), registered=False)
    found = mended(Recording(scene, None), Mend(depth_zoom=0.9, depth_shift_px=(4.0, -6.0))).scene
    assert found.registered
    rows, columns = np.nonzero(read_depth_m(found, frame))
    np.testing.assert_allclose([columns.mean(), rows.mean()], [320 + 94, 240 + 39], atol=0.5)
    assert read_depth_m(found, frame).max() == pytest.approx(0.8)  # nearest, never a mean of two surfaces


def test_a_shift_counts_pixels_of_the_colour_image_where_depth_is_coarser(tmp_path: Path) -> None:
    """Depth of a fifth of the size: 20 colour pixels to the right are 4 of its own."""
    camera = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
    small = resized(camera, width=128, height=96)
    raw = np.zeros((96, 128), np.uint16)
    raw[40:50, 60:70] = 800
    cv2.imwrite(str(tmp_path / "0.png"), raw)
    frame = Frame(0, 0.0, tmp_path / "rgb.png", tmp_path / "0.png")
    scene = Scene("a", camera, 0.001, (frame,), depth_camera=DepthCamera(small))
    found = mended(Recording(scene, None), Mend(depth_shift_px=(20.0, -10.0))).scene
    before, after = (np.argwhere(read_depth_m(each, frame)).mean(axis=0) for each in (scene, found))
    np.testing.assert_allclose(after - before, [-10, 20], atol=0.5)


def test_repeated_depth_is_left_out_with_its_pose(tmp_path: Path) -> None:
    made = recording()
    for frame in made.scene.frames:
        (tmp_path / f"{frame.index}.png").write_bytes(
            b"same" if frame.index in (4, 5) else bytes([frame.index])
        )
    frames = tuple(replace(f, depth=tmp_path / f"{f.index}.png") for f in made.scene.frames)
    found = mended(replace(made, scene=replace(made.scene, frames=frames)), Mend(no_repeats=True))
    assert [frame.index for frame in found.scene.frames] == [0, 1, 2, 3, 4, 6, 7]
    assert found.trajectory is not None
    np.testing.assert_allclose(found.trajectory.at(6), POSES[6])
    assert found.left_out == (5,)
    assert found.notes == (
        "read with `mend: {no_repeats: true}`",
        "1 frame left out: the depth image repeats the one before",
    )


def test_a_zoom_of_nothing_is_refused() -> None:
    with pytest.raises(DataError, match="depth_zoom is 0"):
        Mend(depth_zoom=0.0)


def depth_of(tmp_path: Path, stored: np.ndarray, mend: Mend, unit_m: float = 0.001) -> np.ndarray:
    cv2.imwrite(str(tmp_path / "d.png"), stored)
    camera = Intrinsics(50.0, 50.0, 10.0, 10.0, 61, 41)
    scene = Scene("a", camera, unit_m, (Frame(0, 0.0, tmp_path / "c.png", tmp_path / "d.png"),))
    read = mended(Recording(scene, None), mend).scene
    return read_depth_m(read, read.frames[0])


def test_turned_bits_are_turned_back(tmp_path: Path) -> None:
    """As SUN3D's reader: right by 3, with the low bits to the top; also beyond 8.192 m."""
    depth_mm = np.full((41, 61), 1234, np.uint16)
    depth_mm[0] = 9000
    stored = (depth_mm << 3) | (depth_mm >> 13)
    found = depth_of(tmp_path, stored, Mend(depth_bits_turned=True))
    np.testing.assert_allclose(found, depth_mm * 0.001, atol=1e-6)


def test_depth_along_the_ray_becomes_depth_along_the_axis(tmp_path: Path) -> None:
    """A wall 1 m ahead: at (60, 10) the ray is sqrt(2) m long, at (10, 10) it is the axis."""
    stored = np.full((41, 61), 1000, np.uint16)
    stored[10, 60] = 1414
    found = depth_of(tmp_path, stored, Mend(depth_along_ray=True))
    assert (found[10, 10], found[10, 60]) == pytest.approx((1.0, 1.0), abs=1e-3)


def test_a_factor_of_poses_moves_the_camera_and_does_not_turn_it() -> None:
    poses = np.array([from_rotvec(np.array([0.1 * n, 0.2, 0.3]), np.array([n, 1.0, 2.0])) for n in range(3)])
    found = mended_poses(poses, Mend(inverted_poses=True, pose_factor=2.5))
    np.testing.assert_allclose(found[:, :3, :3], invert(poses)[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(found[:, :3, 3], 2.5 * invert(poses)[:, :3, 3], atol=1e-12)
    with pytest.raises(DataError, match="mend.pose_factor is -1"):
        Mend(pose_factor=-1.0)


def test_a_factor_of_depth_is_one_of_its_unit(tmp_path: Path) -> None:
    found = depth_of(tmp_path, np.full((41, 61), 3000, np.uint16), Mend(depth_factor=0.2))
    np.testing.assert_allclose(found, 0.6, atol=1e-6)
    with pytest.raises(DataError, match="mend.depth_factor is 0"):
        Mend(depth_factor=0.0)
