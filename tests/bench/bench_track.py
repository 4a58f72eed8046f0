"""Tracking: error, cost and memory, each beside what it is compared with in the same run.

Renders partial orbits of 20 s and a full one of 30 s once (fifteen minutes on one core; kept in the folder
RPL_BENCH_CACHE names).
The real recordings are looked for where RPL_REAL_DATA points.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from made_scenes import errors, orbit, tracked
from rows import record

from rpl_data.drift.reprojection import reprojection_over_gap
from rpl_data.geometry import fit_rigid, invert, resized, transform
from rpl_data.images import depth_reader, read_color, read_depth_m, read_grey
from rpl_data.pipeline.stages.track import decoded
from rpl_data.reconstruct.path import Track, collected
from rpl_data.reconstruct.path_correction import correct_path
from rpl_data.reconstruct.surface import fuse_surface
from rpl_data.reconstruct.tracking import Tracked, Tracker, track
from rpl_data.reconstruct.view import REDUCE, View, Viewer
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, DepthImage, Frame, GreyImage, Recording, Scene, Trajectory
from rpl_data.workspace.workspace import Workspace

DESK_GAPS, KITCHEN_GAPS = (3, 9, 18), (9, 30, 75)


def rendered(tmp_path_factory: pytest.TempPathFactory, name: str, **options: Any) -> Recording:
    """A hand-held camera goes around two objects and clutter; its sensors err."""
    from rpl_data.twin.spec import TwinSpec
    from rpl_data.twin.write import write_twin

    kept = os.environ.get("RPL_BENCH_CACHE")
    folder = (Path(kept) if kept else tmp_path_factory.mktemp("track")) / name
    if not (folder / "camera.txt").exists():
        write_twin(folder, TwinSpec(objects=("carton", "kettle"), scenes=1, seed=7, **options), workers=2)
    return open_scenes(folder, "rpl", metres_per_unit=0.001)[0]


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """160 degrees in 20 s."""
    return rendered(tmp_path_factory, "orbit", seconds=20.0, keep_hz=15.0)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The same where table, floor and walls are of one even colour each."""
    return rendered(tmp_path_factory, "orbit_plain", seconds=20.0, keep_hz=15.0, plain_room=True)


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """360 degrees in 30 s, among plain walls."""
    return rendered(
        tmp_path_factory, "loop_plain", seconds=30.0, keep_hz=10.0, sweep_deg=360.0, plain_room=True
    )


@pytest.fixture(scope="module")
def kitchen(real_data: Path) -> Recording:
    return open_scenes(real_data / "kitchen", "frames")[0]


def follow(scene: Scene, depths: Callable[[Frame], DepthImage] | None = None) -> Track:
    images = decoded(scene.frames, depths or depth_reader(scene), lambda done, total: None)
    return collected(scene, track(scene, images))


def from_first(recording: Recording, trajectory: Trajectory) -> tuple[np.ndarray, Trajectory]:
    """True poses of the tracked frames, and tracked ones, both in the frame of the first of them."""
    assert recording.trajectory is not None
    true = np.array([recording.trajectory.at(frame) for frame in trajectory.frames])
    ours = invert(trajectory.scene_from_camera[0]) @ trajectory.scene_from_camera
    return invert(true[0]) @ true, Trajectory(np.arange(len(true)), ours)


def rmse_mm(recording: Recording, trajectory: Trajectory) -> float:
    """Root mean square distance of the positions after the best rigid fit (the field's ATE)."""
    true, ours = from_first(recording, trajectory)
    places = ours.scene_from_camera[:, :3, 3]
    fitted = transform(fit_rigid(true[:, :3, 3], places), places)
    return float(np.sqrt(((fitted - true[:, :3, 3]) ** 2).sum(axis=1).mean()) * 1e3)


@pytest.mark.parametrize("name", ["twin", "plain"])
def test_partial_orbit_with_clutter(name: str, request: pytest.FixtureRequest) -> None:
    recording: Recording = request.getfixturevalue(name)
    found = follow(recording.scene)
    true, ours = from_first(recording, found.trajectory)
    mm, deg = errors(ours, true)
    median_mm, median_deg = float(np.median(mm)), float(np.median(deg))
    print(f"\n{name}: 20-s partial orbit, {len(recording.scene.frames)} frames, {len(found.lost)} lost")
    print(f"  position  median {median_mm:.2f} mm (5 allowed: {5 / median_mm:.1f}x), largest {mm.max():.2f}")
    print(f"  rotation  median {median_deg:.3f} deg (0.3: {0.3 / median_deg:.1f}x), largest {deg.max():.3f}")
    record("track", f"{name}, position", median_mm, "mm", baseline=("allowed", 5.0))
    record("track", f"{name}, rotation", median_deg, "deg", baseline=("allowed", 0.3))
    assert median_mm <= 5 and median_deg <= 0.3


