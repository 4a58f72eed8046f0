"""Whether a scene shows the print that the others show, or another thing of much the same shape.

Registration brings similar shapes together, right or wrong, and the parts of them that were left out then
agree better, too. Their print does not: where two scenes show the same thing, it is the same, place by place
(correlations of 0.6 to 0.95 on rendered objects), and where they do not, it has nothing in common (0.1 at
most). How plain a surface is decides how alike its print can be at all, so a scene is compared with what the
others have in common; with two scenes there is no such measure, nor where nothing is printed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from rpl_data.geometry import invert
from rpl_data.refine.evidence import Test
from rpl_data.refine.overlap import Pairs
from rpl_data.refine.registration import GATES_M, LEAST_MATCHES
from rpl_data.refine.scene_surfaces import SceneSurface, match, print_differences

ALIKE_SHARE = 0.5
"""A print is another one that correlates less than this share as well as that of the others,"""
DIFFERS_TIMES = 2.0
"""and whose mean square difference is more than so many times theirs: a plain side correlates little, too,
but hardly differs."""


class _Compared(NamedTuple):
    """The print of two scenes on parts that were left out of their registration.

    Attributes:
        correlation: all channels together, each in units of its spread between scenes.
        difference: mean square, in the same units.
    """

    scenes: tuple[int, int]
    correlation: float
    difference: float


def shows_another_print(tests: Sequence[Test], pairs: Pairs, scenes: int) -> Bool[np.ndarray, " s"]:
    """Which scenes show another print than the others have in common; none of fewer than three."""
    compared = [found for test in tests for a, b in pairs if (found := _compared(test, a, b)) is not None]
    return np.array([_another(compared, scene) for scene in range(scenes)], dtype=bool)


def _another(compared: Sequence[_Compared], scene: int) -> bool:
    own = [one for one in compared if scene in one.scenes]
    others = [one for one in compared if scene not in one.scenes]
    if not own or not others:
        return False
    correlation, difference = _medians(own)
    usual_correlation, usual_difference = _medians(others)
    return correlation < ALIKE_SHARE * usual_correlation and difference > DIFFERS_TIMES * usual_difference


def _medians(compared: Sequence[_Compared]) -> tuple[float, float]:
    return (
        float(np.median([one.correlation for one in compared])),
        float(np.median([one.difference for one in compared])),
    )


def _compared(test: Test, a: int, b: int) -> _Compared | None:
    """None where the two share little surface, or have no colours."""
    one, other = test.held_out[a], test.held_out[b]
    if one is None or other is None or not len(test.registration.print_sigmas):
        return None
    poses = test.registration.scene_from_object
    return _compared_at(one, other, poses[b] @ invert(poses[a]), (a, b), test.registration.print_sigmas)


def _compared_at(
    one: SceneSurface,
    other: SceneSurface,
    b_from_a: np.ndarray,
    scenes: tuple[int, int],
    print_sigmas: np.ndarray,
) -> _Compared | None:
    matches = match(one, other, b_from_a, gate_m=GATES_M[-1])
    if len(matches.found) < LEAST_MATCHES:
        return None
    differences = print_differences(one, other, matches) / print_sigmas
    here = one.texture.values[one.asking[matches.asking]] / print_sigmas
    there = here + differences
    here, there = here - here.mean(axis=0), there - there.mean(axis=0)
    spread = float((here.std(axis=0) * there.std(axis=0)).sum())
    together = float((here * there).mean(axis=0).sum())
    return _Compared(scenes, together / max(spread, 1e-12), float((differences**2).mean()))
