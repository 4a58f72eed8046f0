"""Judge whether colour, depth and poses belong together: in time (lags) and in the image (registration)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rpl_data.doctor.alignment import Alignment
from rpl_data.doctor.findings import Finding, option
from rpl_data.recordings.mend import Mend
from rpl_data.types import Intrinsics, Scene

LEAST_LAG_FRAMES = 0.25
LEAST_CONTRAST = 1.2
"""The peak of a lag or a shift must be this many times higher than that of the images as they are."""

LEAST_SHIFT = 0.01
"""Smallest shift reported, as a share of the image's width: good registration and depth edges err by less."""
LEAST_ZOOM = 0.02
"""Smallest difference of a zoom from 1 that is reported: 6 px at the sides of an image 640 px wide."""

SURE = 0.9


@dataclass(frozen=True)
class Lag:
    """How far depth is behind colour, in frames.

    Attributes:
        frames: the measured lag.
        whole: the lag in whole frames, which can be mended; 0 when it is not sure.
        sure: probability that there is a lag.
        poses_too: the poses are as late as depth, as those of a tracker that uses depth only are.
    """

    frames: float
    whole: int
    sure: float
    poses_too: bool = False


def lag_of(aligned: Alignment) -> Lag:
    """Return the lag that the edges show; 0 whole frames when it is not sure."""
    sure = aligned.sure_of_lag(LEAST_LAG_FRAMES)
    whole = round(aligned.lag_frames)
    if whole and aligned.lag_contrast < LEAST_CONTRAST:
        return Lag(aligned.lag_frames, 0, 0.0)
    return Lag(aligned.lag_frames, whole if sure >= SURE else 0, sure)


def decide_what_lags(aligned: Alignment, lag: Lag, found: list[Finding]) -> tuple[Lag, list[Finding]]:
    """Decide whether depth or the poses lag. Depth alone cannot tell, so colour edges break the tie.

    Late depth with punctual poses looks the same as late poses: poses and depth show to the frame how far
    apart they are. Colour and depth edges give the probability that it is depth that is late.
    """
    late = next((finding for finding in found if finding.kind == "pose lag"), None)
    if late is None or late.mend is None:
        return lag, found
    apart = lag.whole - late.mend.pose_lag
    likely = aligned.prefers(apart)
    rest = [finding for finding in found if finding is not late]
    if lag.whole and not apart:
        return replace(lag, poses_too=True), rest
    if apart and likely >= 0.5:
        return Lag(float(apart), apart, min(likely, late.sure)), rest
    if lag.whole or likely < 1 - SURE:
        return lag, found
    either = f"; or depth is {_behind(apart)} colour, and {option(Mend(depth_lag=apart))} is right"
    unsure = replace(late, sure=1 - likely, todo=late.todo + either)
    return lag, [unsure if finding is late else finding for finding in found]


def lag_findings(lag: Lag) -> list[Finding]:
    """Return a finding when depth is late or early."""
    if lag.sure < SURE and not lag.whole:
        return []
    what = f"{'depth and poses are' if lag.poses_too else 'depth is'} {_behind(lag.frames)} colour"
    if not lag.whole:
        todo = "a lag below one frame cannot be mended: move slowly, and click where the camera is slowest"
        return [Finding("depth lag", what, lag.sure, todo)]
    mend = Mend(depth_lag=lag.whole, pose_lag=lag.whole if lag.poses_too else 0)
    todo = option(mend)
    if lag.sure < SURE:
        todo += f"; or the poses are off by as much, and {option(Mend(pose_lag=-lag.whole))} is right"
    return [Finding("depth lag", what, lag.sure, todo, mend)]


def _behind(frames: float) -> str:
    return f"{abs(frames):.1f} frames {'behind' if frames > 0 else 'ahead of'}"


def misregistered(scene: Scene, aligned: Alignment) -> list[Finding]:
    """Return a finding when depth is shifted against colour or has another field of view."""
    sure_of_shift = aligned.sure_of_shift(LEAST_SHIFT * scene.intrinsics.width)
    sure_of_zoom = aligned.sure_of_zoom(LEAST_ZOOM) if aligned.zoom != 1 else 0.0
    sure = max(sure_of_shift, sure_of_zoom)
    if sure < SURE or aligned.shift_contrast < LEAST_CONTRAST:
        return []
    what, zoom = [], 1.0
    shift_px = tuple(np.rint(aligned.shift_px).tolist())
    if sure_of_zoom >= SURE:
        zoom = round(aligned.zoom, 3)
        what.append(f"depth images show things {1 / zoom:.2f} times as large as colour images")
    if np.linalg.norm(shift_px) >= 1:
        what.append(f"colour lies ({shift_px[0]:+.0f}, {shift_px[1]:+.0f}) px from depth")
    mend = Mend(depth_zoom=zoom, depth_shift_px=shift_px)
    focal = ""
    if zoom != 1:
        camera = scene.intrinsics
        focal = f"; if its intrinsics are the depth camera's, {_camera_line(camera, zoom, shift_px)}"
    todo = (
        f"record again with depth registered to colour (`rpl capture` does it), or {option(mend)}, which is "
        f"right at the usual distance to within some pixels{focal}"
    )
    return [Finding("registration", " and ".join(what), sure, todo, mend)]


def _camera_line(camera: Intrinsics, zoom: float, shift_px: tuple[float, float]) -> str:
    """Recipe line with the intrinsics of depth images that were warped to the colour images."""
    cx = zoom * camera.cx + (1 - zoom) * (camera.width - 1) / 2 + shift_px[0]
    cy = zoom * camera.cy + (1 - zoom) * (camera.height - 1) / 2 + shift_px[1]
    return f"also `camera: [{zoom * camera.fx:.1f}, {zoom * camera.fy:.1f}, {cx:.1f}, {cy:.1f}]`"
