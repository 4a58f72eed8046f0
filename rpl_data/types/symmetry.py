"""Symmetries of an object: the motions after which it looks the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True)
class SymmetryAxis:
    """An axis about which every rotation leaves the object looking the same.

    Attributes:
        direction: unit vector along the axis, object frame.
        point_m: a point on the axis, object frame, metres.
    """

    direction: tuple[float, float, float]
    point_m: tuple[float, float, float]


@dataclass(frozen=True)
class Symmetries:
    """What leaves an object looking the same; empty where only standing still does.

    Attributes:
        discrete: rigid transforms of the object frame without the identity, 16 numbers row-major, metres.
        continuous: axes of full rotation.
    """

    discrete: tuple[tuple[float, ...], ...] = ()
    continuous: tuple[SymmetryAxis, ...] = ()


@dataclass(frozen=True)
class Turns:
    """An axis, and how many equal turns about it leave the object looking the same.

    Attributes:
        axis: object frame.
        turns: 2 = after half a turn, 4 = after each quarter; None = after any.
    """

    axis: SymmetryAxis
    turns: int | None


@dataclass(frozen=True)
class FoundAxis:
    """An axis about which the shape of an object is symmetric, and what its print says.

    Attributes:
        axis: object frame.
        turns: of shape and print, as in `Turns`; 1 = the print is different after every turn.
        shape_turns: of the shape alone.
        compared: share of the surface that was seen both before and after the turn.
        off_m: 95th percentile of the distance between the surface before and after, metres.
        print_off: share of the compared surface whose colour differs after the turn that fits best; NaN
            without colours.
        sure: nothing about it is near a limit.
    """

    axis: SymmetryAxis
    turns: int | None
    shape_turns: int | None
    compared: float
    off_m: float
    print_off: float
    sure: bool


@dataclass(frozen=True)
class SymmetryRecord:
    """What was found of an object's symmetry, and what a person confirmed.

    Attributes:
        points_object: the keypoint model whose frame all axes are in; NaN where a keypoint has no position.
        found: axes of the shape; None where nobody has looked.
        seen: share of the dense model's surface that cameras saw; NaN where nobody has looked.
        confirmed: what holds; None where nobody has confirmed anything.
        by: who or what confirmed it.
    """

    points_object: Float64[np.ndarray, "k 3"]
    found: tuple[FoundAxis, ...] | None
    seen: float
    confirmed: tuple[Turns, ...] | None = None
    by: str = ""
