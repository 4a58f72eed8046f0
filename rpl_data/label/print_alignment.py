"""Align a label with its frame by the object's print: the print of other frames is laid over this one.

Points of the print, moved by the label's pose, are projected into the frame; their brightness there should be
what it was (Lucas and Kanade, IJCAI 1981; Baker and Matthews, IJCV 2004, with the surface known). Up to a
gain and an offset per pair of frames, since light and exposure differ. A prior keeps the pose near the
trajectory's where the print says little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.geometry import Transform, from_rotvec, invert, project, transform
from rpl_data.label.outline import image_motion
from rpl_data.label.prints import BLURS_PX, FEWEST_POINTS, Look, Print
from rpl_data.raycast import PixelTable

ITERATIONS, CONVERGED = 5, 2e-4
"""Gauss-Newton steps per blur: at most so many, and none after one smaller than that (radians, metres)."""
INDEPENDENT = 0.1
"""Errors of neighbouring points are correlated, so each counts as this share of an independent one."""
KERNEL_SCALE_SIGMAS = 3.0
"""Scale of Geman-McClure's robust loss, in standard deviations."""
LEAST_NOISE, LEAST_SPREAD = 2.0, 2.0
"""Grey levels: residuals are never taken to be less noisy, and a print of less spread is none."""
MOST_GAIN = 2.0
"""Largest change of contrast between two frames."""


@dataclass(frozen=True)
class Prior:
    """What is known of the pose before the print is looked at.

    Attributes:
        camera_from_object: the trajectory's pose.
        turn_rad, shift_m: standard deviation per axis, of a turn about the object's middle and of a shift.
    """

    camera_from_object: Transform
    turn_rad: float
    shift_m: float


def align_print(
    camera: PixelTable, look: Look, prints: Sequence[Print], middle: Float64[np.ndarray, "3"], prior: Prior
) -> Transform:
    """The pose `camera_from_object` at which the prints and the prior fit the frame best.

    Args:
        middle: point of the object that turns are about, object frame.
    """
    pose = prior.camera_from_object
    known = np.diag([prior.turn_rad**-2] * 3 + [prior.shift_m**-2] * 3)
    for level in range(len(BLURS_PX)):
        for _ in range(ITERATIONS):
            centre = transform(pose, middle)
            information, pull = known.copy(), known @ step_between(pose, prior.camera_from_object, centre)
            for each in prints:
                of_print = print_equations(camera, look, each, pose, centre, level)
                information, pull = information + of_print[0], pull + of_print[1]
            step = np.linalg.solve(information, pull)
            pose = stepped(pose, step, centre)
            if np.abs(step).max() < CONVERGED:
                break
    return pose


def disagreements(
    camera: PixelTable, look: Look, found: Print, poses: Sequence[Transform]
) -> tuple[Float64[np.ndarray, "p n"], Bool[np.ndarray, " n"]]:
    """How much each point of a print disagrees with the frame at each of some poses, 0 to 1.

    Returns:
        And which points are seen at all of the poses: the others count for nothing.
    """
    seen = np.ones(len(found.points), bool)
    differences = np.zeros((len(poses), len(found.points)))
    compared = [_compare(camera, look, found, pose, len(BLURS_PX) - 1) for pose in poses]
    for row, one in enumerate(compared):
        seen &= one.seen
        differences[row] = one.difference
    if not seen.any():
        return np.ones_like(differences), seen
    noise = min(_noise(row[seen]) for row in differences)
    squared = (differences / (KERNEL_SCALE_SIGMAS * noise)) ** 2
    return squared / (1 + squared), seen


