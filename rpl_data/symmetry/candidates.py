"""Axes about which an object may be symmetric: where turns bring its surface best onto itself."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Points
from rpl_data.symmetries import turn
from rpl_data.symmetry.evidence import Matcher
from rpl_data.types import SymmetryAxis

DIRECTIONS = 350
"""Directions of axes that are tried, over half a sphere: 7 degrees apart."""
COARSE_SAMPLES = 250
FINE_SAMPLES = 1000
FEWEST_POINTS = 20
"""An axis is not moved by fewer."""
APART_DEG = 15.0
"""Candidates nearer to a better one are the same axis."""


def scanned_axes(
    matcher: Matcher, centre_m: Float64[np.ndarray, "3"], angle_rad: float, *, most: int, cap_m: float
) -> list[SymmetryAxis]:
    """Axes through a point about which a turn by an angle fits best, the best first.

    Args:
        centre_m: the point, object frame.
        most: how many at most.
        cap_m: a point farther off counts as this far.
    """
    directions = half_sphere(DIRECTIONS)
    axes = [SymmetryAxis(_three(direction), _three(centre_m)) for direction in directions]
    costs = np.array(
        [
            matcher.coarse_distance_m(turn(axis, angle_rad), probes=COARSE_SAMPLES, cap_m=cap_m)
            for axis in axes
        ]
    )
    chosen: list[int] = []
    for row in np.argsort(costs):
        if len(chosen) < most and all(not _close(directions[row], directions[other]) for other in chosen):
            chosen.append(int(row))
    return [axes[row] for row in chosen]


def _close(one: Float64[np.ndarray, "3"], other: Float64[np.ndarray, "3"]) -> bool:
    return abs(float(one @ other)) > math.cos(math.radians(APART_DEG))


def refined_axis(
    matcher: Matcher, axis: SymmetryAxis, angles_rad: list[float], *, steps: int = 12
) -> SymmetryAxis:
    """Move an axis so that turns by these angles bring the surface onto itself as well as they can.

    Gauss-Newton on the distances to the partners' planes over the direction and the place of the axis (four
    numbers), with Cauchy weights whose scale is the median distance.
    """
    for _ in range(steps):
        rows, values = zip(*(_linearised(matcher, axis, angle) for angle in angles_rad), strict=True)
        jacobian, residual = np.concatenate(rows), np.concatenate(values)
        if len(residual) < FEWEST_POINTS:  # nothing was seen both before and after the turn
            return axis
        weight = 1 / (1 + (residual / (2 * np.median(np.abs(residual)) + 1e-5)) ** 2)
        normal = jacobian.T @ (jacobian * weight[:, None])
        damped = normal + np.diag(1e-6 * np.trace(normal) / 4 + 1e-3 * np.diag(normal))
        change = -np.linalg.solve(damped, jacobian.T @ (residual * weight))
        axis = _nudged(axis, np.clip(change, -0.1, 0.1))
        if np.abs(change).max() < 1e-5:
            break
    return axis


LEVER_M = 0.05
"""A direction changes by this length per unit of its parameter, so that all four are lengths."""


def _linearised(
    matcher: Matcher, axis: SymmetryAxis, angle_rad: float
) -> tuple[Float64[np.ndarray, "n 4"], Float64[np.ndarray, " n"]]:
    """Distances of the moved points to their partners' planes, and their derivatives."""
    rows = slice(FINE_SAMPLES)
    motion = turn(axis, angle_rad)
    points, _, partners = matcher.partners(motion, rows)
    to, normals = matcher.target.points[partners], matcher.target.normals[partners]
    usable = matcher.probe.seen[rows] & matcher.target.seen[partners]
    residual = ((points - to) * normals).sum(axis=1)
    columns = []
    for number in range(4):
        step = 1e-4 * np.eye(4)[number]
        moved = turn(_nudged(axis, step), angle_rad)
        there = matcher.probe.points[rows] @ moved[:3, :3].T + moved[:3, 3]
        columns.append(((there - points) * normals).sum(axis=1) / 1e-4)
    return np.stack(columns, axis=1)[usable], residual[usable]


def _nudged(axis: SymmetryAxis, change_m: Float64[np.ndarray, "4"]) -> SymmetryAxis:
    """Tilt an axis about its point by two lengths at `LEVER_M`, and move it sideways by two."""
    direction = np.array(axis.direction)
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    tilted = direction + (change_m[0] * first + change_m[1] * second) / LEVER_M
    point = np.array(axis.point_m) + change_m[2] * first + change_m[3] * second
    return SymmetryAxis(_three(tilted / np.linalg.norm(tilted)), _three(point))


def half_sphere(count: int) -> Points:
    """Directions spread evenly over half a sphere (a Fibonacci lattice), and the three coordinate axes."""
    number = np.arange(count)
    z = (number + 0.5) / count
    around = number * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - z * z)
    return np.concatenate([np.column_stack([ring * np.cos(around), ring * np.sin(around), z]), np.eye(3)])


def _three(values: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
