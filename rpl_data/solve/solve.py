"""Clicks to the sparse model and the scene transforms (paper section III-C), and new scenes (III-F).

Eq. 2 asks for the keypoints Q and a rigid transform a scene that explain all lifted clicks. Here

1. every click keeps the candidate depths of its neighbourhood (`lift`), and every keypoint of a
   scene the places they allow (`adjustment.hypotheses`);
2. scenes are joined one after another by closed-form rigid transforms that most keypoints agree
   with (`adjustment.start`);
3. Eq. 2 is minimised on the chosen points (`adjustment.procrustes`; the paper's SLSQP beside it);
4. rays and depths are adjusted together, robustly, which gives the covariance (`adjustment.bundle`);
5. every click is told what became of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.clicks.rigidity import describe_loose, generic_points, loose_scenes
from rpl_data.geometry import invert, rigid, spread_m, transform
from rpl_data.solve.bundle_adjustment import Bundle, adjust_rays, choose_places, model_covariance, rays_of
from rpl_data.solve.diagnosis import Diagnosis, diagnose
from rpl_data.solve.hypotheses import hypotheses_of_scene
from rpl_data.solve.initial_guess import Hypotheses, Start, join_clean, join_scenes, match
from rpl_data.solve.procrustes import Adjusted, Fragments, Loss, adjust_points, eq2_cost
from rpl_data.solve.residuals import click_residuals, describe_keypoints
from rpl_data.solve.slsqp import adjust_points_slsqp
from rpl_data.types import ClickResidual, DataError, KeypointModel, Observation, Solution

Method = Literal["robust", "slsqp"]
ROUNDS = 5
"""How often keypoints may jump to another of their places before the answer stands."""
SAME_START_M = 1e-3
"""Keypoints that jump back to where the last adjustment began would come to the same answer again."""


def solve(
    object_name: str,
    keypoints: Sequence[str],
    observations: Sequence[Observation],
    *,
    method: Method = "robust",
    skeleton: Sequence[tuple[int, int]] = (),
) -> Solution:
    """The sparse model and the scene transforms of one object.

    Args:
        keypoints: their names; a keypoint never clicked stays without a position.
        observations: lifted clicks of all scenes.
        method: `robust`, or `slsqp`, the paper's own way: each click's depth is what the sensor
            measured nearest to it, the solver SciPy's SLSQP on Eq. 2.

    Raises:
        DataError: the clicks do not tie the scenes together; the message names scenes and keypoints.
    """
    scenes = sorted({o.click.scene for o in observations})
    refuse_bad(object_name, observations)
    groups = [hypotheses_of_scene([o for o in observations if o.click.scene == s]) for s in scenes]
    refuse_untied(object_name, groups, scenes, keypoints)
    if method == "slsqp":
        fragments = first_fragments(groups, len(keypoints))
        adjusted = adjust_points_slsqp(fragments)
    else:
        adjusted, fragments = _start(groups, len(keypoints))
    refuse_loose(object_name, adjusted.points_model, fragments.clicked > 0, scenes, keypoints)
    known: np.ndarray = fragments.clicked.sum(axis=0) > 0
    rays = rays_of(observations, scenes)
    bundle = adjust_rays(rays, adjusted.scene_from_model, adjusted.points_model)
    before: np.ndarray = bundle.points_model
    for _ in range(ROUNDS):
        places = _places_in_model(groups, bundle.scene_from_model, len(keypoints))
        points = choose_places(rays, bundle.scene_from_model, bundle.points_model, places)
        if np.array_equal(points, bundle.points_model) or np.abs(points - before).max() < SAME_START_M:
            break
        bundle, before = adjust_rays(rays, bundle.scene_from_model, points), points
    if method == "slsqp":  # the paper's answer, with our description of how well it fits
        bundle = bundle._replace(
            scene_from_model=adjusted.scene_from_model, points_model=adjusted.points_model
        )
    return _solution(object_name, keypoints, skeleton, scenes, observations, bundle, known)


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
    return _in_first_scene(adjust_points(fragments, _complete(start), loss=loss))


class Placement(NamedTuple):
    """A known object in a new scene, what became of its clicks, and what they say about themselves."""

    scene_from_object: Float64[np.ndarray, "4 4"]
    residuals: tuple[ClickResidual, ...]
    diagnosis: Diagnosis


def register(
    model: KeypointModel, observations: Sequence[Observation]
) -> tuple[Float64[np.ndarray, "4 4"], tuple[ClickResidual, ...]]:
    """`scene_from_object` of a new scene and the residuals of its clicks: `place` without the diagnosis."""
    placement = place(model, observations)
    return placement.scene_from_object, placement.residuals


def place(model: KeypointModel, observations: Sequence[Observation]) -> Placement:
    """Place a known model in a new scene by clicks (paper III-F).

    Horn's closed form on the best-agreeing depths, then the same adjustment as `solve` with the model
    held fixed. Clicks on keypoints that the model has no position of are not used.

    Raises:
        DataError: fewer than three usable keypoints, or all on a line.
    """
    name = model.name
    refuse_bad(name, observations)
    scene = observations[0].click.scene
    places = {k: p for k, p in hypotheses_of_scene(observations).items() if model.known[k]}
    clicked = sorted(places)
    if len(clicked) < 3:
        raise DataError(
            f"object {name}, scene {scene}: {len(clicked)} usable keypoints clicked, at least 3 needed; "
            "click more of the model's keypoints, where there is depth"
        )
    if spread_m(model.points_object[clicked])[1] < 0.004:
        raise DataError(
            f"object {name}, scene {scene}: keypoints {', '.join(model.keypoints[k] for k in clicked)} lie "
            "on a line, about which the object could turn; click one more keypoint off that line"
        )
    known = {int(k): model.points_object[k][None] for k in np.flatnonzero(model.known)}
    scene_from_object = match(known, places, samples=600, random=np.random.default_rng(0))
    if scene_from_object is None:
        raise DataError(
            f"object {name}, scene {scene}: no three clicks fit the model within 15 mm; check that every "
            "keypoint was clicked where the model has it"
        )
    usable = [o for o in observations if model.known[o.click.keypoint]]
    points = np.nan_to_num(model.points_object)
    bundle = adjust_rays(rays_of(usable, [scene]), scene_from_object[None], points, hold_points=True)
    diagnosis = diagnose(
        usable,
        [scene],
        model.keypoints,
        bundle.scene_from_model,
        points,
        known=model.known,
        hold_points=True,
    )
    explained = iter(click_residuals(usable, bundle, diagnosis.statements))
    residuals = (
        next(explained) if model.known[o.click.keypoint] else _not_in_model(o, model) for o in observations
    )
    return Placement(bundle.scene_from_model[0], tuple(residuals), diagnosis)


def _not_in_model(observation: Observation, model: KeypointModel) -> ClickResidual:
    """Of a click that could not be used."""
    reason = f"the model has no position of keypoint {model.keypoints[observation.click.keypoint]}"
    return ClickResidual(observation.click, 0.0, None, None, "none", outlier=False, reason=reason)


# Refusals -----------------------------------------------------------------------------------------


def refuse_bad(object_name: str, observations: Sequence[Observation]) -> None:
    """DataError for no clicks at all, or numbers that are not finite."""
    if not observations:
        raise DataError(f"object {object_name} has no clicks; mark its keypoints first (`rpl clicks import`)")
    for o in observations:
        if not (np.isfinite(o.ray_camera).all() and np.isfinite(o.scene_from_camera).all()):
            raise DataError(
                f"object {object_name}, scene {o.click.scene}, frame {o.click.frame}: the click on keypoint "
                f"{o.click.keypoint} or the camera pose is not a finite number; delete the click or "
                "mend the pose"
            )


def refuse_untied(
    object_name: str, groups: Sequence[Hypotheses], scenes: Sequence[str], keypoints: Sequence[str]
) -> None:
    """DataError when the pattern of clicks cannot tie the scenes, wherever the keypoints are."""
    refuse_loose(
        object_name, generic_points(len(keypoints)), _clicked(groups, len(keypoints)), scenes, keypoints
    )


def refuse_loose(
    object_name: str,
    points_model: Float64[np.ndarray, "k 3"],
    clicked: np.ndarray,
    scenes: Sequence[str],
    keypoints: Sequence[str],
) -> None:
    """DataError when the keypoints where they are do not tie the scenes."""
    loose = loose_scenes(points_model, clicked)
    if loose:
        raise DataError(f"object {object_name}: " + describe_loose(loose, clicked, scenes, keypoints))


def _clicked(groups: Sequence[Hypotheses], keypoints: int) -> np.ndarray:
    return np.array([[k in group for k in range(keypoints)] for group in groups])


# The start ----------------------------------------------------------------------------------------


def first_fragments(groups: Sequence[Hypotheses], keypoints: int) -> Fragments:
    """The paper's W from the most likely place of every keypoint in every scene."""
    points, clicked = np.zeros((len(groups), keypoints, 3)), np.zeros((len(groups), keypoints))
    for s, group in enumerate(groups):
        for k, places in group.items():
            points[s, k], clicked[s, k] = places[0], 1
    return Fragments(points, clicked)


