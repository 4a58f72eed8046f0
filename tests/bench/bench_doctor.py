"""The doctor on planted faults: how many it finds in 20 recordings per fault, what it says of sound ones.

Renders 20 recordings of 30 frames (4 minutes on one core, kept in the folder RPL_BENCH_CACHE names; fewer
where RPL_BENCH_SHARE says so) with other objects, clutter, distances, speeds, sensor noise and drift of the
poses in each, plants each fault in each of them, and prints a table. Found = the planted kind is among the
findings; other findings beside it are counted as extra. The baseline is the row of the sound recordings:
its alarms. The seeds of `RPL_BENCH_SEED` (2000) are held out: the doctor was mended on those from 0 and from
1000.
"""

from __future__ import annotations

import os
import struct
import tempfile
import time
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rows import record, shared
from scipy.ndimage import shift as moved_px
from scipy.spatial.transform import Rotation

from rpl_data.doctor import examine as doctor
from rpl_data.geometry import invert
from rpl_data.images import read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.twin.drift import Drift, drifted
from rpl_data.twin.objects import OBJECTS
from rpl_data.twin.sensor import ColorSensor, DepthSensor, Sensor
from rpl_data.twin.spec import TwinSpec
from rpl_data.twin.write import write_twin
from rpl_data.types import DepthImage, Frame, Recording, Scene, Trajectory

RECORDINGS = shared(20, least=4)
FIRST_SEED = int(os.environ.get("RPL_BENCH_SEED", "2000"))
SHIFT_PX = 20.0

Fault = Callable[[Recording, np.random.Generator], Recording]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    kept = os.environ.get("RPL_BENCH_CACHE")
    root = Path(kept) if kept else tmp_path_factory.mktemp("doctor")
    return [recording_of(root, seed) for seed in range(FIRST_SEED, FIRST_SEED + RECORDINGS)]


def recording_of(root: Path, seed: int) -> Recording:
    """A sound recording: noise, a pixel of registration and drifting poses as they really occur."""
    folder = root / f"doctor-{seed:04d}"
    if not folder.exists():
        write_twin(folder, spec_of(seed), workers=1)
    (recording,) = open_scenes(folder, "rpl", metres_per_unit=0.001)
    times_s = np.array([frame.timestamp_s for frame in recording.scene.frames])
    rng = np.random.default_rng([seed, 7])
    return poses(recording, lambda true: drifted(true, times_s, Drift(0.005, 0.3), rng=rng))


def spec_of(seed: int) -> TwinSpec:
    rng = np.random.default_rng([seed, 5])
    rate_hz = float(rng.choice([15.0, 30.0]))
    near = float(rng.uniform(0.42, 1.0))
    low = float(rng.uniform(20.0, 45.0))
    depth = DepthSensor(subpixel_px=float(rng.uniform(0.05, 0.15)))
    color = ColorSensor(
        exposure_s=float(rng.uniform(0.004, 0.012)), readout_s=float(rng.choice([0.0, 0.017])),
        noise=float(rng.uniform(0.6, 3.0)),
    )  # fmt: skip
    shift_px = tuple(rng.uniform(-1, 1, 2).tolist())
    return TwinSpec(
        objects=tuple(rng.choice(list(OBJECTS), int(rng.integers(1, 4)), replace=False).tolist()),
        scenes=1, seconds=30 / rate_hz, rate_hz=rate_hz, seed=seed, clutter=int(rng.integers(0, 8)),
        sweep_deg=float(rng.uniform(15, 50)), distance_m=(near, near * 1.25), elevation_deg=(low, low + 20),
        sensor=Sensor(depth=depth, color=color, shift_px=shift_px),
    )  # fmt: skip


# Faults -------------------------------------------------------------------------------------------


