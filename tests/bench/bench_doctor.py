"""The doctor on planted faults: how many it finds in 20 recordings a fault, and what it says of sound ones.

Renders 20 recordings of 2 s (20 minutes on one core, kept in the folder RPL_BENCH_CACHE names), plants
each fault in each of them, and prints a table. Found = the planted kind is among the findings; other
findings beside it are counted as extra. The baseline of every row is the sound recording's: its alarms.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpl_data.capture import open_scenes
from rpl_data.doctor import examine as doctor
from rpl_data.geometry import invert
from rpl_data.types import DepthImage, Frame, Recording, Scene, Trajectory
from rpl_data.workspace import read_depth_m

RECORDINGS = 20


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    from rpl_data.twin.spec import TwinSpec
    from rpl_data.twin.write import write_twin

    kept = os.environ.get("RPL_BENCH_CACHE")
    root = Path(kept) if kept else tmp_path_factory.mktemp("doctor")
    found = []
    for seed in range(RECORDINGS):
        folder = root / f"doctor-{seed:02d}"
        if not folder.exists():
            objects = (("carton", "kettle"), ("carton",), ("kettle",))[seed % 3]
            spec = TwinSpec(objects=objects, scenes=1, seconds=2.0, sweep_deg=40.0, seed=100 + seed)
            write_twin(folder, spec, workers=2)
        found += open_scenes(folder, "rpl", metres_per_unit=0.001)
    return found


def poses(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    assert recording.trajectory is not None
    changed = change(recording.trajectory.scene_from_camera)
    return replace(recording, trajectory=Trajectory(recording.trajectory.frames, changed))


def wxyz(stored: np.ndarray) -> np.ndarray:
    read = stored.copy()
    quaternions = np.roll(Rotation.from_matrix(stored[:, :3, :3]).as_quat(), 1, axis=1)
    read[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    return read


def frames(recording: Recording, kept: list[Frame]) -> Recording:
    return replace(recording, scene=replace(recording.scene, frames=tuple(kept)))


def late(recording: Recording) -> Recording:
    old = recording.scene.frames
    return frames(recording, [replace(old[n], depth=old[n - 3].depth) for n in range(3, len(old))])


def dropped(recording: Recording) -> Recording:
    lost = set(np.random.default_rng(0).choice(np.arange(2, 58), 4, replace=False).tolist())
    return frames(recording, [frame for frame in recording.scene.frames if frame.index not in lost])


def unit(recording: Recording) -> Recording:
    return replace(
        recording, scene=replace(recording.scene, metres_per_unit=5 * recording.scene.metres_per_unit)
    )


def camera(recording: Recording) -> Recording:
    old = recording.scene.intrinsics
    return replace(
        recording, scene=replace(recording.scene, intrinsics=replace(old, fx=1.2 * old.fx, fy=1.2 * old.fy))
    )


FAULTS: dict[str, tuple[Callable[[Recording], Recording], set[str]]] = {
    "sound": (lambda r: r, set()),
    "depth unit x5": (unit, {"depth scale"}),
    "depth 3 frames late": (late, {"depth lag"}),
    "20 px mis-registered": (lambda r: r, {"registration"}),
    "inverted poses": (lambda r: poses(r, invert), {"pose convention"}),
    "wxyz quaternions": (lambda r: poses(r, wxyz), {"pose convention"}),
    "focal length x1.2": (camera, {"intrinsics"}),
    "4 dropped frames": (dropped, {"dropped frames"}),
}


def shifted_depth_m(scene: Scene, frame: Frame) -> DepthImage:
    return np.roll(read_depth_m(scene, frame), 20, axis=1)


def test_planted_faults(recordings: list[Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    print(f"\n{'fault':22s} found   with extra findings")
    for name, (plant, wanted) in FAULTS.items():
        monkeypatch.setattr(doctor, "read_depth_m", shifted_depth_m if "20 px" in name else read_depth_m)
        kinds = [
            {finding.kind for finding in doctor.examine(plant(recording)).findings}
            for recording in recordings
        ]
        found = sum(bool(wanted & said) for said in kinds)
        extra = sum(bool(said - wanted) for said in kinds)
        print(f"{name:22s} {found if wanted else '-':>2}/{len(kinds)}   {extra}/{len(kinds)}", flush=True)
