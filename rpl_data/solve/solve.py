"""Clicks to the sparse model and the scene transforms (paper section III-C).

Eq. 2 asks for the keypoints Q and one rigid transform per scene that explain all lifted clicks. Here

1. every click keeps the candidate depths of its neighbourhood (`clicks.lift`), and every keypoint of a
   scene the candidate positions they allow (`hypotheses`);
2. scenes are joined one after another by closed-form rigid transforms that most keypoints agree with,
   from several first scenes (`initial_guess`), and Eq. 2 is minimised on the chosen points (`procrustes`;
   the paper's SLSQP beside it);
3. rays and depths are adjusted together, robustly (`bundle_adjustment`), and scenes and keypoints may
   jump to where the others would rather have them (`search`);
4. the noise of clicks and depths is estimated, and with it the covariance (`noise`);
5. the clicks are diagnosed (`diagnosis`), and every click is told what became of it (`residuals`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool

from rpl_data.clicks.rigidity import generic_points
from rpl_data.geometry import invert, transform
from rpl_data.solve.bundle_adjustment import State, cost_of
from rpl_data.solve.click_rays import Noise, Rays, rays_of
from rpl_data.solve.diagnosis import Placed, diagnose
from rpl_data.solve.hypotheses import hypotheses_of_scene
from rpl_data.solve.initial_guess import Start, join_clean, join_scenes
from rpl_data.solve.near_ties import describe_near_ties, widened_for_near_ties
from rpl_data.solve.noise import (
    adjust_with_noise,
    estimate_noise,
    joint_covariance,
    points_in_scene_covariance,
    shape_covariance,
    widened_for_all_scenes,
)
from rpl_data.solve.object_frame import object_frame
from rpl_data.solve.one_side import describe_one_side, one_sided
from rpl_data.solve.procrustes import Adjusted, Fragments, Loss, adjust_points
from rpl_data.solve.refusals import refuse_bad, refuse_few, refuse_loose, refuse_untied
from rpl_data.solve.register import register, register_scene
from rpl_data.solve.residuals import click_fit, click_residuals, describe_keypoints
from rpl_data.solve.search import Alternative, answer_from, search
from rpl_data.solve.slsqp import adjust_points_slsqp, at_clicked_pixel, measured_fragments
from rpl_data.solve.starts import complete, start_states
from rpl_data.types import KeypointModel, Observation, Solution
from rpl_data.types.keypoint_names import keypoint_titles

__all__ = ["Method", "Unchecked", "register", "register_scene", "solve", "solve_points", "solve_unchecked"]

Method = Literal["robust", "slsqp"]


GoOn = Callable[[], None]
"""Called again and again during long work; it may raise to end it."""


class Unchecked(NamedTuple):
    """A first solution, whose clicks may not have been checked against one another yet.

    Attributes:
        solution: while `check` is not None without statements and next clicks, and from the starts alone:
            where clicks are wrong, a scene may stand elsewhere once they are checked.
        check: gives the final solution; None when there is nothing left to do.
    """

    solution: Solution
    check: Callable[[GoOn], Solution] | None


def _undisturbed() -> None:
    """Go on."""


def solve(
    object_name: str,
    keypoints: Sequence[str],
    observations: Sequence[Observation],
    *,
    method: Method = "robust",
    skeleton: Sequence[tuple[int, int]] = (),
    trajectory_sigma_m: Mapping[str, float] | None = None,
) -> Solution:
    """The sparse model and the scene transforms of one object.

    Args:
        keypoints: their names; a keypoint never clicked stays without a position.
        observations: lifted clicks of all scenes.
        method: `robust`, or `slsqp`, the paper's own way: each click's depth is that of its pixel, and
            SciPy's SLSQP minimises Eq. 2 from the paper's start.
        trajectory_sigma_m: how far the poses of each scene stray, standard deviation per axis; it
            widens `covariance_in_scene`.

    Raises:
        DataError: the clicks do not tie the scenes together; the message names scenes and keypoints.
    """
    solution, check = solve_unchecked(
        object_name,
        keypoints,
        observations,
        method=method,
        skeleton=skeleton,
        trajectory_sigma_m=trajectory_sigma_m,
    )
    return solution if check is None else check(_undisturbed)


def solve_unchecked(
    object_name: str,
    keypoints: Sequence[str],
    observations: Sequence[Observation],
    *,
    method: Method = "robust",
    skeleton: Sequence[tuple[int, int]] = (),
    trajectory_sigma_m: Mapping[str, float] | None = None,
) -> Unchecked:
    """As `solve`, for a person who waits: other starts and the check of the clicks are left for later."""
    scenes = sorted({o.click.scene for o in observations})
    refuse_bad(object_name, observations)
    refuse_few(object_name, observations)
    titles = keypoint_titles(keypoints)
    if method == "slsqp":
        observations = [at_clicked_pixel(o) for o in observations]
        answer, searched = _papers_answer(object_name, titles, observations, scenes), None
    else:
        answer, searched = _robust_answer(object_name, titles, observations, scenes, trajectory_sigma_m or {})
    finish = partial(
        _solution, object_name, keypoints, skeleton, observations, trajectory_sigma_m=trajectory_sigma_m or {}
    )
    if searched is None:
        return Unchecked(finish(answer)[0], None)

    def check(go_on: GoOn) -> Solution:
        return _checked(*finish(searched(go_on)), observations, go_on)

    return Unchecked(finish(answer)[0], check)


def solve_points(fragments: Fragments, *, method: Method = "robust", loss: Loss = "robust") -> Adjusted:
    """Eq. 2 alone, on points already lifted; the model is in the first scene's frame.

    Raises:
        DataError: the points do not tie the scenes together.
    """
    if method == "slsqp":
        return adjust_points_slsqp(fragments)
    groups = [
        {int(k): points[k][None] for k in np.flatnonzero(clicked)}
        for points, clicked in zip(fragments.points_scene, fragments.clicked, strict=True)
    ]
    keypoints = fragments.clicked.shape[1]
    start = Start(join_clean(fragments), fragments) if loss == "l2" else join_scenes(groups, keypoints)
    if any(joined is None for joined in start.scene_from_model):  # scenes joined one by one are tied
        names = [str(s) for s in range(len(groups))]
        refuse_untied("object", groups, names, [str(k) for k in range(keypoints)])
    return _in_first_scene(adjust_points(fragments, complete(start), loss=loss))


# The two ways -------------------------------------------------------------------------------------


def _robust_answer(
    object_name: str,
    keypoints: Sequence[str],
    observations: Sequence[Observation],
    scenes: Sequence[str],
    trajectory_sigma_m: Mapping[str, float],
) -> tuple[_Answer, Callable[[GoOn], _Answer]]:
    """Rays and candidate depths adjusted together: from one start, and by a search from several.

    The search takes the poses of the frames as they are, which is quicker.
    """
    groups = [hypotheses_of_scene([o for o in observations if o.click.scene == s]) for s in scenes]
    refuse_untied(object_name, groups, scenes, keypoints)
    clicked = np.array([[k in group for k in range(len(keypoints))] for group in groups])
    rays, starts = rays_of(observations, scenes), start_states(groups, len(keypoints))
    start = next(starts)
    refuse_loose(object_name, start.points_model, clicked, scenes, keypoints)
    first, others = answer_from(rays, groups, start), list[State]()
    known = np.asarray(clicked.any(axis=0))

    def adjusted(state: State, alternatives: Sequence[Alternative]) -> _Answer:
        straying = widened_for_all_scenes(rays_of(observations, scenes, trajectory_sigma_m), state)
        return _Answer(scenes, straying, *adjust_with_noise(straying, state), known, alternatives)

    answer = adjusted(first, ())

    def searched(go_on: GoOn) -> _Answer:
        others.extend(answer_from(rays, groups, state) for state in starts)  # none is left when it runs again
        cheapest = min([first, *others], key=lambda state: cost_of(rays, state))
        found = search(rays, groups, cheapest, go_on=go_on)
        if found.state is first:
            return answer._replace(alternatives=found.alternatives)
        return adjusted(found.state, found.alternatives)

    return answer, searched


def _papers_answer(
    object_name: str, keypoints: Sequence[str], observations: Sequence[Observation], scenes: Sequence[str]
) -> _Answer:
    """Eq. 2 by SLSQP on the points that the clicked pixels' own depths give; nothing repairs them."""
    fragments = measured_fragments(observations, scenes, len(keypoints))
    clicked = fragments.clicked > 0
    refuse_loose(object_name, generic_points(len(keypoints)), clicked, scenes, keypoints)
    adjusted = adjust_points_slsqp(fragments)
    refuse_loose(object_name, adjusted.points_model, clicked, scenes, keypoints)
    state, rays = State(adjusted.scene_from_model, adjusted.points_model), rays_of(observations, scenes)
    noise = estimate_noise(rays, state, noise=Noise())
    return _Answer(scenes, rays, state, noise, np.asarray(clicked.any(axis=0)), ())


