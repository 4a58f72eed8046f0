"""What a person may have got wrong, as other readings of the same clicks, and which reading fits best.

A wrong click is one that everything else would fit better without. A transposition is a reading in which
two keypoints of a scene change names: it explains two wrong clicks at once and drops nothing, so it is
tried before either of them is called wrong. Readings that are nearly as good are kept as rivals: with two
placements of a keypoint that disagree, nobody can say which of them is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import invert, transform
from rpl_data.solve.click_rays import HAND_SIGMA_PX, Rays
from rpl_data.solve.mirrored_scenes import mirrored_scene
from rpl_data.solve.refit import (
    Reading,
    costs_without,
    read_as_named,
    refit,
    shown_sigma_px,
)
from rpl_data.solve.trial import Clicks, Explanation, Fault, Placements, Trial, undo
from rpl_data.solve.trial_starts import lifted_in_scene, scene_matched
from rpl_data.solve.wrong_names import FEW_IN_SCENE, NAME_BONUS, other_names, reread, weighed

FALSE_ALARM = 0.01
"""How likely it may be that any click of a recording without mistakes is called wrong."""
SUSPICIOUS = 8.0
"""Linearised fall from which clicks are looked at closely."""
SUSPECTS = 6
"""Groups of clicks looked at closely, the most suspicious first."""
RIVAL = 8.0
"""Explanations whose fall is less than this below the best cannot be told from it (odds of 50 to 1)."""
MOST_FAULTS = 8
"""Faults looked for one after another; with more, the clicks as a whole are in doubt."""
SCENE_SHARE = 0.4
"""With this share of its keypoints blamed or far off, a scene as a whole contradicts the others."""
FAR_SIGMAS = 5.0
"""A click this far from its keypoint does not fit, in standard deviations."""
FEW_PLACEMENTS = 3
"""With at most so many other placements of a keypoint, each of them is tried as the wrong one."""

NO_CLICKS: Clicks = np.zeros(0, dtype=np.int64)


def first_trial(
    rays: Rays,
    scene_from_model: Float64[np.ndarray, "s 4 4"],
    points_model: Float64[np.ndarray, "k 3"],
    *,
    hold_points: bool = False,
    go_on: Callable[[], None] = lambda: None,
) -> Trial:
    """Every click taken at its word, in units of the noise that the clicks themselves show.

    A noise below the usual one is not believed: a dozen clicks show it by chance, and good ones stand out.
    """
    reading = read_as_named(rays)
    fit = refit(rays, reading, scene_from_model, points_model, hold_points=hold_points)
    trial = Trial(rays, reading, fit, go_on)
    settled = _settled(trial)
    sigma_px = max(shown_sigma_px(_without_the_worst(settled).fit), HAND_SIGMA_PX)
    return replace(settled, fit=settled.fit._replace(sigma_px=sigma_px)).read(reading)


def _without_the_worst(trial: Trial) -> Trial:
    """Without the most suspicious clicks, which would hide themselves in the noise that they bring.

    So every gain is an externally studentised residual (Cook and Weisberg, section 2.2).
    """
    worst = _suspects(trial, trial.placements())[:1]
    out = np.isin(np.arange(len(trial.rays.scene)), worst)
    return trial.read(Reading(trial.reading.keypoint, ~out, ~out)) if worst else trial


def contradiction(clicks: int) -> float:
    """Fall of the cost from which clicks are called wrong, among so many.

    A clean click's fall is a chi-square with two degrees of freedom, which exceeds x with probability
    exp(-x / 2).
    """
    return 2 * float(np.log(clicks / FALSE_ALARM))


def find_faults(trial: Trial, left_out: Clicks = NO_CLICKS) -> tuple[list[Fault], Trial]:
    """Explain contradictions one after another, the strongest first.

    Args:
        left_out: clicks that the answer does not follow. They are looked at closely however well they fit
            here, where a wrong click may have turned its whole scene.

    Returns:
        The faults, and the fit of the reading in which all of them are undone.
    """
    faults, mended = _explain([], trial, trial, left_out)
    if faults or len(left_out):
        mirrored = mirrored_scene(trial, mended, enough=contradiction(len(trial.rays.scene)), rival=RIVAL)
        if mirrored is not None:
            without = trial.read(undo(trial.reading, mirrored))
            faults, mended = _explain([Fault(mirrored)], trial, without, left_out)
    return [fault for fault in faults if _stands_out(fault.best, mended)], mended


def _explain(faults: list[Fault], first: Trial, trial: Trial, left_out: Clicks) -> tuple[list[Fault], Trial]:
    """Further faults beside those that are undone already."""
    faults = [*faults]
    while len(faults) < MOST_FAULTS:
        found = _best_explanations(trial, left_out)
        enough = contradiction(len(trial.rays.scene))
        explained = next(((e, mended) for e, mended in found if e.gain >= enough), None)
        if explained:
            best, trial = explained
            rivals = (e for e, _ in found if e.gain > best.gain - RIVAL)
            faults.append(Fault(best, tuple(e for e in rivals if not set(e.clicks) & set(best.clicks))))
        scene = _contradicting_scene(faults, first, trial)
        if scene is not None:
            faults, trial = _whole_scene(faults, scene, first)
        elif not explained:
            break
    return faults, trial


def _stands_out(best: Explanation, mended: Trial) -> bool:
    """Clicks that lie where they should once all is mended were blamed for what others did."""
    misses_px = mended.miss_px(np.array(best.clicks))
    return best.kind == "whole scene" or bool(np.median(misses_px) > 2 * mended.fit.sigma_px)


def _settled(trial: Trial) -> Trial:
    """From the best of several starts, so that a scene that was placed wrongly is not taken for a mistake."""
    suspects = _suspects(trial, trial.placements())
    scenes = {int(trial.rays.scene[clicks[0]]) for clicks in suspects}
    starts = [start for scene in sorted(scenes) for start in scene_matched(trial, trial.reading, scene)]
    return trial.read(trial.reading, *starts) if starts else trial


def _contradicting_scene(faults: Sequence[Fault], first: Trial, trial: Trial) -> int | None:
    """The scene in which most keypoints are blamed or still do not fit, when that is a large share."""
    placed = first.placements()
    wrong: dict[int, set[int]] = {}
    for fault in faults:
        wrong.setdefault(fault.best.scene, set()).update(fault.best.keypoints)
    for (scene, keypoint), clicks in trial.placements().items():
        if np.median(trial.miss_px(clicks, trial.reading.keypoint)) > FAR_SIGMAS * trial.fit.sigma_px:
            wrong.setdefault(scene, set()).add(keypoint)
    gone = {fault.best.scene for fault in faults if fault.best.kind == "whole scene"}
    shares = {}
    for scene, keypoints in wrong.items():
        several = sum(fault.best.scene == scene for fault in faults) != 1 or len(keypoints) > 2
        if scene not in gone and several and len(keypoints) > 1:
            shares[scene] = len(keypoints) / sum(s == scene for s, _ in placed)
    worst = max(shares, key=lambda scene: shares[scene], default=None)
    return worst if worst is not None and shares[worst] >= SCENE_SHARE else None


def _whole_scene(faults: Sequence[Fault], scene: int, first: Trial) -> tuple[list[Fault], Trial]:
    """One fault in place of many; what was blamed elsewhere is looked for anew, without the scene."""
    clicks = tuple(np.flatnonzero(first.rays.scene == scene).tolist())
    keypoints = tuple(sorted({int(k) for k in first.reading.keypoint[list(clicks)]}))
    whole = Explanation("whole scene", scene, keypoints, clicks)
    scenes = [fault for fault in faults if fault.best.kind == "whole scene"]
    reading = first.reading
    for fault in scenes:
        reading = undo(reading, fault.best)
    without = first.read(undo(reading, whole))
    gain = first.fit.cost - without.fit.cost
    return [*scenes, Fault(replace(whole, gain=gain))], without


def _best_explanations(trial: Trial, left_out: Clicks) -> list[tuple[Explanation, Trial]]:
    """Explanations that were tried, best first; empty when nothing is suspicious."""
    placed = trial.placements()
    suspects = _suspects(trial, placed)
    known = np.concatenate([NO_CLICKS, *suspects])
    suspects += [np.array([n]) for n in left_out if trial.reading.ray_used[n] and n not in known]
    tried = [_misplaced(trial, clicks) for clicks in suspects]
    if not tried or max(e.gain for e, _ in tried) < contradiction(len(trial.rays.scene)):
        return []
    worst = max(tried, key=lambda t: t[0].gain)[0]
    tried += [_misplaced(trial, clicks, instead_of=worst) for clicks in _others(placed, worst, suspects)]
    tried += [reread(trial, e) for e in other_names(trial, placed, [e for e, _ in tried[: len(suspects)]])]
    return sorted(tried, key=lambda t: -(t[0].gain + NAME_BONUS * bool(t[0].meant)))


def _suspects(trial: Trial, placed: Placements) -> list[Clicks]:
    """Placements, and clicks of those that have several, that the rest would fit much better without."""
    groups = [*placed.values()]
    groups += [np.array([click]) for clicks in placed.values() if len(clicks) > 1 for click in clicks]
    falls = costs_without(trial.fit, groups) - np.array([2.0 * (len(group) - 1) for group in groups])
    return [groups[n] for n in np.argsort(-falls)[:SUSPECTS] if falls[n] > SUSPICIOUS]


def _misplaced(
    trial: Trial, clicks: Clicks, *, instead_of: Explanation | None = None
) -> tuple[Explanation, Trial]:
    """The clicks show another point than all others of their keypoint.

    Their depths count on neither side: a wrong depth is not a wrong click. Several clicks must at least
    agree with one another.
    """
    rays, reading = trial.rays, trial.reading
    scene, keypoint = int(rays.scene[clicks[0]]), int(reading.keypoint[clicks[0]])
    explanation = Explanation("wrong place", scene, (keypoint,), tuple(clicks.tolist()))
    bare = reading._replace(depth_used=reading.depth_used & ~np.isin(np.arange(len(rays.scene)), clicks))
    starts = []
    if instead_of is not None:
        starts += _starts_at(trial, instead_of)
    undone = undo(reading, explanation)
    if sum(s == scene for s, _ in trial.placements()) <= FEW_IN_SCENE:
        starts += scene_matched(trial, undone, scene)
    without = trial.read(undone, *starts)
    gain = trial.read(bare).fit.cost - without.fit.cost - _own_cost(trial, clicks)
    return replace(explanation, gain=weighed(gain, len(clicks), 1)), without


def _own_cost(trial: Trial, clicks: Clicks) -> float:
    """What clicks of one keypoint and scene cost by themselves, with a point of their own."""
    if len(clicks) == 1:
        return 0.0
    rays = trial.rays.of(np.isin(np.arange(len(trial.rays.scene)), clicks))._replace(
        scene=np.zeros(len(clicks), dtype=np.int64), keypoint=np.zeros(len(clicks), dtype=np.int64)
    )
    reading = read_as_named(rays)._replace(depth_used=np.zeros(len(clicks), dtype=bool))
    point = lifted_in_scene(trial, clicks[:1])
    return refit(rays, reading, np.eye(4)[None], point, sigma_px=trial.fit.sigma_px).cost


def _starts_at(trial: Trial, trusted: Explanation) -> list[tuple[np.ndarray, np.ndarray]]:
    """Start with the keypoint where the trusted clicks put it, and with their scene placed by them."""
    click, points = np.array(trusted.clicks[:1]), trial.fit.points_model.copy()
    model_from_scene = invert(trial.fit.scene_from_model[trusted.scene])
    points[trusted.keypoints[0]] = transform(model_from_scene, lifted_in_scene(trial, click))[0]
    return [(trial.fit.scene_from_model, points)]


def _others(placed: Placements, worst: Explanation, tried: Sequence[Clicks]) -> Iterator[Clicks]:
    """Placements that could be wrong instead: of the same keypoint, or in the same scene, where few are."""
    known = {tuple(clicks.tolist()) for clicks in tried}
    (keypoint,) = worst.keypoints
    same_keypoint = [key for key in placed if key[1] == keypoint and key[0] != worst.scene]
    same_scene = [key for key in placed if key[0] == worst.scene and key[1] != keypoint]
    for rivals, most in ((same_keypoint, FEW_PLACEMENTS), (same_scene, FEW_IN_SCENE - 1)):
        if len(rivals) <= most:
            yield from (placed[key] for key in rivals if tuple(placed[key].tolist()) not in known)
