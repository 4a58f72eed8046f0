"""Whether a registration is believed: parts of the surfaces it was not fitted to, and the clicks.

Registration always brings together what it is fitted to, right or wrong. So it is done twice, each time on
every other block of the object, and judged on the blocks in between: there the scenes must agree better than
at the solution of the clicks, by more than chance, and the clicks must not be contradicted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.stats import chi2

from rpl_data.geometry import invert, transform
from rpl_data.held_out import are_black, block_means, blocks_of, in_standard_errors
from rpl_data.refine.overlap import Pairs, all_pairs
from rpl_data.refine.registration import ClickTerms, Points, Poses, Registration, register_scenes
from rpl_data.refine.scene_surfaces import SceneSurface, match, print_differences

BLOCK_M = 0.03
"""Edge of the blocks that are fitted to or held out, as a chessboard in the object frame."""
GATE_M = 0.012
"""A held-out point without a counterpart this near disagrees wholly."""
GAIN_SIGMAS = 1.64
"""Least improvement over the held-out blocks, in standard errors: 95 % sure of its sign."""
CLICK_LIMIT = float(chi2.ppf(0.999, df=6))
"""The clicks of a scene fit their own solution best. The true pose costs them more by a chi-squared number
with six degrees of freedom; one time in a thousand by more than this."""

ANOTHER_PRINT = (
    "its surface shows another print than the other scenes have in common, so it may be another thing of "
    "much the same shape"
)

ClickCosts = Callable[[Poses, Points], Float64[np.ndarray, " s"]]
"""``costs(scene_from_object, points_object)`` -> the robust cost of the clicks per scene."""


@dataclass(frozen=True)
class Verdict:
    """What held-out evidence says of one scene.

    Attributes:
        accepted: the registered pose is better than that of the clicks.
        gain_sigmas: how much better the held-out blocks agree with the other scenes, in standard errors.
        click_cost: by how much the clicks of the scene fit worse, in squared standard deviations.
        reason: why not, for a person; empty when accepted.
    """

    accepted: bool
    gain_sigmas: float
    click_cost: float
    reason: str = ""


class Test(NamedTuple):
    """A registration of some blocks, and the surfaces of which the other blocks ask."""

    registration: Registration
    held_out: list[SceneSurface | None]


def cross_validated(
    surfaces: Sequence[SceneSurface | None],
    start: Poses,
    points: Points,
    clicks: ClickTerms,
    *,
    pairs: Pairs | None = None,
) -> list[Test]:
    """Register twice, each time without the blocks of one colour of the chessboard."""
    colours = [
        None if s is None else are_black(_blocks(s, pose)) for s, pose in zip(surfaces, start, strict=True)
    ]
    tests = []
    for black in (True, False):
        fitted, held_out = [
            [
                None if s is None or c is None else s.asked_by(c == side)
                for s, c in zip(surfaces, colours, strict=True)
            ]
            for side in (black, not black)
        ]
        tests.append(Test(register_scenes(fitted, start, points, clicks, pairs=pairs), held_out))
    return tests


def _blocks(surface: SceneSurface, scene_from_object: np.ndarray) -> Int64[np.ndarray, "q 3"]:
    """The block of the object frame that each asking point lies in."""
    in_object = transform(invert(scene_from_object), surface.cloud.points[surface.asking])
    return blocks_of(in_object, edge_m=BLOCK_M)


def gains_sigmas(
    tests: Sequence[Test], start: Poses, *, pairs: Pairs | None = None
) -> Float64[np.ndarray, " s"]:
    """Per scene, how much better its held-out blocks agree than at the start, in standard errors.

    0 for scenes that share no held-out surface with another one.

    Args:
        pairs: the scenes that are compared; every one with every other one when None.
    """
    scenes, blocks, gains = [], [], []
    for number, (found, held_out) in enumerate(tests):
        for a, b in all_pairs(held_out) if pairs is None else pairs:
            one, other = held_out[a], held_out[b]
            if one is None or other is None:
                continue
            before, seen_before = disagreement(one, other, start[b] @ invert(start[a]), found)
            poses = found.scene_from_object
            after, seen_after = disagreement(one, other, poses[b] @ invert(poses[a]), found)
            either = seen_before | seen_after
            block = _blocks(one, start[a])[either]
            for scene in (a, b):
                scenes.append(np.full(len(block), scene))
                blocks.append(np.column_stack([block, np.full(len(block), number)]))
                gains.append((before - after)[either])
    result = np.zeros(len(start))
    if scenes:
        scene_of, block_of, gain = np.concatenate(scenes), np.concatenate(blocks), np.concatenate(gains)
        for scene in range(len(start)):
            own = scene_of == scene
            result[scene] = in_standard_errors(block_means(block_of[own], gain[own]))
    return result


def disagreement(
    one: SceneSurface, other: SceneSurface, b_from_a: np.ndarray, found: Registration
) -> tuple[Float64[np.ndarray, " q"], Bool[np.ndarray, " q"]]:
    """How much a surface disagrees with another one at each of its asking points, in depth and print.

    Returns:
        From 0 to 1 per asking point, 1 where there is no counterpart; and whether there is one.
    """
    matches = match(one, other, b_from_a, gate_m=GATE_M)
    normed = [matches.distance_m / found.surface_sigma_m]
    if len(found.print_sigmas):
        normed += list((print_differences(one, other, matches) / found.print_sigmas).T)
    squared = np.square(np.column_stack(normed)) / 9
    disagrees, seen = np.ones(len(one.asking)), np.zeros(len(one.asking), bool)
    disagrees[matches.asking] = (squared / (1 + squared)).mean(axis=1)
    seen[matches.asking] = True
    return disagrees, seen


def verdicts(
    gains: Float64[np.ndarray, " s"],
    click_costs: Float64[np.ndarray, " s"],
    *,
    compared_with: str = "the other scenes",
    another_print: Bool[np.ndarray, " s"] | None = None,
) -> list[Verdict]:
    """One per scene; the clicks' own solution is kept where one of the two witnesses is against.

    Args:
        compared_with: what the surfaces are compared with, in words.
        another_print: per scene, whether it shows another print than the others (`same_print`).
    """
    judged = [
        Verdict(not (why := _why_not(gain, cost, compared_with)), float(gain), float(cost), why)
        for gain, cost in zip(gains, click_costs, strict=True)
    ]
    for scene in () if another_print is None else np.flatnonzero(another_print):
        judged[scene] = replace(judged[scene], accepted=False, reason=judged[scene].reason or ANOTHER_PRINT)
    return judged


def without_surface(compared_with: str = "another scene") -> Verdict:
    """Of a scene that has nothing to be registered with."""
    return Verdict(False, 0.0, 0.0, f"it shares no surface of the object with {compared_with}")


def left_alone() -> Verdict:
    """Of a scene when all that it could be registered with were turned down."""
    reason = (
        "every other scene that shows the object's surface was turned down, so it has nothing to agree with"
    )
    return Verdict(False, 0.0, 0.0, reason)


def _why_not(gain_sigmas: float, click_cost: float, compared_with: str) -> str:
    if gain_sigmas < GAIN_SIGMAS:
        return (
            "the parts of its surface that were left out of the registration do not agree better with "
            f"{compared_with} ({gain_sigmas:.1f} standard errors, at least {GAIN_SIGMAS} are needed)"
        )
    if click_cost > CLICK_LIMIT:
        return (
            "its clicks would fit much worse than chance explains "
            f"(their cost rises by {click_cost:.0f}, at most {CLICK_LIMIT:.0f} is believed)"
        )
    return ""