def _start(groups: Sequence[Hypotheses], keypoints: int) -> tuple[Adjusted, Fragments]:
    start = join_scenes(groups, keypoints)
    adjusted = adjust_points(start.fragments, _complete(start))
    return adjusted, start.fragments


def _places_in_model(
    groups: Sequence[Hypotheses], scene_from_model: Float64[np.ndarray, "s 4 4"], keypoints: int
) -> list[Float64[np.ndarray, "_ 3"]]:
    """All hypotheses of each keypoint, brought to the model frame by the scenes as they stand."""
    places: list[list[np.ndarray]] = [[] for _ in range(keypoints)]
    for group, model_from_scene in zip(groups, invert(scene_from_model), strict=True):
        for k, hypotheses in group.items():
            places[k].extend(transform(model_from_scene, hypotheses))
    return [np.array(p).reshape(-1, 3) for p in places]


def _complete(start: Start) -> Float64[np.ndarray, "s 4 4"]:
    """Transforms of all scenes; those that could not be joined one by one start from many turns.

    Such scenes are tied only by the graph as a whole. Eq. 2 has a wide basin (the original code
    starts from the identity), so a few random starts and the lowest cost will do.
    """
    if all(found is not None for found in start.scene_from_model):
        return np.stack([found for found in start.scene_from_model if found is not None])
    random = np.random.default_rng(0)
    tries = [
        adjust_points(
            start.fragments,
            np.stack([_random_turn(random) if t is None else t for t in start.scene_from_model]),
            loss="l2",
        )
        for _ in range(30)
    ]
    best = min(tries, key=lambda adjusted: eq2_cost(start.fragments, adjusted))
    return best.scene_from_model


