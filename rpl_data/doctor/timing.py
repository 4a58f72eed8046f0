"""Check timestamps for missing frames, and poses for jumps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.doctor.findings import Finding
from rpl_data.formats.recordings.times import USUAL_STEPS_S
from rpl_data.types import Scene, Trajectory
from rpl_data.wording import counted

GAP = 1.6
"""An interval this many times the usual one lacks a frame: a camera's clock jitters by less than half."""

FASTEST_M_S = 3.0
"""Speed of the camera that no hand reaches when filming an object."""


STANDS_OUT = 4.0
"""Only a step this many times the usual one is a jump: among key frames, or where times were assumed, all
steps may be too fast for a hand."""


def interval_s(scene: Scene) -> float:
    """Usual time between two frames; NaN for a single frame."""
    steps = np.diff(times_s(scene))
    return float(np.median(steps)) if len(steps) else float("nan")


def times_s(scene: Scene) -> Float64[np.ndarray, " n"]:
    """Timestamps in the order of the frames."""
    return np.array([frame.timestamp_s for frame in scene.frames], dtype=float)


def odd_times(scene: Scene) -> list[Finding]:
    """Return a finding when the usual interval is none that a camera has."""
    usual_s = interval_s(scene)
    if not usual_s > 0 or USUAL_STEPS_S[0] <= usual_s <= USUAL_STEPS_S[1]:
        return []
    what = f"frames are {usual_s:.3g} s apart, which no usual camera is: their times are hardly in seconds"
    todo = "write the times in seconds, milliseconds, microseconds or nanoseconds; the unit is then found"
    return [Finding("times", what, 1.0, todo)]


def dropped_frames(scene: Scene, left_out: Sequence[int] = ()) -> list[Finding]:
    """Return a finding when intervals are so long that frames not left out on purpose must be missing."""
    steps = np.diff(times_s(scene))
    if len(steps) < 2:
        return []
    usual = float(np.median(steps))
    if usual <= 0 or (steps < 0).any():
        back = int((steps <= 0).sum())
        what = f"{counted(back, 'frame')} not later than the one before"
        return [Finding("dropped frames", what, 1.0, "sort the list of frames by time; use seconds")]
    numbers = [frame.index for frame in scene.frames]
    known = np.diff(np.searchsorted(np.sort(np.asarray(left_out, dtype=int)), numbers))
    steps = steps - usual * known
    gaps = np.flatnonzero(steps > GAP * usual)
    if not len(gaps):
        return []
    missing = int(np.rint(steps[gaps] / usual - 1).sum())
    longest = ", ".join(
        f"{steps[gap]:.2f} s after frame {scene.frames[gap].index}"
        for gap in sorted(gaps, key=lambda gap: -steps[gap])[:3]
    )
    todo = (
        "record to a faster disk or at a lower rate; the frames that are there can be labelled, but do not "
        "compute times from row numbers, and expect a tracker to lose its way at the long gaps"
    )
    what = (
        f"about {counted(missing, 'frame')} missing in {counted(len(gaps), 'gap')} ({longest}); "
        f"the usual interval is {usual:.3f} s"
    )
    return [Finding("dropped frames", what, 1.0, todo)]


def pose_jumps(scene: Scene, trajectory: Trajectory) -> list[Finding]:
    """Return a finding when the camera moves faster than a hand can.

    Args:
        scene: the scene with the timestamps.
        trajectory: its poses.
    """
    time_of = {frame.index: frame.timestamp_s for frame in scene.frames}
    known = np.array([int(index) in time_of for index in trajectory.frames], dtype=bool)
    indices = trajectory.frames[known]
    stamps = np.array([time_of[int(index)] for index in indices])
    steps_m = np.linalg.norm(np.diff(trajectory.scene_from_camera[known, :3, 3], axis=0), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = steps_m / np.diff(stamps)
    usual_m = float(np.median(steps_m)) if len(steps_m) else 0.0
    fast = np.flatnonzero((speeds > FASTEST_M_S) & (steps_m >= STANDS_OUT * usual_m))
    if not len(fast):
        return []
    worst = fast[int(np.argmax(steps_m[fast]))]
    what = (
        f"the camera jumps {counted(len(fast), 'time')}, by {steps_m[worst]:.2f} m at most, "
        f"after frame {int(indices[worst])}"
    )
    todo = "the tracker lost its way: cut the scene there, or delete the poses to have the camera tracked"
    return [Finding("pose jump", what, 1.0, todo)]
