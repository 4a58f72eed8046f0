"""Symmetries of an object: the motions after which it looks the same."""

from __future__ import annotations

from dataclasses import dataclass


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