def _in_first_scene(adjusted: Adjusted) -> Adjusted:
    first = adjusted.scene_from_model[0]
    return Adjusted(
        adjusted.scene_from_model @ invert(first), transform(first, adjusted.points_model), adjusted.weights
    )


# The answer ---------------------------------------------------------------------------------------


class _Answer(NamedTuple):
    """What the adjustment ended with."""

    scenes: Sequence[str]
    rays: Rays
    state: State
    noise: Noise
    known: Bool[np.ndarray, " k"]
    alternatives: Sequence[Alternative]


def _solution(
    object_name: str,
    keypoints: Sequence[str],
    skeleton: Sequence[tuple[int, int]],
    observations: Sequence[Observation],
    answer: _Answer,
    *,
    trajectory_sigma_m: Mapping[str, float],
) -> tuple[Solution, Placed]:
    """The answer in the object frame, with its covariances and what became of every click."""
    state, known = answer.state, answer.known
    model_from_object, points = object_frame(state, known)
    turn = model_from_object[:3, :3]
    titles = keypoint_titles(keypoints)
    joint = joint_covariance(answer.rays, state, noise=answer.noise)
    in_scene = {
        name: widened_for_near_ties(
            points_in_scene_covariance(joint, state, s, known), answer.alternatives, state, s
        )
        for s, name in enumerate(answer.scenes)
    }
    ties = describe_near_ties(answer.alternatives, state, answer.scenes, known)
    placed = Placed(
        answer.scenes, answer.rays, state, answer.noise, joint, in_scene, known, ties, trajectory_sigma_m
    )
    one_side = one_sided(placed)
    solution = Solution(
        model=KeypointModel(object_name, tuple(keypoints), points, tuple(skeleton)),
        covariance=turn.T @ shape_covariance(joint, state, known) @ turn,
        scene_from_object={
            name: scene_from_model @ model_from_object
            for name, scene_from_model in zip(answer.scenes, state.scene_from_model, strict=True)
        },
        residuals=click_residuals(observations, click_fit(answer.rays, state, answer.noise)),
        warnings=describe_keypoints(titles, observations, known) + describe_one_side(titles, one_side),
        covariance_in_scene={name: placed.stated_covariance(name) for name in answer.scenes},
        trajectory_sigma_m={name: trajectory_sigma_m.get(name, 0.0) for name in answer.scenes},
        click_sigma_px=answer.noise.click_px,
        depth_sigma_ratio=answer.noise.depth_ratio,
        one_side=tuple(one_side),
        checked=False,
    )
    return solution, placed


def _checked(
    solution: Solution, placed: Placed, observations: Sequence[Observation], go_on: GoOn
) -> Solution:
    """The solution, with what its clicks say about one another and which further clicks would help."""
    diagnosis = diagnose(observations, keypoint_titles(solution.model.keypoints), placed, go_on=go_on)
    fit = click_fit(placed.rays, placed.state, placed.noise)
    return replace(
        solution,
        residuals=click_residuals(observations, fit, diagnosis.statements),
        statements=diagnosis.statements,
        next_clicks=diagnosis.next_clicks,
        checked=True,
    )