def poses(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    assert recording.trajectory is not None
    changed = change(recording.trajectory.scene_from_camera)
    return replace(recording, trajectory=Trajectory(recording.trajectory.frames, changed))


def inverted(recording: Recording, rng: np.random.Generator) -> Recording:
    return poses(recording, invert)


def wxyz(recording: Recording, rng: np.random.Generator) -> Recording:
    """Poses whose quaternions were read in the wrong order."""

    def read(stored: np.ndarray) -> np.ndarray:
        result = stored.copy()
        quaternions = np.roll(Rotation.from_matrix(stored[:, :3, :3]).as_quat(), 1, axis=1)
        result[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
        return result

    return poses(recording, read)


def frames(recording: Recording, kept: list[Frame]) -> Recording:
    return replace(recording, scene=replace(recording.scene, frames=tuple(kept)))


def late(recording: Recording, rng: np.random.Generator) -> Recording:
    """Depth 3 frames behind colour, or before it; poses are the colour camera's."""
    old, lag = recording.scene.frames, int(rng.choice([-3, 3]))
    rows = range(max(0, lag), len(old) + min(0, lag))
    return frames(recording, [replace(old[n], depth=old[n - lag].depth) for n in rows])


def dropped(recording: Recording, rng: np.random.Generator) -> Recording:
    lost = set(rng.choice(np.arange(2, 28), 3, replace=False).tolist())
    return frames(recording, [frame for frame in recording.scene.frames if frame.index not in lost])


def unit(recording: Recording, rng: np.random.Generator) -> Recording:
    factor = float(rng.choice([0.2, 5.0]))
    changed = replace(recording.scene, metres_per_unit=factor * recording.scene.metres_per_unit)
    return replace(recording, scene=changed)


def focal(recording: Recording, rng: np.random.Generator) -> Recording:
    """Intrinsics of another lens: the focal length a fifth off."""
    old, factor = recording.scene.intrinsics, float(rng.choice([1 / 1.2, 1.2]))
    return camera(recording, fx=factor * old.fx, fy=factor * old.fy)


def size(recording: Recording, rng: np.random.Generator) -> Recording:
    """Intrinsics of another resolution."""
    old, factor = recording.scene.intrinsics, float(rng.choice([0.5, 1.5, 2.0]))
    return camera(recording, **{name: factor * getattr(old, name) for name in ("fx", "fy", "cx", "cy")})


def camera(recording: Recording, **numbers: float) -> Recording:
    changed = replace(recording.scene.intrinsics, **numbers)
    return replace(recording, scene=replace(recording.scene, intrinsics=changed))


def strayed(recording: Recording, rng: np.random.Generator) -> Recording:
    """Poses on a random walk of 40 mm and 2.4 degrees (root mean square at the end; some stay near)."""
    times_s = np.array([frame.timestamp_s for frame in recording.scene.frames])
    return poses(recording, lambda true: drifted(true, times_s, Drift(0.04, 2.4), rng=rng))


def unposed_unit(recording: Recording, rng: np.random.Generator) -> Recording:
    """1/4, 1/5 or 1/10 mm read as millimetres, or millimetres as 1/5 mm; nobody knows the poses."""
    factor = float(rng.choice([0.2, 4.0, 5.0, 10.0]))
    changed = replace(recording.scene, metres_per_unit=factor * recording.scene.metres_per_unit)
    return replace(recording, scene=changed, trajectory=None)


def unposed(recording: Recording, rng: np.random.Generator) -> Recording:
    return replace(recording, trajectory=None)


def turned_reader(seed: int) -> Callable[[Scene, Frame], DepthImage]:
    """Depth whose 16 bits were turned left by 3, as SUN3D's."""

    def read(scene: Scene, frame: Frame) -> DepthImage:
        units = np.rint(read_depth_m(scene, frame) / scene.metres_per_unit).astype(np.uint16)
        return ((units << 3) | (units >> 13)).astype(np.float32) * np.float32(scene.metres_per_unit)

    return read


def ray_reader(seed: int) -> Callable[[Scene, Frame], DepthImage]:
    """Depth along the rays, rounded to stored units."""

    def read(scene: Scene, frame: Frame) -> DepthImage:
        camera = scene.intrinsics
        v, u = np.mgrid[: camera.height, : camera.width]
        lengths = np.sqrt(1 + ((u - camera.cx) / camera.fx) ** 2 + ((v - camera.cy) / camera.fy) ** 2)
        stored = np.rint(read_depth_m(scene, frame) * lengths / scene.metres_per_unit)
        return stored.astype(np.float32) * np.float32(scene.metres_per_unit)

    return read


def as_it_is(recording: Recording, rng: np.random.Generator) -> Recording:
    """The recording as it is; only its depth images are other ones when they are read."""
    return recording


def tagged(recording: Recording, rng: np.random.Generator) -> Recording:
    """From some frame on, or in all, the colour images ask to be turned."""
    first, tag = int(rng.choice([0, 0, 15])), int(rng.choice([2, 3, 6, 8]))
    folder = Path(tempfile.mkdtemp())
    exif = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, tag, 0, 0)
    chunk = len(exif).to_bytes(4) + b"eXIf" + exif + zlib.crc32(b"eXIf" + exif).to_bytes(4)
    segment = b"\xff\xe1" + (len(exif) + 8).to_bytes(2) + b"Exif\0\0" + exif
    kept = []
    for n, frame in enumerate(recording.scene.frames):
        path, content = folder / frame.color.name, frame.color.read_bytes()
        at = 2 if content.startswith(b"\xff\xd8") else 33
        path.write_bytes(
            content[:at] + (segment if at == 2 else chunk) + content[at:] if n >= first else content
        )
        kept.append(replace(frame, color=path))
    return frames(recording, kept)


def of_odd_times(recording: Recording, rng: np.random.Generator) -> Recording:
    """Times in a unit that no reader could find out, such as ticks of a clock."""
    factor = float(rng.choice([1e-4, 1e-5, 300.0]))
    return frames(recording, [replace(f, timestamp_s=f.timestamp_s * factor) for f in recording.scene.frames])


def shifted_reader(seed: int) -> Callable[[Scene, Frame], DepthImage]:
    angle = np.random.default_rng([seed, 11]).uniform(0, 2 * np.pi)
    vector = np.rint(SHIFT_PX * np.array([np.sin(angle), np.cos(angle)]))
    return lambda scene, frame: moved_px(read_depth_m(scene, frame), vector, order=0)


FAULTS: dict[str, tuple[Fault, set[str]]] = {
    "sound": (lambda recording, rng: recording, set()),
    "sound, no poses": (unposed, set()),
    "depth unit x5 or /5": (unit, {"depth scale"}),
    "depth 3 frames off": (late, {"depth lag"}),
    "20 px mis-registered": (as_it_is, {"registration"}),
    "inverted poses": (inverted, {"pose convention"}),
    "wxyz quaternions": (wxyz, {"pose convention"}),
    "focal length x1.2": (focal, {"intrinsics"}),
    "intrinsics' size": (size, {"intrinsics"}),
    "3 dropped frames": (dropped, {"dropped frames"}),
    "drift of 40 mm": (strayed, {"drift"}),
    "unit, no poses": (unposed_unit, {"depth scale"}),
    "turned bits": (as_it_is, {"turned bits"}),
    "turned, no poses": (unposed, {"turned bits"}),
    "ray length": (as_it_is, {"ray length"}),
    "EXIF orientation": (tagged, {"orientation"}),
    "odd times": (of_odd_times, {"times"}),
}

READS: dict[str, Callable[[int], Callable[[Scene, Frame], DepthImage]]] = {
    "20 px mis-registered": shifted_reader,
    "turned bits": turned_reader,
    "turned, no poses": turned_reader,
    "ray length": ray_reader,
}
"""What reads the depth images of a fault that lies in them, by the fault."""


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", FAULTS)
def test_planted_fault(name: str, recordings: list[Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    plant, wanted = FAULTS[name]
    kinds, begin = [], time.process_time()
    for seed, recording in enumerate(recordings, start=FIRST_SEED):
        reader = READS[name](seed) if name in READS else read_depth_m
        monkeypatch.setattr(doctor, "read_depth_m", reader)
        sick = plant(recording, np.random.default_rng([seed, 3]))
        kinds.append({finding.kind for finding in doctor.examine(sick).findings})
        if kinds[-1] != wanted:
            print(f"\n    {seed}: {', '.join(sorted(kinds[-1])) or 'nothing'}", end="", flush=True)
    seconds = (time.process_time() - begin) / len(recordings)
    alarms = sum(bool(said - wanted) for said in kinds)
    if wanted:
        caught = sum(bool(wanted & said) for said in kinds) / len(kinds)
        record("doctor", f"{name}: found", caught, "share", asked=0.95, more_is_better=True)
    record("doctor", f"{name}: false alarms", alarms / len(kinds), "share", asked=0.05)
    record("doctor", f"{name}: per recording", seconds, "s CPU")
    found = f"found in {sum(bool(wanted & said) for said in kinds)} of" if wanted else "sound in"
    print(f"\n{name:20s} {found} {len(kinds)}, false alarms in {alarms}; {seconds:.1f} s of CPU a recording")
