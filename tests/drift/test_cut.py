"""The drift meter sees drift and nothing else; cuts are where they should be; clicks follow their frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rpl_data.drift.drift import Drift, cut, drift_from_json, drift_to_json, measure_drift
from rpl_data.formats.recordings.pose_lines import read_pose_lines
from rpl_data.formats.recordings.rpl import write_poses
from rpl_data.geometry import from_rotvec, rays, rigid
from rpl_data.images import depth_reader
from rpl_data.pipeline.build import build, context_of
from rpl_data.pipeline.recipe import ObjectRecipe, Recipe, RefineRecipe, SceneSource
from rpl_data.pipeline.results import quality_rows
from rpl_data.pipeline.stages.cut import choose_cut
from rpl_data.types import Click, DataError, Frame, Intrinsics, Recording, Scene, Trajectory
from rpl_data.workspace.parts import Parts
from rpl_data.workspace.workspace import Workspace

CAMERA = Intrinsics(150.0, 150.0, 79.5, 59.5, 160, 120)
FRAMES = 40


def poses() -> np.ndarray:
    """A camera above a floor, swinging to and fro."""
    places = [np.array([0.1 * np.sin(n / 6), 0.1 * np.cos(n / 5), -0.8]) for n in range(FRAMES)]
    return np.array(
        [from_rotvec(np.array([0.1 * np.sin(n / 4), 0.0, 0.0]), at) for n, at in enumerate(places)]
    )


def floor_depth_m(scene_from_camera: np.ndarray, noise: np.random.Generator) -> np.ndarray:
    """Depth of a floor at z = 0 with a step at x = 0, and noise of 2 mm."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    toward = rays(CAMERA, np.column_stack([u.ravel(), v.ravel()]).astype(float)) @ scene_from_camera[:3, :3].T
    depth_m = -scene_from_camera[2, 3] / toward[:, 2]
    right = scene_from_camera[0, 3] + depth_m * toward[:, 0] > 0
    depth_m = np.where(right, (-0.1 - scene_from_camera[2, 3]) / toward[:, 2], depth_m)
    return (depth_m + noise.normal(0, 0.002, len(depth_m))).reshape(CAMERA.height, CAMERA.width)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder, rng = tmp_path_factory.mktemp("floor"), np.random.default_rng(0)
    frames = []
    for n, pose in enumerate(poses()):
        path = folder / f"{n}.png"
        cv2.imwrite(str(path), np.rint(floor_depth_m(pose, rng) * 10_000).astype(np.uint16))
        frames.append(Frame(n, n / 30, path, path))
    return Recording(Scene("00", CAMERA, 0.0001, tuple(frames)), Trajectory(np.arange(FRAMES), poses()))


def trajectory(recording: Recording) -> Trajectory:
    assert recording.trajectory is not None
    return recording.trajectory


def sunk(recording: Recording, depth_m: np.ndarray) -> Trajectory:
    """The trajectory with each pose lower by so much, as a tracker that sinks would have it."""
    strayed = trajectory(recording).scene_from_camera.copy()
    strayed[:, 2, 3] += depth_m
    return Trajectory(np.arange(FRAMES), strayed)


def test_exact_poses_do_not_stray(recording: Recording) -> None:
    drift = measure_drift(recording.scene, trajectory(recording), depth_reader(recording.scene))
    assert 0.001 < drift.noise_m < 0.003  # the sensor's: differences of 2 mm noise, their median
    assert drift.whole_m < 0.002
    assert cut(drift, max_drift_m=0.01) == [(0, FRAMES - 1)]


def test_a_slow_drift_is_measured(recording: Recording) -> None:
    """Poses that sink by 30 mm; the farthest pairs, one in eleven, are four fifths of it apart."""
    drift = measure_drift(
        recording.scene, sunk(recording, np.linspace(0, 0.03, FRAMES)), depth_reader(recording.scene)
    )
    assert drift.whole_m == pytest.approx(0.8 * 0.03, rel=0.1)
    assert drift.noise_m < 0.003  # neighbours hardly notice


def test_jitter_is_no_drift(recording: Recording) -> None:
    """Poses that are off by 10 mm from frame to frame are noise: cutting would not help."""
    jitter = np.random.default_rng(1).normal(0, 0.010, FRAMES)
    drift = measure_drift(recording.scene, sunk(recording, jitter), depth_reader(recording.scene))
    assert drift.whole_m < 0.01 < drift.noise_m + drift.whole_m
    assert cut(drift, max_drift_m=0.015) == [(0, FRAMES - 1)]


def test_a_jump_is_cut_where_it_is(recording: Recording) -> None:
    strayed = sunk(recording, np.where(np.arange(FRAMES) < 25, 0.0, 0.04))
    found = cut(measure_drift(recording.scene, strayed, depth_reader(recording.scene)), max_drift_m=0.015)
    assert found is not None and len(found) == 2
    (first, last), (second, end) = found
    assert (first, second, end) == (0, last + 1, FRAMES - 1)
    assert abs(last - 24) <= 1  # every second frame was looked at


