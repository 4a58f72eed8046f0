"""Find the axes about which an object's shape, and its print, are symmetric."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from rpl_data.symmetries import turn
from rpl_data.symmetry.candidates import refined_axis, scanned_axes
from rpl_data.symmetry.evidence import Fit, Matcher
from rpl_data.symmetry.samples import drawn_samples, part_of
from rpl_data.types import FoundAxis, Mesh, PointCloud, SymmetryAxis

TARGET_SAMPLES = 20_000
PROBE_SAMPLES = 2_500
PRIMES = (2, 3, 5)
"""Whoever is symmetric after n equal turns is so after p of them, for each prime p that divides n."""
CANDIDATES = 4
"""An axis is given up for an angle after so many candidates in a row that do not hold."""
MOST_AXES = 16
"""Candidates per angle at most: the icosahedron has 15 axes of half turns, more than any other solid."""
MOST_TURNS = 12
"""A shape with more equal turns is taken for one with any turn."""
ANY_TURN = tuple(2 * math.pi * step / 13 for step in range(1, 7))
"""Angles that no shape of up to `MOST_TURNS` turns fits; those beyond half a turn are their inverses."""
SAME_AXIS_DEG = 10.0
TOLERANCE = 0.015
"""Distance that counts as the same surface, as a part of the diagonal: built objects are that true to
themselves at least (after a true turn, 95 % of their surface is within 0.3 to 1 %)."""
TOLERANCE_NOISE = 3.0
"""The same in units of the mesh's own noise, where that is more: the 95th percentile of the distance between
samples and the surface through the other samples, without any turn."""
MOST_SHAPE_OFF = 0.05
"""Largest share of a symmetric surface that may be farther off: five objects of synthetic recordings have 0
to 1 % after a true turn, a real bowl 4 %, the handle of a cup 12 %."""
MOST_PRINT_OFF = 0.25
"""Largest share of a symmetric surface whose colour may differ: plain built objects have 10 to 18 % from
light and gloss, printed ones 37 to 84 %."""
CLEARLY = 0.5
"""A value below this part of its limit is clearly below it."""
LEAST_COMPARED = 0.3
"""Smallest share of the surface that must have been seen before and after a turn."""
WELL_COMPARED = 0.6


@dataclass(frozen=True)
class Search:
    """What the search works on.

    Attributes:
        matcher: the surface, indexed.
        centre_m: centre of the surface; every axis passes near it.
        diagonal_m: of the box around the surface.
        tolerance_m: distance that counts as the same surface.
        seen: share of the surface that was seen.
    """

    matcher: Matcher
    centre_m: Float64[np.ndarray, "3"]
    diagonal_m: float
    tolerance_m: float
    seen: float

    def fit(self, axis: SymmetryAxis, angle_rad: float) -> Fit:
        """Compare the surface before and after a turn."""
        return self.matcher.fit(turn(axis, angle_rad), tolerance_m=self.tolerance_m)

    def worst_fit(self, axis: SymmetryAxis, turns: int) -> Fit:
        """The worst of equal turns: a small one alone may move a print by less than its own size."""
        fits = [self.fit(axis, 2 * math.pi * step / turns) for step in range(1, turns // 2 + 1)]
        return Fit(
            compared=min(fit.compared for fit in fits),
            off_m=max(fit.off_m for fit in fits),
            shape_off=max(fit.shape_off for fit in fits),
            print_off=max(fit.print_off for fit in fits),
        )


def find_symmetry(mesh: Mesh, seen_surface: PointCloud | None = None) -> tuple[tuple[FoundAxis, ...], float]:
    """Find the axes of an object's shape and how many turns about each its print allows.

    Axes are sought through the middle of the surface in all directions, for two, three and five equal turns;
    the best are moved until the surface fits itself best, and kept where it does so within `TOLERANCE`.

    Args:
        mesh: the dense model, object frame; its colours are the print.
        seen_surface: the points of it that cameras saw; None where all of it is known.

    Returns:
        The axes, those of most turns first, and the share of the surface that was seen.
    """
    search = _search(mesh, seen_surface)
    axes: list[FoundAxis] = []
    for prime in PRIMES:
        for axis in _axes_for(search, prime):
            if all(_apart(axis, other) for other in axes):
                axes.append(_judged(search, axis, prime))
    order = sorted(axes, key=lambda one: -(one.shape_turns or math.inf))
    return _without_needless(order), search.seen


def _search(mesh: Mesh, seen_surface: PointCloud | None) -> Search:
    drawn = drawn_samples(mesh, seen_surface, count=PROBE_SAMPLES + TARGET_SAMPLES, seed=1)
    probe = part_of(drawn, slice(PROBE_SAMPLES))
    target = part_of(drawn, slice(PROBE_SAMPLES, None))
    diagonal_m = float(np.linalg.norm(np.ptp(target.points, axis=0)))
    matcher = Matcher.of(target, probe)
    noise_m = matcher.fit(np.eye(4), tolerance_m=0.0).off_m
    return Search(
        matcher,
        centre_m=target.points.mean(axis=0),
        diagonal_m=diagonal_m,
        tolerance_m=max(TOLERANCE * diagonal_m, TOLERANCE_NOISE * float(np.nan_to_num(noise_m))),
        seen=float(target.seen.mean()),
    )


def _axes_for(search: Search, turns: int) -> list[SymmetryAxis]:
    """Axes about which one of some equal turns brings the shape onto itself."""
    angle = 2 * math.pi / turns
    scanned = scanned_axes(
        search.matcher, search.centre_m, angle, most=MOST_AXES, cap_m=0.05 * search.diagonal_m
    )
    found: list[SymmetryAxis] = []
    missed = 0
    for candidate in scanned:
        axis = refined_axis(search.matcher, candidate, [angle])
        holds = _same_shape(search.fit(axis, angle))
        found += [axis] * holds
        missed = 0 if holds else missed + 1
        if missed == CANDIDATES:
            break
    return found


def _same_shape(fit: Fit) -> bool:
    return fit.compared >= LEAST_COMPARED and fit.shape_off <= MOST_SHAPE_OFF


def _judged(search: Search, axis: SymmetryAxis, turns: int) -> FoundAxis:
    """Say for how many turns about an axis shape and print are the same."""
    if all(_same_shape(search.fit(axis, angle)) for angle in ANY_TURN):
        axis = refined_axis(search.matcher, axis, [ANY_TURN[0], ANY_TURN[2], ANY_TURN[5]])
        any_turn = [search.fit(axis, angle) for angle in ANY_TURN]
        if max(fit.shape_off for fit in any_turn) <= MOST_SHAPE_OFF:
            return _any_turn(search, axis, any_turn)
    shape, fits = _most_turns(search, axis, turns)
    return _printed(axis, shape, fits)


def _printed(axis: SymmetryAxis, shape: int | None, fits: dict[int, Fit]) -> FoundAxis:
    """The most equal turns, of those whose fit is given, that leave the print the same."""
    printed = [n for n, fit in fits.items() if _same_print(fit)]
    best = fits[max(printed)] if printed else min(fits.values(), key=lambda fit: fit.print_off)
    return _found(axis, max(printed, default=1), shape, [best])


def _most_turns(search: Search, axis: SymmetryAxis, least: int) -> tuple[int, dict[int, Fit]]:
    """The most equal turns that the shape allows, and the fit for each divisor of them above 1."""
    counts = range(least, MOST_TURNS + 1, least)
    most = max((n for n in counts if _keeps_shape(search, axis, n)), default=least)
    divisors = [n for n in range(2, most + 1) if most % n == 0]
    return most, {n: search.worst_fit(axis, n) for n in divisors}


def _keeps_shape(search: Search, axis: SymmetryAxis, turns: int) -> bool:
    """Whether each of some equal turns leaves the shape the same; the first that does not ends the search."""
    angles = (2 * math.pi * step / turns for step in range(1, turns // 2 + 1))
    return all(_same_shape(search.fit(axis, angle)) for angle in angles)


def _any_turn(search: Search, axis: SymmetryAxis, fits: list[Fit]) -> FoundAxis:
    """Judge an axis of full rotation; a print may still repeat after some equal turns."""
    worst = max(fits, key=lambda fit: fit.print_off)
    if _same_print(worst):
        return _found(axis, None, None, fits)
    return _printed(axis, None, {n: search.worst_fit(axis, n) for n in range(2, MOST_TURNS + 1)})


def _same_print(fit: Fit) -> bool:
    return math.isnan(fit.print_off) or fit.print_off <= MOST_PRINT_OFF


def _found(axis: SymmetryAxis, turns: int | None, shape: int | None, fits: list[Fit]) -> FoundAxis:
    compared, off_m = min(fit.compared for fit in fits), max(fit.off_m for fit in fits)
    print_off, shape_off = max(fit.print_off for fit in fits), max(fit.shape_off for fit in fits)
    clear = compared >= WELL_COMPARED and shape_off <= CLEARLY * MOST_SHAPE_OFF
    if turns == 1:
        clear = compared >= WELL_COMPARED and print_off >= MOST_PRINT_OFF / CLEARLY
    elif not math.isnan(print_off):
        clear = clear and print_off <= CLEARLY * MOST_PRINT_OFF
    return FoundAxis(axis, turns, shape, compared, off_m, print_off, clear and not math.isnan(print_off))


def _apart(axis: SymmetryAxis, other: FoundAxis) -> bool:
    return _cosine(axis, other.axis) < math.cos(math.radians(SAME_AXIS_DEG))


def _cosine(one: SymmetryAxis, other: SymmetryAxis) -> float:
    return abs(float(np.array(one.direction) @ np.array(other.direction)))


def _without_needless(axes: list[FoundAxis]) -> tuple[FoundAxis, ...]:
    """Drop what follows from an axis of any turn: of the half turns across it, one makes all the others."""
    full = [one for one in axes if one.shape_turns is None]
    if len(full) != 1:
        return tuple(axes)
    across = [one for one in axes if one.shape_turns is not None]
    return (*full, *across[:1])
