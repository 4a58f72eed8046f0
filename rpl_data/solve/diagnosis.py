"""What the clicks say about one another, in words: which are wrong, which disagree, which nothing checks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.solve.bundle_adjustment import State, points_in_cameras
from rpl_data.solve.click_rays import HAND_SIGMA_PX, Noise, Rays, misfit
from rpl_data.solve.explanations import SCENE_SHARE, find_faults, first_trial
from rpl_data.solve.fault_words import FaultWords, whole_scene_text
from rpl_data.solve.precision import next_clicks
from rpl_data.solve.trial import Fault, Trial
from rpl_data.solve.unnoticed import unjudged
from rpl_data.solve.wrong_names import FEW_IN_SCENE
from rpl_data.types import Click, NextClick, Observation, Statement, StatementKind, expected_mm

WEAK_MM = 10.0
"""A scene whose keypoints should be farther off than this, by its clicks alone, is placed badly."""
LEFT_OUT_SIGMAS = 6.0
"""A click this far from its keypoint, in standard deviations, has no say in the answer."""
MOST_NEXT = 40
"""Further clicks that are kept; some of them may be hidden or skipped."""
TOO_MANY = 1 / 3
"""With more than this share of the keypoints of all scenes in doubt, none of the clicks can be trusted."""


class Placed(NamedTuple):
    """What the solver found, and how well it is known.

    Attributes:
        joint: covariance of all unknowns (`noise.joint_covariance`).
        covariance_in_scene: of each keypoint's position in each scene, from the clicks alone, in m^2.
        ties: lines about the scenes in which the object could stand elsewhere just as well, by scene.
        trajectory_sigma_m: how far the poses of each scene stray (see `Solution`), which no click lowers.
    """

    scenes: Sequence[str]
    rays: Rays
    state: State
    noise: Noise
    joint: Float64[np.ndarray, "u u"]
    covariance_in_scene: Mapping[str, Float64[np.ndarray, "k 3 3"]]
    known: Bool[np.ndarray, " k"]
    ties: Mapping[str, str]
    trajectory_sigma_m: Mapping[str, float]

    def stated_covariance(self, scene: str) -> Float64[np.ndarray, "k 3 3"]:
        """Covariance of the keypoints' positions in a scene, in m^2, with what its poses stray."""
        strayed_m = self.trajectory_sigma_m.get(scene, 0.0)
        stated: Float64[np.ndarray, "k 3 3"] = self.covariance_in_scene[scene] + strayed_m**2 * np.eye(3)
        return stated


class Diagnosis(NamedTuple):
    """What the clicks say about one another, and which further clicks would help (see `Solution`)."""

    statements: tuple[Statement, ...]
    next_clicks: tuple[NextClick, ...]


def diagnose(
    observations: Sequence[Observation],
    keypoints: Sequence[str],
    placed: Placed,
    *,
    hold_points: bool = False,
    go_on: Callable[[], None] = lambda: None,
) -> Diagnosis:
    """Statements about clicks, the strongest contradiction first, and the clicks that would help most.

    Args:
        observations: in the order of `placed.rays`.
        hold_points: the model is known; only scenes were placed.
        go_on: called before each fit; what it raises ends the work.
    """
    clicks = [o.click for o in observations]
    trial = first_trial(placed.rays, *placed.state, hold_points=hold_points, go_on=go_on)
    faults, mended = find_faults(trial, np.flatnonzero(not_followed(placed)))
    words = FaultWords(placed.scenes, keypoints, clicks, mended)
    statements = [
        Statement(_kind(fault), _clicks(fault, clicks), words.of(fault), round(fault.best.gain, 1))
        for fault in faults
    ]
    contradictions = [*_everything(trial, faults, clicks), *statements]
    explained = _explained(faults, mended, clicks)
    contradictions += (
        s
        for s in left_out(clicks, placed, contradictions, keypoints, known_model=hold_points)
        if not explained.issuperset(s.clicks)
    )
    contradictions = list(_as_whole_scenes(contradictions, clicks, known_model=hold_points))
    contradicted = {c.scene for s in contradictions if s.kind == "whole scene" for c in s.clicks}
    helpful = next_clicks(
        placed.rays,
        placed.state,
        placed.noise,
        placed.joint,
        np.stack([placed.stated_covariance(name) for name in placed.scenes]),
        clicks,
        np.flatnonzero(placed.known).tolist(),
        most=MOST_NEXT,
    )
    weak = _weak(clicks, placed, contradicted, helpful, keypoints)
    unchecked = () if hold_points else _unchecked(clicks, keypoints)
    open_ = () if hold_points else unjudged(mended.fit, clicks, keypoints)
    return Diagnosis((*contradictions, *weak, *unchecked, *open_), helpful)