def test_frames_without_a_pose_or_depth_are_not_looked_at(recording: Recording) -> None:
    frames = tuple(replace(f, depth=None) if f.index == 3 else f for f in recording.scene.frames)
    known = Trajectory(np.arange(2, FRAMES), trajectory(recording).scene_from_camera[2:])
    drift = measure_drift(
        replace(recording.scene, frames=frames), known, depth_reader(recording.scene), most_frames=100
    )
    assert drift.frames.tolist() == [2, *range(4, FRAMES)]
    alone = measure_drift(
        replace(recording.scene, frames=frames[:1]), trajectory(recording), depth_reader(recording.scene)
    )
    assert (alone.whole_m, cut(alone, max_drift_m=0.01)) == (0.0, [(0, 0)])
    nothing = measure_drift(
        replace(recording.scene, frames=()), trajectory(recording), depth_reader(recording.scene)
    )
    assert cut(nothing, max_drift_m=0.01) == []


# By hand ------------------------------------------------------------------------------------------


def walked(at_m: list[float]) -> Drift:
    """Frames 0, 10, 20 ... at these places of a line."""
    places = np.array(at_m)
    return Drift(10 * np.arange(len(places)), np.abs(places[:, None] - places), 0.002)


def test_the_fewest_parts_and_the_worst_of_them_as_good_as_can_be() -> None:
    """Places 0, 1 and 5, 6 mm; six pairs make one group, of median 4.5 mm (1, 1, 4, 5, 5, 6)."""
    drift = walked([0.0, 0.001, 0.005, 0.006])
    assert drift.whole_m == pytest.approx(0.0045)
    assert cut(drift, max_drift_m=0.005) == [(0, 30)]
    assert cut(drift, max_drift_m=0.004) == [(0, 15), (16, 30)]  # (0, 25), (26, 30) is as short and worse
    assert cut(drift, max_drift_m=0.0005) == [(0, 5), (6, 15), (16, 25), (26, 30)]
    assert cut(drift, max_drift_m=0.0005, most_parts=3) is None
    assert cut(drift, max_drift_m=0.004, allowed=lambda first, last: first != 16) == [(0, 5), (6, 30)]


def test_json_keeps_what_is_unknown() -> None:
    between = np.array([[0.0, np.nan], [np.nan, 0.0]])
    found = drift_from_json(drift_to_json(Drift(np.array([3, 9]), between, 0.001)))
    np.testing.assert_array_equal(found.between_m, between)
    assert (found.frames.tolist(), found.noise_m, found.whole_m) == ([3, 9], 0.001, 0.0)


def clicks(frames: list[int], keypoints: int = 4, scene: str = "00") -> list[Click]:
    return [Click("cup", k, scene, frame, 1.0, 2.0) for frame in frames for k in range(keypoints)]


def test_a_recording_is_cut_only_where_clicks_place_every_part() -> None:
    drift = walked([0.0, 0.001, 0.020, 0.021])
    enough = choose_cut("00", drift, {"cup": clicks([0, 30])}, max_drift_m=0.01)
    assert enough.spans == ((0, 15), (16, 30))
    assert enough.messages == (
        "scene 00: its poses drift by 20 mm (max_drift_mm: 10), so it was cut into 2 (frames 0 to 15, "
        "16 to 30)",
    )
    short = choose_cut("00", drift, {"cup": clicks([0]) + clicks([0], scene="01")}, max_drift_m=0.01)
    assert short.spans == ()
    assert "click at least 4 keypoints of cup in frames 16 to 30" in short.messages[0]
    elsewhere = choose_cut("00", drift, {"cup": clicks([0], scene="01")}, max_drift_m=0.01)
    assert len(elsewhere.spans) == 2  # the object does not stand here


def test_a_recording_is_cut_as_far_as_clicks_allow() -> None:
    """Three places 60 mm and 16 mm apart, clicks at the first and the last: one cut is better than none."""
    drift = walked([0.0, 0.001, 0.060, 0.061, 0.076, 0.077])
    found = choose_cut("00", drift, {"cup": clicks([0, 50])}, max_drift_m=0.01)
    assert found.spans == ((0, 15), (16, 50))
    assert "click at least 4 keypoints of cup in frames 16 to 35" in found.messages[0]


def test_poses_that_stray_too_fast_are_refused() -> None:
    with pytest.raises(DataError, match=r"scene 00: its poses drift by .* mm.*max_drift_mm: 10.*slowly"):
        choose_cut("00", walked(list(0.1 * np.arange(9))), {"cup": clicks([0])}, max_drift_m=0.01)


# Parts --------------------------------------------------------------------------------------------