def likeness(camera: PixelTable, look: Look, found: Print, pose: Transform) -> float:
    """Correlation of a print with the frame at a pose, -1 to 1; NaN where too little of it is seen."""
    points = transform(pose, found.points)
    uv_px = project(camera.intrinsics, points)
    seen = look.sees(uv_px, points[:, 2])
    if np.count_nonzero(seen) < FEWEST_POINTS // 2:
        return float("nan")
    here, there = look.at(look.levels[-1][0], uv_px[seen]), found.brightness[-1][seen]
    if min(here.std(), there.std()) < LEAST_SPREAD:
        return float("nan")
    return float(np.corrcoef(here, there)[0, 1])


@dataclass(frozen=True)
class _Compared:
    """A print beside a frame: its points there, where they project, and how much brightness differs."""

    points_camera: Float64[np.ndarray, "n 3"]
    uv_px: Float64[np.ndarray, "n 2"]
    seen: Bool[np.ndarray, " n"]
    difference: Float64[np.ndarray, " n"]


def _compare(camera: PixelTable, look: Look, found: Print, pose: Transform, level: int) -> _Compared:
    points = transform(pose, found.points)
    uv_px = project(camera.intrinsics, points)
    seen = look.sees(uv_px, points[:, 2])
    difference = np.zeros(len(points))
    if np.count_nonzero(seen) >= FEWEST_POINTS // 2:
        here, there = look.at(look.levels[level][0], uv_px[seen]), found.brightness[level][seen]
        here, there = here - np.median(here), there - np.median(there)
        if min(here.std(), there.std()) < LEAST_SPREAD:
            seen = np.zeros_like(seen)
        else:
            gain = np.median(np.abs(here)) / max(float(np.median(np.abs(there))), 1e-3)
            difference[seen] = np.clip(gain, 1 / MOST_GAIN, MOST_GAIN) * there - here
    else:
        seen = np.zeros_like(seen)
    return _Compared(points, uv_px, seen, difference)


def print_equations(
    camera: PixelTable,
    look: Look,
    found: Print,
    pose: Transform,
    centre: Float64[np.ndarray, "3"],
    level: int,
) -> tuple[Float64[np.ndarray, "6 6"], Float64[np.ndarray, "6"]]:
    """Information and pull of a print on the pose; the common offset of brightness is eliminated."""
    compared = _compare(camera, look, found, pose, level)
    seen = compared.seen
    if not seen.any():
        return np.zeros((6, 6)), np.zeros(6)
    difference, uv_px = compared.difference[seen], compared.uv_px[seen]
    _, right, down = look.levels[level]
    slopes = np.column_stack([look.at(right, uv_px), look.at(down, uv_px)])
    motion = image_motion(camera, compared.points_camera[seen], centre)
    rows = np.einsum("ni,nij->nj", slopes, motion)
    noise = _noise(difference)
    weight = 1 / (1 + (difference / (KERNEL_SCALE_SIGMAS * noise)) ** 2) ** 2 / noise**2
    weighted = rows * weight[:, None]
    common = weighted.sum(axis=0) / weight.sum()
    information = weighted.T @ rows - weight.sum() * np.outer(common, common)
    pull = weighted.T @ difference - common * float(weight @ difference)
    return INDEPENDENT * information, INDEPENDENT * pull


def _noise(difference: Float64[np.ndarray, " n"]) -> float:
    return max(1.4826 * float(np.median(np.abs(difference))), LEAST_NOISE)


def stepped(pose: Transform, step: Float64[np.ndarray, "6"], centre: Float64[np.ndarray, "3"]) -> Transform:
    """The pose after a turn about the centre and a shift, along the axes of the camera."""
    turn = from_rotvec(step[:3], np.zeros(3))
    turn[:3, 3] = centre + step[3:] - turn[:3, :3] @ centre
    stepped: Transform = turn @ pose
    return stepped


def step_between(a: Transform, b: Transform, centre: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "6"]:
    """The turn about the centre and the shift that take pose a to pose b, along the axes they lead to."""
    change = b @ invert(a)
    turn = cv2.Rodrigues(change[:3, :3])[0].ravel()
    return np.concatenate([turn, transform(change, centre) - centre])