def left_out(
    clicks: Sequence[Click],
    placed: Placed,
    said: Sequence[Statement],
    keypoints: Sequence[str],
    *,
    known_model: bool = False,
) -> Iterator[Statement]:
    """Clicks that the answer does not follow although nothing shows that they are wrong."""
    known = {click for statement in said for click in statement.clicks}
    error_px = _errors_px(placed)
    for n in np.flatnonzero(not_followed(placed)).tolist():
        click, name = clicks[n], keypoints[clicks[n].keypoint]
        if click in known:
            continue
        text = (
            f"scene {click.scene}, frame {click.frame}: keypoint {name} was clicked {error_px[n]:.0f} px "
            "away from where the solution has it, but nothing tells which click is wrong; look at it, or "
            f"mark {name} in one more {'frame' if known_model else 'scene or frame'}"
        )
        yield Statement("disagree", (click,), text)


def not_followed(placed: Placed) -> Bool[np.ndarray, " m"]:
    """Clicks that the answer does not follow."""
    far_px = LEFT_OUT_SIGMAS * max(placed.noise.click_px, HAND_SIGMA_PX)
    left: Bool[np.ndarray, " m"] = (_errors_px(placed) > far_px) & placed.known[placed.rays.keypoint]
    return left


def _errors_px(placed: Placed) -> Float64[np.ndarray, " m"]:
    """Distance of every click from its keypoint in the answer."""
    found = misfit(placed.rays, points_in_cameras(placed.rays, placed.state))
    distances: Float64[np.ndarray, " m"] = np.linalg.norm(found.error_px, axis=1)
    return distances


def _explained(faults: Sequence[Fault], mended: Trial, clicks: Sequence[Click]) -> set[Click]:
    """Clicks that fit once a mistake in their scene is mended, while the answer left them out for it.

    Where few clicks remain of a scene they can always be made to fit, which explains nothing.
    """
    found = {f.best.scene for f in faults if not f.rivals}
    named = {f.best.scene for f in faults if f.best.meant}
    remain = Counter(scene for scene, _ in mended.placements())
    scenes = {s for s in found if s in named or remain[s] >= FEW_IN_SCENE}
    own = np.flatnonzero(np.isin(mended.rays.scene, list(scenes)))
    near = mended.miss_px(own, mended.reading.keypoint) < LEFT_OUT_SIGMAS * mended.fit.sigma_px
    return {clicks[n] for n in own[near].tolist()}


