"""Tracking: right where there is something to hold on to, and `lost` where there is not."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from made_scenes import CAMERA, FRAMES, errors, orbit, scene_of, shot, tracked

from rpl_data.drift.reprojection import reprojection_over_gap
from rpl_data.formats.recordings.camera_file import write_camera
from rpl_data.formats.recordings.rpl import write_associations
from rpl_data.geometry import from_rotvec
from rpl_data.images import depth_reader, read_depth_m
from rpl_data.pipeline.build import build, context_of, recipe_of, stale_steps
from rpl_data.pipeline.recipe_file import parse_recipe
from rpl_data.pipeline.stages.clicks import add_clicks
from rpl_data.pipeline.stages.track import decoded
from rpl_data.reconstruct.path import collected, losses
from rpl_data.reconstruct.tracking import Loss, track
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


@pytest.mark.parametrize("boxes", [True, False], ids=["with things", "bare printed wall"])
def test_the_path_is_right_to_millimetres(boxes: bool) -> None:
    found = tracked(orbit(), boxes=boxes)
    mm, deg = errors(found.trajectory, orbit())
    assert not found.lost
    assert mm.max() < 3 and np.median(mm) < 1.5
    assert deg.max() < 0.25


def test_a_bare_wall_without_print_does_not_slide_but_is_lost() -> None:
    with pytest.raises(
        DataError, match=r"scene made: .* of 24 frames, each of 1 .* has an image without contrast"
    ):
        tracked(orbit(), boxes=False, contrast=0.0)


def test_frames_without_depth_are_left_out_and_the_track_goes_on() -> None:
    found = tracked(orbit(), blind=(7, 8, 9))
    assert found.lost == (7, 8, 9)
    assert errors(found.trajectory, orbit())[0].max() < 3
    assert losses(scene_of(FRAMES), found) == [
        "3 of 24 frames could not be tracked and are left out: each of 7 (c), 8 (c), 9 (c) has "
        "hardly any depth (keep the lens free and the camera at the distance its maker gives)"
    ]


def test_a_camera_that_comes_back_from_elsewhere_is_found_again() -> None:
    poses = orbit()
    away = from_rotvec(np.array([0, 2.0, 0]), np.zeros(3))  # it sees the back of nothing
    there = np.concatenate([poses[:12], [away] * 3, poses[20:]])
    there[15:] = poses[20:]
    found = tracked(there, blind=(12, 13, 14))
    assert found.lost == (12, 13, 14)
    assert errors(found.trajectory, there)[0].max() < 3


def test_a_far_wall_is_noisy_and_does_not_lose_the_camera() -> None:
    """The noise of 13 cm of a wall at 8 m is no disagreement; its edges against the things are no slopes."""
    found = tracked(orbit()[:8], wall_m=8.0)
    assert not found.lost
    mm, deg = errors(found.trajectory, orbit())
    assert mm.max() < 1 and deg.max() < 0.1


def test_frames_in_any_order_are_found_or_named() -> None:
    """The camera jumps back and forth: what shows nothing known at first is found once its neighbours are."""
    order = np.random.default_rng(4).permutation(FRAMES)
    order = order[np.r_[np.argmin(order), np.delete(np.arange(FRAMES), np.argmin(order))]]
    found = tracked(orbit()[order])
    assert len(found.trajectory.frames) + len(found.lost) == FRAMES
    assert len(found.lost) <= 2
    assert errors(found.trajectory, orbit()[order])[0].max() < 4


def test_two_frames_that_share_nothing_are_lost_by_name() -> None:
    apart = np.stack([np.eye(4), from_rotvec(np.array([0, 0.9, 0]), np.array([0.5, 0.0, 0.0]))])
    with pytest.raises(
        DataError, match=r"of 2 frames, frame 0 \(c\) is blurred or shows too little of what the tracked"
    ):
        tracked(apart)


def test_a_start_from_which_nothing_follows_is_left_out() -> None:
    away = from_rotvec(np.array([0, 0.9, 0]), np.array([0.5, 0.0, 0.0]))
    found = tracked(np.concatenate([away[None], orbit()[:6]]))
    assert found.lost == (0,)
    assert errors(found.trajectory, np.concatenate([away[None], orbit()[:6]]))[0].max() < 3


def test_a_blurred_frame_and_a_covered_lens_lose_themselves_only() -> None:
    def blur(grey: np.ndarray) -> np.ndarray:
        return cv2.blur(grey, (21, 1))

    def cover(grey: np.ndarray) -> np.ndarray:
        return np.full_like(grey, 12)

    found = tracked(orbit(), boxes=False, spoilt={7: blur, 8: blur, 14: cover, 15: cover})
    assert set(found.lost) <= {7, 8, 14, 15} and {14, 15} <= set(found.lost)
    assert all(why is (Loss.UNLIKE if index < 10 else Loss.DARK) for index, why in found.losses.items())
    assert errors(found.trajectory, orbit())[0].max() < 3


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
    found = collected(
        scene, track(scene, decoded(scene.frames, depth_reader(scene), lambda done, total: None))
    )
    assert not found.lost
    for gap in (3, 9, 18):
        ours = reprojection_over_gap(scene, found.trajectory, gap=gap, read_depth=depth_reader(scene))
        theirs = reprojection_over_gap(scene, given, gap=gap, read_depth=depth_reader(scene))
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
        "reconstruct": {"method": "given"},
    }
    workspace = Workspace(tmp_path / "workspace")
    with pytest.raises(DataError, match="no camera poses; write `reconstruct: {method: track}`"):
        build(parse_recipe(recipe, source="raw"), workspace)
    del recipe["reconstruct"]  # auto: what has no poses is tracked
    ledger = build(parse_recipe(recipe, source="raw"), workspace, until="track")
    assert ledger.entries["track/00"].outcome.details == {"lost": 0}
    assert ledger.entries["track/00"].outcome.frames == 8
    found = workspace.load_trajectory(workspace.load_scene("00"))
    assert errors(found, orbit(8))[0].max() < 4
    assert all(holds for _, holds in stale_steps(recipe_of(workspace), workspace)["track"])
    rows = "".join(f"thing,{n},00,0,{100 + 9 * n},120\n" for n in range(4))
    (tmp_path / "clicks.csv").write_text(f"object,keypoint,scene,frame,u_px,v_px\n{rows}")
    add_clicks(context_of(workspace), tmp_path / "clicks.csv")  # paths are judged around what is clicked
    assert stale_steps(recipe_of(workspace), workspace)["track"] == [("00", False)]


def test_depth_is_kept_for_the_next_reader(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw", orbit(2))
    scene = open_scenes(tmp_path / "raw", "rpl")[0].scene
    workspace = Workspace(tmp_path / "workspace")
    first, second = scene.frames
    stored = read_depth_m(scene, first)
    np.testing.assert_array_equal(workspace.depth_reader(scene, keep=True)(first), stored)
    kept = sorted(workspace.cache("00").rglob("*.zst"))
    assert [path.name for path in kept] == ["000000.zst"]
    assert first.depth is not None
    first.depth.unlink()  # so that it can come from the cache alone
    np.testing.assert_array_equal(workspace.depth_reader(scene)(first), stored)
    kept[0].write_bytes(b"cut off")
    with pytest.raises(DataError, match="found nothing readable"):
        workspace.depth_reader(scene)(first)
    workspace.depth_reader(scene)(second)
    assert len(list(workspace.cache("00").rglob("*.zst"))) == 1  # reading alone keeps nothing
