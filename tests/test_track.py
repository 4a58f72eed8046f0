"""Tracking: right where there is something to hold on to, and `lost` where there is not."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rpl_data.build import build
from rpl_data.capture import open_scenes
from rpl_data.formats.camera_file import write_camera
from rpl_data.formats.rpl import write_associations
from rpl_data.geometry import from_rotvec, invert, rays, rotation_angle_rad
from rpl_data.pipeline.poses import decoded
from rpl_data.recipe import parse_recipe
from rpl_data.reconstruct.tracking import Track, collected, losses, track
from rpl_data.reprojection import reprojection_over_gap
from rpl_data.types import DataError, Frame, Intrinsics, Scene, Trajectory
from rpl_data.workspace import Workspace, read_depth_m

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
FRAMES = 24


def orbit(count: int = FRAMES) -> np.ndarray:
    """A camera that goes sideways, looks back and comes a little nearer; the first pose is the identity."""
    turn, way = np.array([0.02, -0.25, 0.1]), np.array([0.22, -0.02, 0.08])
    return np.array([from_rotvec(s * turn, s * way) for s in np.linspace(0, 1, count)])


def brightness(points: np.ndarray, contrast: float) -> np.ndarray:
    """A print that goes through all of space: waves of 2 to 12 cm in all directions."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.02, 0.12, (12, 1))
    waves = np.cos(2 * np.pi * (points @ directions.T) + rng.uniform(0, 6, 12))
    return 128 + contrast * waves.sum(axis=1)


def shot(scene_from_camera: np.ndarray, *, boxes: bool, contrast: float, rng: np.random.Generator):
    """Small brightness and depth of a wall 0.9 m ahead of the first camera, with things before it or not."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    directions = (
        rays(CAMERA, np.column_stack([u.ravel(), v.ravel()]).astype(float)) @ scene_from_camera[:3, :3].T
    )
    origin = scene_from_camera[:3, 3]
    t = (0.9 - origin[2]) / directions[:, 2]
    for x, y, z, half in (
        ((-0.15, 0.1, 0.8, 0.08), (0.12, 0.05, 0.75, 0.07), (0.05, -0.12, 0.82, 0.06)) if boxes else ()
    ):
        across = np.sort(([x, y, z] - origin + half * np.array([-1, 1])[:, None, None]) / directions, axis=0)
        enters, leaves = across[0].max(axis=1), across[1].min(axis=1)
        t = np.where(enters < leaves, np.minimum(t, enters), t)
    grey = brightness(origin + directions * t[:, None], contrast) + rng.normal(0, 2, len(t))
    depth_m = t + rng.normal(0, 0.001, len(t)) * (t / 0.7) ** 2
    small = grey.reshape(CAMERA.height // 2, 2, CAMERA.width // 2, 2).mean(axis=(1, 3))
    return small.clip(0, 255).round().astype(np.uint8), depth_m.reshape(u.shape).astype(np.float32)


def scene_of(count: int) -> Scene:
    return Scene("made", CAMERA, 0.001, tuple(Frame(k, k / 30, Path("c"), Path("d")) for k in range(count)))


def tracked(
    poses: np.ndarray, *, boxes: bool = True, contrast: float = 10.0, blind: tuple[int, ...] = ()
) -> Track:
    """The track of shots from those poses; the camera looks at nothing in the blind ones."""
    scene, rng = scene_of(len(poses)), np.random.default_rng(1)

    def shots():
        for frame, pose in zip(scene.frames, poses, strict=True):
            grey, depth_m = shot(pose, boxes=boxes, contrast=contrast, rng=rng)
            yield frame, grey, np.zeros_like(depth_m) if frame.index in blind else depth_m

    return collected(scene, track(scene, shots()))


def errors(trajectory: Trajectory, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Millimetres and degrees from the truth, whose first pose is the identity."""
    wrong = invert(poses[trajectory.frames]) @ trajectory.scene_from_camera
    degrees = np.rad2deg([rotation_angle_rad(pose[:3, :3]) for pose in wrong])
    return np.linalg.norm(wrong[:, :3, 3], axis=1) * 1e3, degrees