def _random_turn(random: np.random.Generator) -> Float64[np.ndarray, "4 4"]:
    return rigid(Rotation.random(rng=random).as_matrix(), np.zeros(3))


def _in_first_scene(adjusted: Adjusted) -> Adjusted:
    first = adjusted.scene_from_model[0]
    return Adjusted(
        adjusted.scene_from_model @ invert(first), transform(first, adjusted.points_model), adjusted.weights
    )


# The answer ---------------------------------------------------------------------------------------


def _solution(
    object_name: str,
    keypoints: Sequence[str],
    skeleton: Sequence[tuple[int, int]],
    scenes: Sequence[str],
    observations: Sequence[Observation],
    bundle: Bundle,
    known: np.ndarray,
) -> Solution:
    """Moved to the object frame: the first scene's axes, at the centroid of the keypoints."""
    diagnosis = diagnose(
        observations, scenes, keypoints, bundle.scene_from_model, bundle.points_model, known=known
    )
    in_first = transform(bundle.scene_from_model[0], bundle.points_model)
    first_from_object = rigid(np.eye(3), in_first[known].mean(axis=0))
    model_from_object = invert(bundle.scene_from_model[0]) @ first_from_object
    points = np.where(known[:, None], transform(invert(first_from_object), in_first), np.nan)
    turn = model_from_object[:3, :3]
    return Solution(
        model=KeypointModel(object_name, tuple(keypoints), points, tuple(skeleton)),
        covariance=turn.T @ model_covariance(bundle, known) @ turn,
        scene_from_object={
            name: scene_from_model @ model_from_object
            for name, scene_from_model in zip(scenes, bundle.scene_from_model, strict=True)
        },
        residuals=click_residuals(observations, bundle, diagnosis.statements),
        warnings=describe_keypoints(keypoints, observations, known),
        statements=diagnosis.statements,
        expected_mm=diagnosis.expected_mm,
        next_clicks=diagnosis.next_clicks,
    )
