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
from jaxtyping import Bool, Float64, Int64

from rpl_data.geometry import Pixels, Points, Transform, from_rotvec, invert, project, transform
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
    for row, pose in enumerate(poses):
        compared, difference = _compare(look, found, *_projected(camera, found, pose), len(BLURS_PX) - 1)
        differences[row, compared] = difference
        seen &= np.bincount(compared, minlength=len(seen)) > 0
    if not seen.any():
        return np.ones_like(differences), seen
    noise = min(_noise(row[seen]) for row in differences)
    squared = (differences / (KERNEL_SCALE_SIGMAS * noise)) ** 2
    return squared / (1 + squared), seen


def likeness(camera: PixelTable, look: Look, found: Print, pose: Transform) -> float:
    """Correlation of a print with the frame at a pose, -1 to 1; NaN where too little of it is seen."""
    points, uv_px = _projected(camera, found, pose)
    seen = look.sees(uv_px, points[:, 2])
    if np.count_nonzero(seen) < FEWEST_POINTS // 2:
        return float("nan")
    here, there = look.at(look.levels[-1][0], uv_px[seen]), found.brightness[-1][seen]
    if min(here.std(), there.std()) < LEAST_SPREAD:
        return float("nan")
    return float(np.corrcoef(here, there)[0, 1])


def print_equations(
    camera: PixelTable,
    look: Look,
    found: Print,
    pose: Transform,
    centre: Float64[np.ndarray, "3"],
    level: int,
) -> tuple[Float64[np.ndarray, "6 6"], Float64[np.ndarray, "6"]]:
    """Information and pull of a print on the pose; the common offset of brightness is eliminated."""
    from rpl_data.label.compiled_prints import print_information

    points, uv_px = _projected(camera, found, pose)
    rows, difference = _compare(look, found, points, uv_px, level)
    _, right, down = look.levels[level]
    lens, robust = (camera.intrinsics.fx, camera.intrinsics.fy), (KERNEL_SCALE_SIGMAS, LEAST_NOISE)
    information, pull = print_information(
        points, uv_px, rows, difference, right, down, look.corner, centre, *lens, *robust
    )
    return INDEPENDENT * information, INDEPENDENT * pull


def _projected(camera: PixelTable, found: Print, pose: Transform) -> tuple[Points, Pixels]:
    """A print's points in the camera frame, and their pixels."""
    from rpl_data.label.compiled_prints import projected

    seen_by = camera.intrinsics
    if seen_by.distortion:
        points = transform(pose, found.points)
        return points, project(seen_by, points)
    moved: tuple[Points, Pixels] = projected(
        pose, found.points, seen_by.fx, seen_by.fy, seen_by.cx, seen_by.cy
    )
    return moved


def _compare(
    look: Look, found: Print, points_camera: Points, uv_px: Pixels, level: int
) -> tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Which points of a print are compared with a frame, and by how much the brightness of each differs."""
    from rpl_data.label.compiled_prints import compare

    seen = look.sees(uv_px, points_camera[:, 2])
    grey, there = look.levels[level][0], np.ascontiguousarray(found.brightness[level])
    compared: tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]] = compare(
        uv_px, there, grey, look.corner, seen, FEWEST_POINTS // 2, LEAST_SPREAD, MOST_GAIN
    )
    return compared


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