@pytest.mark.parametrize("boxes", [True, False], ids=["with things", "bare printed wall"])
def test_the_path_is_right_to_millimetres(boxes: bool) -> None:
    found = tracked(orbit(), boxes=boxes)
    mm, deg = errors(found.trajectory, orbit())
    assert not found.lost
    assert mm.max() < 3 and np.median(mm) < 1.5
    assert deg.max() < 0.25


def test_a_bare_wall_without_print_does_not_slide_but_is_lost() -> None:
    with pytest.raises(
        DataError, match="scene made: the camera could not be tracked in any of its 24 frames"
    ):
        tracked(orbit(), boxes=False, contrast=0.0)


def test_frames_without_depth_are_left_out_and_the_track_goes_on() -> None:
    found = tracked(orbit(), blind=(7, 8, 9))
    assert found.lost == (7, 8, 9)
    assert errors(found.trajectory, orbit())[0].max() < 3
    assert losses(scene_of(FRAMES), found) == [
        "3 of 24 frames could not be tracked and are left out: 7, 8, 9"
    ]


def test_a_camera_that_comes_back_from_elsewhere_is_found_again() -> None:
    poses = orbit()
    away = from_rotvec(np.array([0, 2.0, 0]), np.zeros(3))  # it sees the back of nothing
    there = np.concatenate([poses[:12], [away] * 3, poses[20:]])
    there[15:] = poses[20:]
    found = tracked(there, blind=(12, 13, 14))
    assert found.lost == (12, 13, 14)
    assert errors(found.trajectory, there)[0].max() < 3


def test_lost_for_good_is_said() -> None:
    found = tracked(orbit(), blind=tuple(range(18, 24)))
    assert found.trajectory.frames.tolist() == list(range(18))
    assert losses(scene_of(FRAMES), found)[0].startswith(
        "the track was lost for good after frame 17: the last 6 of 24 frames are left out"
    )


def test_the_real_desk_is_tracked_better_than_its_given_poses(real_data: Path) -> None:
    recording = open_scenes(real_data / "desk", "rpl", names=["00"])[0]
    scene, given = recording.scene, recording.trajectory
    assert given is not None
    found = collected(scene, track(scene, decoded(scene, scene.frames, lambda done, total: None)))
    assert not found.lost
    for gap in (3, 9, 18):
        ours = reprojection_over_gap(scene, found.trajectory, gap=gap, read_depth_m=read_depth_m)
        theirs = reprojection_over_gap(scene, given, gap=gap, read_depth_m=read_depth_m)
        assert ours.median_m < theirs.median_m


def write_recording(folder: Path, poses: np.ndarray) -> None:
    """A RapidPoseLabels tree without camera.poses."""
    rng, scene = np.random.default_rng(2), folder / "00"
    names = [f"{number:03d}" for number in range(len(poses))]
    for kind in ("rgb", "depth"):
        (scene / kind).mkdir(parents=True)
    for name, pose in zip(names, poses, strict=True):
        grey, depth_m = shot(pose, boxes=True, contrast=10.0, rng=rng)
        color = cv2.cvtColor(cv2.resize(grey, (CAMERA.width, CAMERA.height)), cv2.COLOR_GRAY2BGR)
        cv2.imwrite(str(scene / f"rgb/{name}.jpg"), color)
        cv2.imwrite(str(scene / f"depth/{name}.png"), (depth_m * 1000).round().astype(np.uint16))
    write_camera(folder, CAMERA)
    times_s = [number / 30 for number in range(len(poses))]
    write_associations(scene, times_s, [f"rgb/{n}.jpg" for n in names], [f"depth/{n}.png" for n in names])


def test_a_build_from_a_recording_without_poses(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw", orbit(8))
    recipe = {
        "name": "raw",
        "scenes": [{"path": str(tmp_path / "raw")}],
        "objects": [{"name": "thing", "keypoints": 4}],
    }
    workspace = Workspace(tmp_path / "workspace")
    with pytest.raises(DataError, match="no camera poses; write `reconstruct: {method: track}`"):
        build(parse_recipe(recipe, source="raw"), workspace)
    recipe["reconstruct"] = {"method": "track"}
    ledger = build(parse_recipe(recipe, source="raw"), workspace, until="track")
    assert ledger.entries["track/00"].outcome.details == {"lost": 0}
    assert ledger.entries["track/00"].outcome.frames == 8
    found = workspace.load_trajectory(workspace.load_scene("00"))
    assert errors(found, orbit(8))[0].max() < 4