def _as_whole_scenes(
    said: Sequence[Statement], clicks: Sequence[Click], *, known_model: bool
) -> Iterator[Statement]:
    """One statement in place of several that all are about one scene and a large share of its keypoints.

    With few clicks a scene that was marked wrongly as a whole can always be turned so that most of them fit;
    what then stands out are the rest of them, one after another.
    """
    shown = {scene: {c.keypoint for c in clicks if c.scene == scene} for scene in {c.scene for c in clicks}}
    whole: set[str] = set()
    for scene, keypoints in shown.items():
        own = [s for s in said if s.kind != "everything" and {c.scene for c in s.clicks} == {scene}]
        doubted = {c.keypoint for s in own for c in (s.clicks if s.blames else s.clicks[:1])}
        if len(own) > 1 and len(doubted) >= SCENE_SHARE * len(keypoints):
            whole.add(scene)
            clicked = tuple(c for c in clicks if c.scene == scene)
            evidence = round(sum(s.evidence for s in own), 1)
            text = whole_scene_text(scene, len(clicked), known_model=known_model)
            yield Statement("whole scene", clicked, text, evidence)
    yield from (s for s in said if not whole or {c.scene for c in s.clicks} not in [{w} for w in whole])


def _weak(
    clicks: Sequence[Click],
    placed: Placed,
    contradicted: Collection[str],
    helpful: Sequence[NextClick],
    keypoints: Sequence[str],
) -> Iterator[Statement]:
    """Scenes that their clicks place badly, such as three on a line; and what would help there."""
    for scene in placed.scenes:
        by_clicks_mm = expected_mm(placed.covariance_in_scene[scene])
        mm = expected_mm(placed.stated_covariance(scene))
        own = tuple(click for click in clicks if click.scene == scene)
        if scene in contradicted:
            continue
        if scene in placed.ties:
            yield Statement("weak scene", own, placed.ties[scene], round(mm, 1))
        elif by_clicks_mm > WEAK_MM:
            yield Statement(
                "weak scene", own, _placed_badly(scene, own, mm, helpful, keypoints), round(mm, 1)
            )


def _placed_badly(
    scene: str, own: Sequence[Click], mm: float, helpful: Sequence[NextClick], keypoints: Sequence[str]
) -> str:
    best = next((n for n in helpful if n.scene == scene), None)
    advice = (
        "mark one more keypoint away from the line through these"
        if best is None
        else f"marking keypoint {keypoints[best.keypoint]} in frame {best.frame} should leave "
        f"{best.left_mm:.0f} mm"
    )
    names = ", ".join(keypoints[k] for k in sorted({click.keypoint for click in own}))
    return (
        f"scene {scene}: its clicks (keypoints {names}) place the object badly, by them and its poses alone "
        f"its keypoints are expected to be {mm:.0f} mm off there; {advice}"
    )


def _kind(fault: Fault) -> StatementKind:
    return "disagree" if fault.rivals else fault.best.kind


def _clicks(fault: Fault, clicks: Sequence[Click]) -> tuple[Click, ...]:
    numbers = {n for explanation in (fault.best, *fault.rivals) for n in explanation.clicks}
    return tuple(clicks[n] for n in sorted(numbers))


def _everything(trial: Trial, faults: Sequence[Fault], clicks: Sequence[Click]) -> Iterator[Statement]:
    """That so much is wrong that nothing can be trusted."""
    placed = len(trial.placements())
    doubted = {(f.best.scene, k) for f in faults for k in f.best.keypoints}
    if len(doubted) > TOO_MANY * placed:
        text = (
            f"{len(doubted)} of {placed} marked keypoints contradict the others: no result can be trusted; "
            "check that all scenes show the same object and that its keypoints are named alike in all of them"
        )
        yield Statement("everything", tuple(clicks), text, round(sum(f.best.gain for f in faults), 1))


def _unchecked(clicks: Sequence[Click], keypoints: Sequence[str]) -> Iterator[Statement]:
    """Keypoints marked once: a wrong click there would go unnoticed."""
    for k, name in enumerate(keypoints):
        own = [click for click in clicks if click.keypoint == k]
        if len({(click.scene, click.frame) for click in own}) == 1:
            text = (
                f"keypoint {name} was clicked in one frame only (scene {own[0].scene}, frame "
                f"{own[0].frame}): nothing checks it; mark it in another scene, or in another frame seen "
                "from another side"
            )
            yield Statement("unchecked", tuple(own), text)
