"""Transpositions and wrong names: the clicks were meant for other keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from rpl_data.solve.trial import Explanation, Placements, Trial, undo
from rpl_data.solve.trial_starts import scene_anew, scene_matched

SHARED_VARIANCE = 0.5
"""Share of their variance that clicks of one keypoint and scene have in common (the trajectory, the depth,
the idea of where the corner is), so that three of them are not three witnesses."""

NAME_BONUS = 10.0
"""Another name explains where the click is, a slip does not; so the name may fit a little worse."""

NEAR_PX = 14.0
"""A click this near to another keypoint may have been meant for it."""

FEW_IN_SCENE = 5
"""With at most so many keypoints in a scene, one wrong click may have turned the scene."""


def weighed(gain: float, clicks: int, keypoints: int) -> float:
    """A gain in the unit of independent clicks."""
    return gain / (1 + SHARED_VARIANCE * (clicks / keypoints - 1))


def reread(trial: Trial, explanation: Explanation) -> tuple[Explanation, Trial]:
    """The clicks were meant for other keypoints."""
    undone = undo(trial.reading, explanation)
    again = trial.read(undone, *scene_matched(trial, undone, explanation.scene))
    gain = trial.fit.cost - again.fit.cost
    return replace(
        explanation, gain=weighed(gain, len(explanation.clicks), len(explanation.keypoints))
    ), again


def other_names(trial: Trial, placed: Placements, suspects: Sequence[Explanation]) -> list[Explanation]:
    """The few most promising transpositions and renamings, by where the clicks would then lie."""
    ranked: list[tuple[float, Explanation]] = []
    certain: list[Explanation] = []
    known = sorted({k for _, k in placed})
    strongest = sorted(suspects, key=lambda e: -e.gain)[:3]
    for suspect in strongest:
        (a,) = suspect.keypoints
        others = [_rename(suspect, b) for b in known if b != a]
        for scene in {scene for scene, k in placed if k == a}:
            here = sorted(k for s, k in placed if s == scene)
            few = len(here) <= FEW_IN_SCENE and scene == suspect.scene
            if few:  # where a click in four is wrong, no place can be trusted to rank by
                certain += [_swap(placed, scene, *pair) for pair in combinations(here, 2)]
            others += [_swap(placed, scene, *sorted((a, b))) for b in here if b != a]
        ranked += [_ranked(trial, other) for other in dict.fromkeys(others)]
    best = sorted((r for r in ranked if np.isfinite(r[0])), key=lambda r: r[0])
    return list(dict.fromkeys([*certain, *[e for _, e in best][:5]]))


def _swap(placed: Placements, scene: int, a: int, b: int) -> Explanation:
    clicks = [*placed[scene, a].tolist(), *placed[scene, b].tolist()]
    meant = [b] * len(placed[scene, a]) + [a] * len(placed[scene, b])
    return Explanation("swapped", scene, (a, b), tuple(clicks), tuple(meant))


def _rename(suspect: Explanation, meant: int) -> Explanation:
    return replace(suspect, kind="wrong name", meant=(meant,) * len(suspect.clicks), gain=0.0)


def _ranked(trial: Trial, explanation: Explanation) -> tuple[float, Explanation]:
    """How much nearer the scene's clicks would lie to their keypoints; infinite for no improvement."""
    undone = undo(trial.reading, explanation)
    own = np.flatnonzero(trial.reading.ray_used & (trial.rays.scene == explanation.scene))
    before = trial.miss_px(own, trial.reading.keypoint)
    after = trial.miss_px(own, undone.keypoint)
    changed = np.isin(own, explanation.clicks)
    if after[changed].max() > NEAR_PX:
        for moved, _ in scene_anew(trial, undone, explanation.scene):
            after = trial.miss_px(own, undone.keypoint, moved)
    if np.median(after[changed]) > NEAR_PX:
        return np.inf, explanation
    return float(np.minimum(after / NEAR_PX, 1).sum() - np.minimum(before / NEAR_PX, 1).sum()), explanation