class OpenChain(Tracker):
    """Knows the newest keyframe only, so that no view is recognised and no loop closes."""

    def step(self, frame: Frame, view: View) -> Tracked:
        result = super().step(frame, view)
        del self._map.keyframes[:-1]
        return result


def test_a_full_orbit_closes(loop: Recording) -> None:
    """The error of the last frame relative to the first, whose views overlap, and of the whole path."""
    scene, viewer, read = loop.scene, Viewer(loop.scene.intrinsics), depth_reader(loop.scene)

    def look(frame: Frame) -> View:
        return viewer.look(read_grey(frame, reduce=REDUCE), read(frame))

    chain = OpenChain(color_trust=1.0)
    paths = {"open chain": collected(scene, (chain.step(f, look(f)) for f in scene.frames)).trajectory}
    paths["chain and pose graph"] = correct_path(scene, paths["open chain"], look).trajectory
    paths["tracker"] = follow(scene).trajectory
    paths["tracker and pose graph"] = correct_path(scene, paths["tracker"], look).trajectory
    print(f"\nfull orbit, plain walls, {len(scene.frames)} frames")
    ends_mm = {}
    for name, path in paths.items():
        true, ours = from_first(loop, path)
        ends_mm[name] = errors(ours, true)[0][-1]
        print(f"  {name:24s} last to first {ends_mm[name]:5.2f} mm, whole path {rmse_mm(loop, path):5.2f} mm")
    assert ends_mm["chain and pose graph"] < ends_mm["open chain"] / 2


def test_bare_plane() -> None:
    mm, deg = errors(tracked(orbit(90), boxes=False).trajectory, orbit(90))
    print(f"\nbare printed plane: largest error {mm.max():.2f} mm, {deg.max():.3f} deg over a path of 230 mm")
    assert mm.max() < 5
    with pytest.raises(DataError) as said:
        tracked(orbit(90), boxes=False, contrast=0.0)
    print(f"bare plane without print: {str(said.value)[:90]}...")


def against_given(recording: Recording, gaps: tuple[int, ...]) -> None:
    """Depth reprojection errors beside those of the poses the recording came with."""
    assert recording.trajectory is not None
    scene = recording.scene
    found = follow(scene)
    print(f"\n{scene.name}: {len(scene.frames) - len(found.lost)} of {len(scene.frames)} frames tracked")
    for gap in gaps:
        given, ours = (
            reprojection_over_gap(
                scene, poses, gap=gap, read_depth=depth_reader(scene), most_pairs=100
            ).median_m
            for poses in (recording.trajectory, found.trajectory)
        )
        print(f"  gap {gap:2d}: given {given * 1e3:5.2f} mm, ours {ours * 1e3:5.2f} mm: {given / ours:.2f}x")
        work = f"{scene.name}, depth reprojection over {gap} frames"
        record("track", work, 1e3 * ours, "mm", baseline=("given poses", 1e3 * given), asked=1.0)
        assert ours <= given
    assert not found.lost


def test_desk_without_its_poses(real_data: Path) -> None:
    for recording in open_scenes(real_data / "desk", "rpl"):
        against_given(recording, DESK_GAPS)


def test_kitchen_without_its_poses(kitchen: Recording) -> None:
    against_given(kitchen, KITCHEN_GAPS)


# Cost ---------------------------------------------------------------------------------------------


def test_cost_against_open3d(twin: Recording, plain: Recording, kitchen: Recording) -> None:
    """Open3D's dense SLAM at 1 cm on half-sized images; decoding is not counted."""
    cv2.setNumThreads(1)
    print("\nCPU a frame, decoding excluded")
    for name, recording, step in (("twin", twin, 1), ("plain", plain, 1), ("kitchen", kitchen, 3)):
        scene = replace(recording.scene, frames=recording.scene.frames[: 80 * step : step])
        images = list(decoded(scene.frames, depth_reader(scene), lambda done, total: None))
        (mine_ms, mine), (other_ms, other) = ours(scene, images), open3d_slam(scene, images)
        gap = 9 * step
        for who, cpu_ms, poses in (("Open3D slam.Model", other_ms, other), ("ours", mine_ms, mine)):
            apart = (
                reprojection_over_gap(scene, poses, gap=gap, read_depth=depth_reader(scene)).median_m * 1e3
            )
            print(
                f"  {name:8s} {who:18s} {cpu_ms:6.1f} ms, error {rmse_mm(recording, poses):6.2f} mm, "
                f"depth reprojection over {gap} frames {apart:5.2f} mm"
            )
        slam = ("Open3D slam.Model, 1 cm", other_ms)
        record("track", f"{name}, CPU per frame", mine_ms, "ms", baseline=slam, asked=10.0)
        slam = ("Open3D slam.Model, 1 cm", rmse_mm(recording, other))
        record("track", f"{name}, error", rmse_mm(recording, mine), "mm", baseline=slam, asked=1.0)
        print(f"  {name:8s} ratio {other_ms / mine_ms:.1f}x")