def test_clicks_follow_their_frames(recording: Recording, tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    workspace.save_recording(recording)
    click = {"op": "click", "keypoint": 0, "scene": "00", "frame": 30, "u_px": 1.0, "v_px": 2.0}
    names = {"op": "keypoints", "names": ["a", "b"]}
    workspace.append_events("cup", [names, {"op": "batch", "events": [click]}])
    workspace.cut_scene("00", [(0, 19), (20, 39)])
    assert workspace.scene_names() == ["00.1", "00.2"] and workspace.video_names() == ["00"]
    assert [f.index for f in workspace.load_scene("00.2").frames] == list(range(20, 40))
    second = workspace.load_trajectory(workspace.load_scene("00.2"))
    np.testing.assert_allclose(second.at(30), trajectory(recording).at(30), atol=1e-12)
    (found,) = workspace.load_annotation("cup").clicks
    assert (found.scene, found.frame) == ("00.2", 30)
    workspace.append_events("cup", [{**click, "scene": "00.1", "frame": 5}])  # as the page would
    workspace.cut_scene("00", [(0, 2), (3, 39)])  # cut elsewhere: the clicks are where their frames are
    assert {(c.scene, c.frame) for c in workspace.load_annotation("cup").clicks} == {
        ("00.2", 30),
        ("00.2", 5),
    }
    workspace.cut_scene("00", [(0, 39)])
    assert workspace.scene_names() == ["00"] == workspace.video_names()
    assert {c.scene for c in workspace.load_annotation("cup").clicks} == {"00"}


def test_a_part_does_not_take_the_place_of_a_recording(recording: Recording, tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    workspace.save_recording(recording)
    workspace.save_recording(replace(recording, scene=replace(recording.scene, name="00.1")))
    with pytest.raises(DataError, match="00.1.*rename"):
        workspace.cut_scene("00", [(0, 19), (20, 39)])
    assert workspace.scene_names() == ["00", "00.1"]


def test_frames_beyond_those_looked_at_belong_to_the_nearest_part() -> None:
    parts = Parts({"00": ((4, 9), (10, 20))})
    assert [parts.scene_at("00", frame) for frame in (0, 9, 10, 99)] == ["00.1", "00.1", "00.2", "00.2"]
    assert parts.scene_at("01", 3) == "01" and parts.video_of("00.2") == "00" and parts.video_of("01") == "01"


# A build ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def strayed(tiny_workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny recording, its poses of scene 00 lower by 60 mm from the middle on."""
    folder = tmp_path_factory.mktemp("strayed")
    for path in tiny_workspace.recording.glob("*/*"):
        (folder / path.parent.name).mkdir(exist_ok=True)
        if path.name != "camera.poses" or path.parent.name != "00":
            (folder / path.parent.name / path.name).symlink_to(path)
    (folder / "camera.txt").symlink_to(tiny_workspace.recording / "camera.txt")
    times_s, given = read_pose_lines(tiny_workspace.recording / "00" / "camera.poses")
    given[len(given) // 2 :] = given[len(given) // 2 :] @ rigid(np.eye(3), np.array([0.0, 0.0, 0.06]))
    write_poses(folder / "00", times_s.tolist(), given)
    return folder


def test_a_build_cuts_what_strays_and_its_labels_are_better(
    tiny_workspace: Workspace, strayed: Path, tmp_path: Path
) -> None:
    errors_mm = {}
    context = context_of(tiny_workspace)
    recipe = replace(
        context.recipe, twin=None, objects=context.objects, truth=tiny_workspace.truth,
        scenes=(SceneSource(strayed, metres_per_unit=0.001),), refine=RefineRecipe(scenes=False),
    )  # fmt: skip
    for limit_mm in (1000.0, 15.0):
        options = replace(context.recipe.reconstruct, method="given", max_drift_mm=limit_mm)
        recipe = replace(recipe, reconstruct=options)
        workspace = Workspace(tmp_path)
        ledger = build(recipe, workspace, until="quality", workers=1)
        errors_mm[limit_mm] = quality_rows(ledger)[0].position_mm  # what strays moves along the axis
        if limit_mm == 1000:
            assert workspace.scene_names() == ["00", "01", "02"]
    assert workspace.scene_names() == ["00.1", "00.2", "01", "02"]  # the sound ones are whole
    assert {"00.1", "00.2"} <= set(workspace.load_solution("carton").scene_from_object)
    assert [label.frame for label in workspace.load_labels("00")] == list(range(6))
    assert errors_mm[15.0] < 0.75 * errors_mm[1000.0]  # one scene of three strayed
    ledger = build(replace(recipe, reconstruct=replace(options, method="auto")), workspace, until="track")
    assert "too few of its frames see the same" in ledger.entries["track/00"].outcome.messages[0]
    assert not ledger.entries["track/01"].outcome.messages  # its images agree with its poses


def test_poses_of_the_real_desk_are_put_right_by_its_images(real_data: Path, tmp_path: Path) -> None:
    objects = (ObjectRecipe("cube", 8, real_data / "desk/clicks.csv"),)
    recipe = Recipe("desk", (SceneSource(real_data / "desk"),), objects)
    ledger = build(recipe, Workspace(tmp_path), until="track", workers=1)
    for scene in ("00", "01"):
        details = ledger.entries[f"track/{scene}"].outcome.details
        assert details["path"] == "ours"
        (given_px, ours_px), (given_m, ours_m) = details["color_px"], details["depth_m"]
        assert ours_px < 1 < 3 < given_px
        assert ours_m < 0.006 < given_m
