"""What a person may have got wrong, as other readings of the same clicks, and which reading fits best.

A wrong click is one that everything else would fit better without. A transposition is a reading in which
two keypoints of a scene change names: it explains two wrong clicks at once and drops nothing, so it is
tried before either of them is called wrong. Readings that are nearly as good are kept as rivals: with two
placements of a keypoint that disagree, nobody can say which of them is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import invert, transform
from rpl_data.solve.click_rays import NEAREST_DEPTH_M, Rays
from rpl_data.solve.initial_guess import match
from rpl_data.solve.procrustes import kabsch_stack
from rpl_data.solve.refit import (
    Fit,
    Reading,
    costs_without,
    read_as_named,
    refit,
    shown_sigma_px,
)

Kind = Literal["wrong place", "swapped", "wrong name", "whole scene"]
Clicks = Int64[np.ndarray, " _"]
"""Numbers of clicks, in the order of the observations."""
Placements = Mapping[tuple[int, int], Clicks]
"""By (scene, keypoint), all clicks that place one keypoint in one scene."""

FALSE_ALARM = 0.01
"""How likely it may be that any click of a recording without mistakes is called wrong."""
SHARED_VARIANCE = 0.5
"""Share of their variance that clicks of one keypoint and scene have in common (the trajectory, the depth,
the idea of where the corner is), so that three of them are not three witnesses."""
SUSPICIOUS = 8.0
"""Linearised fall from which clicks are looked at closely."""
SUSPECTS = 6
"""Groups of clicks looked at closely, the most suspicious first."""
RIVAL = 8.0
"""Explanations whose fall is less than this below the best cannot be told from it (odds of 50 to 1)."""
NAME_BONUS = 10.0
"""Another name explains where the click is, a slip does not; so the name may fit a little worse."""
NEAR_PX = 14.0
"""A click this near to another keypoint may have been meant for it."""
MOST_FAULTS = 8
"""Faults looked for one after another; with more, the clicks as a whole are in doubt."""
SCENE_SHARE = 0.4
"""With this share of its keypoints blamed or far off, a scene as a whole contradicts the others."""
FAR_SIGMAS = 5.0
"""A click this far from its keypoint does not fit, in standard deviations."""
FEW_PLACEMENTS = 3
"""With at most so many other placements of a keypoint, each of them is tried as the wrong one."""
FEW_IN_SCENE = 5
"""With at most so many keypoints in a scene, one wrong click may have turned the scene."""


@dataclass(frozen=True)
class Explanation:
    """One mistake of a person, and how much better everything fits when it is undone.

    Attributes:
        clicks: the wrong clicks.
        meant: for `swapped` and `wrong name`, the keypoint that each of them was meant for.
        gain: fall of the cost when it is undone.
    """

    kind: Kind
    scene: int
    keypoints: tuple[int, ...]
    clicks: tuple[int, ...]
    meant: tuple[int, ...] = ()
    gain: float = 0.0


@dataclass(frozen=True)
class Fault:
    """The best explanation of a contradiction, and the others that explain it about as well."""

    best: Explanation
    rivals: tuple[Explanation, ...] = ()


@dataclass(frozen=True)
class Trial:
    """A reading of the clicks and its fit."""

    rays: Rays
    reading: Reading
    fit: Fit

    def placements(self) -> dict[tuple[int, int], Clicks]:
        """The clicks in use by scene and keypoint."""
        found: dict[tuple[int, int], list[int]] = {}
        for click in np.flatnonzero(self.reading.ray_used):
            key = int(self.rays.scene[click]), int(self.reading.keypoint[click])
            found.setdefault(key, []).append(int(click))
        return {key: np.array(clicks) for key, clicks in found.items()}

    def miss_px(
        self,
        clicks: Clicks,
        keypoint: Clicks | None = None,
        scene_from_model: Float64[np.ndarray, "s 4 4"] | None = None,
    ) -> Float64[np.ndarray, " _"]:
        """Distance of clicks from the keypoints they are named for, or from others, in pixels."""
        rays = self.rays
        poses = self.fit.scene_from_model if scene_from_model is None else scene_from_model
        named = rays.keypoint if keypoint is None else keypoint
        to_camera = rays.camera_from_scene[clicks] @ poses[rays.scene[clicks]]
        points = self.fit.points_model[named[clicks]]
        in_camera = np.einsum("mij,mj->mi", to_camera[:, :3, :3], points) + to_camera[:, :3, 3]
        xy = in_camera[:, :2] / np.maximum(in_camera[:, 2:], NEAREST_DEPTH_M)
        missed: Float64[np.ndarray, " _"] = (
            np.linalg.norm(xy - rays.xy[clicks], axis=1) / rays.pixel_rad[clicks]
        )
        return missed

    def read(self, reading: Reading, *starts: tuple[np.ndarray, np.ndarray]) -> Trial:
        """The fit of another reading: the best one from here and from the other starts."""
        here = (self.fit.scene_from_model, self.fit.points_model)
        fits = [
            refit(self.rays, reading, *start, sigma_px=self.fit.sigma_px, hold_points=self.fit.hold_points)
            for start in (here, *starts)
        ]
        return Trial(self.rays, reading, min(fits, key=lambda fit: fit.cost))


def first_trial(
    rays: Rays,
    scene_from_model: Float64[np.ndarray, "s 4 4"],
    points_model: Float64[np.ndarray, "k 3"],
    *,
    hold_points: bool = False,
) -> Trial:
    """Every click taken at its word, in units of the noise that the clicks themselves show."""
    reading = read_as_named(rays)
    trial = Trial(
        rays, reading, refit(rays, reading, scene_from_model, points_model, hold_points=hold_points)
    )
    settled = _settled(trial)
    sigma_px = shown_sigma_px(settled.fit)
    return replace(settled, fit=settled.fit._replace(sigma_px=sigma_px)).read(reading)


def _weighed(gain: float, clicks: int, keypoints: int) -> float:
    """A gain in the unit of independent clicks."""
    return gain / (1 + SHARED_VARIANCE * (clicks / keypoints - 1))


def contradiction(clicks: int) -> float:
    """Fall of the cost from which clicks are called wrong, among so many.

    A clean click's fall is a chi-square with two degrees of freedom, which exceeds x with probability
    exp(-x / 2).
    """
    return 2 * float(np.log(clicks / FALSE_ALARM))


def find_faults(trial: Trial) -> tuple[list[Fault], Trial]:
    """Explain contradictions one after another, the strongest first.

    Returns:
        The faults, and the fit of the reading in which all of them are undone.
    """
    faults: list[Fault] = []
    first = trial
    while len(faults) < MOST_FAULTS:
        found = _best_explanations(trial)
        explained = bool(found) and found[0][0].gain >= contradiction(len(trial.rays.scene))
        if explained:
            best, trial = found[0]
            rivals = (e for e, _ in found[1:] if e.gain > best.gain - RIVAL)
            faults.append(Fault(best, tuple(e for e in rivals if not set(e.clicks) & set(best.clicks))))
        scene = _contradicting_scene(faults, first, trial)
        if scene is not None:
            faults, trial = _whole_scene(faults, scene, first)
        elif not explained:
            break
    return [fault for fault in faults if _stands_out(fault.best, trial)], trial


def _stands_out(best: Explanation, mended: Trial) -> bool:
    """Clicks that lie where they should once all is mended were blamed for what others did."""
    misses_px = mended.miss_px(np.array(best.clicks))
    return best.kind == "whole scene" or bool(np.median(misses_px) > 2 * mended.fit.sigma_px)


def _settled(trial: Trial) -> Trial:
    """From the best of several starts, so that a scene that was placed wrongly is not taken for a mistake."""
    suspects = _suspects(trial, trial.placements())
    scenes = {int(trial.rays.scene[clicks[0]]) for clicks in suspects}
    starts = [start for scene in sorted(scenes) for start in _scene_matched(trial, trial.reading, scene)]
    return trial.read(trial.reading, *starts) if starts else trial


def undo(reading: Reading, explanation: Explanation) -> Reading:
    """The reading without the mistake."""
    keypoint, ray, depth = (column.copy() for column in reading)
    clicks = list(explanation.clicks)
    if explanation.meant:
        keypoint[clicks] = explanation.meant
    else:
        ray[clicks] = depth[clicks] = False
    return Reading(keypoint, ray, depth)


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


def _best_explanations(trial: Trial) -> list[tuple[Explanation, Trial]]:
    """Explanations that were tried, best first; empty when nothing is suspicious."""
    placed = trial.placements()
    suspects = _suspects(trial, placed)
    tried = [_misplaced(trial, clicks) for clicks in suspects]
    if not tried or max(e.gain for e, _ in tried) < contradiction(len(trial.rays.scene)):
        return []
    worst = max(tried, key=lambda t: t[0].gain)[0]
    tried += [_misplaced(trial, clicks, instead_of=worst) for clicks in _others(placed, worst, suspects)]
    tried += [_reread(trial, e) for e in _other_names(trial, placed, [e for e, _ in tried[: len(suspects)]])]
    return sorted(tried, key=lambda t: -(t[0].gain + NAME_BONUS * bool(t[0].meant)))


def _suspects(trial: Trial, placed: Placements) -> list[Clicks]:
    """Placements, and clicks of those that have several, that the rest would fit much better without."""
    groups = [*placed.values()]
    groups += [np.array([click]) for clicks in placed.values() if len(clicks) > 1 for click in clicks]
    falls = costs_without(trial.fit, groups) - np.array([2.0 * (len(group) - 1) for group in groups])
    return [groups[n] for n in np.argsort(-falls)[:SUSPECTS] if falls[n] > SUSPICIOUS]


# Wrong places -------------------------------------------------------------------------------------


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
        starts += _scene_matched(trial, undone, scene)
    without = trial.read(undone, *starts)
    gain = trial.read(bare).fit.cost - without.fit.cost - _own_cost(trial, clicks)
    return replace(explanation, gain=_weighed(gain, len(clicks), 1)), without


def _own_cost(trial: Trial, clicks: Clicks) -> float:
    """What clicks of one keypoint and scene cost by themselves, with a point of their own."""
    if len(clicks) == 1:
        return 0.0
    rays = trial.rays.of(np.isin(np.arange(len(trial.rays.scene)), clicks))._replace(
        scene=np.zeros(len(clicks), dtype=np.int64), keypoint=np.zeros(len(clicks), dtype=np.int64)
    )
    reading = read_as_named(rays)._replace(depth_used=np.zeros(len(clicks), dtype=bool))
    point = _lifted_scene(trial, int(clicks[0]))[None]
    return refit(rays, reading, np.eye(4)[None], point, sigma_px=trial.fit.sigma_px).cost


def _starts_at(trial: Trial, trusted: Explanation) -> list[tuple[np.ndarray, np.ndarray]]:
    """Start with the keypoint where the trusted clicks put it, and with their scene placed by them."""
    click, points = trusted.clicks[0], trial.fit.points_model.copy()
    model_from_scene = invert(trial.fit.scene_from_model[trusted.scene])
    points[trusted.keypoints[0]] = transform(model_from_scene, _lifted_scene(trial, click))
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


# Wrong names --------------------------------------------------------------------------------------


def _reread(trial: Trial, explanation: Explanation) -> tuple[Explanation, Trial]:
    """The clicks were meant for other keypoints."""
    undone = undo(trial.reading, explanation)
    reread = trial.read(undone, *_scene_matched(trial, undone, explanation.scene))
    gain = trial.fit.cost - reread.fit.cost
    return replace(
        explanation, gain=_weighed(gain, len(explanation.clicks), len(explanation.keypoints))
    ), reread


def _other_names(trial: Trial, placed: Placements, suspects: Sequence[Explanation]) -> list[Explanation]:
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
        for moved, _ in _scene_anew(trial, undone, explanation.scene):
            after = trial.miss_px(own, undone.keypoint, moved)
    if np.median(after[changed]) > NEAR_PX:
        return np.inf, explanation
    return float(np.minimum(after / NEAR_PX, 1).sum() - np.minimum(before / NEAR_PX, 1).sum()), explanation


# Starts -------------------------------------------------------------------------------------------


def _scene_anew(trial: Trial, reading: Reading, scene: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """A start with one scene fitted to the model by the nearest depths of its clicks (robust Kabsch).

    Empty when fewer than three of its keypoints have a depth.
    """
    rays, fit = trial.rays, trial.fit
    own = np.flatnonzero(reading.ray_used & (rays.scene == scene) & np.isfinite(rays.depths_m[:, 0]))
    if len(np.unique(reading.keypoint[own])) < 3:
        return []
    lifted = np.array([_lifted_scene(trial, int(click)) for click in own])[None]
    model = fit.points_model[reading.keypoint[own]][None]
    weights = np.ones((1, len(own)))
    for _ in range(4):
        placed = kabsch_stack(model, lifted, weights)
        gaps_m = np.linalg.norm(transform(placed[0], model[0]) - lifted[0], axis=1)
        weights = 1 / (1 + (gaps_m / 0.02) ** 2)[None] ** 2
    moved = fit.scene_from_model.copy()
    moved[scene] = placed[0]
    return [(moved, fit.points_model)]


def _scene_matched(trial: Trial, reading: Reading, scene: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """A start with one scene placed by the three of its clicks, at any depth, that most others agree with."""
    rays, fit = trial.rays, trial.fit
    places: dict[int, list[np.ndarray]] = {}
    for click in np.flatnonzero(reading.ray_used & (rays.scene == scene)):
        scene_from_camera = invert(rays.camera_from_scene[click])
        for depth_m in rays.depths_m[click][np.isfinite(rays.depths_m[click])][:2]:
            in_camera = depth_m * np.append(rays.xy[click], 1.0)
            places.setdefault(int(reading.keypoint[click]), []).append(
                transform(scene_from_camera, in_camera)
            )
    trusted = reading.ray_used & ((rays.scene != scene) | fit.hold_points)
    model = {int(k): fit.points_model[k][None] for k in np.unique(reading.keypoint[trusted])}
    found = match(
        model, {k: np.array(p[:4]) for k, p in places.items()}, samples=150, random=np.random.default_rng(0)
    )
    if found is None:
        return []
    moved = fit.scene_from_model.copy()
    moved[scene] = found
    return [(moved, fit.points_model)]


def _lifted_scene(trial: Trial, click: int) -> Float64[np.ndarray, "3"]:
    """A click at the depth of the nearest surface, in its scene; at its keypoint's depth where none is."""
    depth_m = trial.rays.depths_m[click, 0]
    if not np.isfinite(depth_m):
        depth_m = trial.fit.in_camera[click, 2]
    in_camera = depth_m * np.append(trial.rays.xy[click], 1.0)
    return transform(invert(trial.rays.camera_from_scene[click]), in_camera)