def ours(scene: Scene, images: list[tuple[Frame, GreyImage, DepthImage]]) -> tuple[float, Trajectory]:
    """CPU milliseconds a frame, and the path."""
    started = time.process_time()
    found = collected(scene, track(scene, images))
    return (time.process_time() - started) / len(images) * 1e3, found.trajectory


def open3d_slam(scene: Scene, images: list[tuple[Frame, GreyImage, DepthImage]]) -> tuple[float, Trajectory]:
    """The loop of Open3D's own example dense_slam.py on the same frames."""
    import open3d as o3d

    size = scene.intrinsics.width // 2, scene.intrinsics.height // 2
    half = resized(scene.intrinsics, width=size[0], height=size[1])
    device, matrix = o3d.core.Device("CPU:0"), o3d.core.Tensor(half.matrix)
    model = o3d.t.pipelines.slam.Model(0.01, 16, 40000, o3d.core.Tensor(np.eye(4)), device)
    seen = o3d.t.pipelines.slam.Frame(size[1], size[0], matrix, device)
    cast = o3d.t.pipelines.slam.Frame(size[1], size[0], matrix, device)
    pose, poses, spent = np.eye(4), [], 0.0
    for number, (_, grey, depth_m) in enumerate(images):
        units = np.ascontiguousarray((depth_m[::2, ::2] * 1000).round().astype(np.uint16))
        color = np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2))
        started = time.process_time()
        seen.set_data_from_image("depth", o3d.t.geometry.Image(o3d.core.Tensor(units)))
        seen.set_data_from_image("color", o3d.t.geometry.Image(o3d.core.Tensor(color)))
        if number:
            pose = pose @ model.track_frame_to_model(seen, cast, 1000.0, 4.0).transformation.numpy()
        model.update_frame_pose(number, o3d.core.Tensor(pose))
        model.integrate(seen, 1000.0, 4.0)
        model.synthesize_model_frame(cast, 1000.0, 0.1, 4.0)
        spent += time.process_time() - started
        poses.append(pose)
    indices = np.array([frame.index for frame, _, _ in images])
    return spent / len(images) * 1e3, Trajectory(indices, np.array(poses))


def test_end_to_end(twin: Recording, tmp_path: Path) -> None:
    """Decode, keep the depth, track, and fuse the surface around the objects; wall time on all cores."""
    scene, workspace = twin.scene, Workspace(tmp_path)
    started, cpu_s = time.perf_counter(), time.process_time()
    found = follow(scene, workspace.depth_reader(scene, keep=True))
    tracked_s = time.perf_counter() - started
    centre = transform(found.trajectory.scene_from_camera[0], np.array([[0.0, 0.0, 0.7]]))[0]
    mesh = fuse_surface(
        scene,
        found.trajectory,
        scene.frames,
        workspace.depth_reader(scene),
        centre_scene=centre,
        radius_m=0.2,
        colors=read_color,
    )
    wall_s = time.perf_counter() - started
    count = len(scene.frames)
    rate, cpu_ms = count / wall_s, (time.process_time() - cpu_s) / count * 1e3
    wanted = ("wanted", 25.0)
    record("track", "decode, track and fuse", rate, "frames/s", baseline=wanted, more_is_better=True)
    print(
        f"\ndecode, keep and track {count / tracked_s:.1f} frames/s; with the surface of 3 mm voxels "
        f"({len(mesh.triangles)} triangles) {rate:.1f} frames/s: {rate / 25:.2f}x the 25 wanted; "
        f"{cpu_ms:.1f} ms CPU a frame, all threads"
    )


def test_memory_is_flat(twin: Recording) -> None:
    """The orbit played forwards and backwards, five times its length."""
    scene = twin.scene
    viewer, tracker = Viewer(scene.intrinsics), Tracker(color_trust=1.0)
    print("\nframes  resident MB  keyframes")
    for number, frame in enumerate(to_and_fro(scene.frames, times=5)):
        moment = replace(frame, timestamp_s=number / 15)
        tracker.step(moment, viewer.look(read_grey(frame, reduce=REDUCE), read_depth_m(scene, frame)))
        if (number + 1) % len(scene.frames) == 0:
            print(f"{number + 1:6d}  {resident_mb():11.0f}  {len(tracker.keyframes):9d}", flush=True)


def to_and_fro(frames: tuple[Frame, ...], *, times: int) -> Iterator[Frame]:
    for turn in range(times):
        yield from frames if turn % 2 == 0 else frames[::-1]


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
