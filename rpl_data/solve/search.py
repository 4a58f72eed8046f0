"""The search for the lowest robust cost: several starts, and scenes and keypoints that may jump.

The robust cost has many valleys: on a hollow object a click may be explained by the near wall or the far
one, and three such clicks put a whole scene into another valley, from which no small step leads out. So
every scene is placed anew against what the other scenes say, in all the ways its clicks allow, and the
cheapest answer of the whole adjustment wins. Answers that cost nearly as much are kept: they are what the
clicks cannot rule out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import invert, transform
from rpl_data.motions import transform_each
from rpl_data.solve.bundle_adjustment import (
    COARSE,
    State,
    adjust,
    cost_of,
    costs_of_positions,
    descend,
    moved,
    normal_equations,
    reassign_keypoints,
)
from rpl_data.solve.click_rays import Noise, Rays
from rpl_data.solve.initial_guess import Hypotheses
from rpl_data.solve.scene_poses import DISTINCT_M, likely_poses

ROUNDS = 5
"""How often keypoints may jump to another of their candidates before the answer stands."""
SWEEPS = 3
"""How often all scenes may be placed anew."""
ROUGHLY = 1e-4
"""Relative change of the cost at which a descent ends while answers are only compared."""
WORTH_TRYING = 25.0
"""A pose whose clicks cost more than this above the present one, with the keypoints held, is not tried."""
TRIED_PER_SCENE = 2
"""Poses that are tried besides the present one, most likely first."""
NEAR_TIE = 12.0
"""Answers whose cost is higher by less than this are remembered."""


class Alternative(NamedTuple):
    """Another answer in which one scene stands elsewhere.

    Attributes:
        excess: by how much its cost is higher.
    """

    scene: int
    state: State
    excess: float


class Found(NamedTuple):
    """The cheapest answer, and what came near it."""

    state: State
    cost: float
    alternatives: tuple[Alternative, ...]


def answer_from(rays: Rays, candidates: Sequence[Hypotheses], start: State) -> State:
    """The answer that is reached from a start, with no scene placed anew.

    Args:
        candidates: for each scene, by keypoint, where in the scene it may be.
        start: right to a few centimetres, if the clicks are.
    """
    return settle(rays, candidates, adjust(rays, start, tolerance=ROUGHLY))


def search(
    rays: Rays, candidates: Sequence[Hypotheses], state: State, *, go_on: Callable[[], None] = lambda: None
) -> Found:
    """The answer of lowest cost that is reached when scenes are placed anew, one after another.

    Args:
        candidates: for each scene, by keypoint, where in the scene it may be.
        state: from `answer_from`; it comes back itself where nothing better is found.
        go_on: called before each scene; what it raises ends the search.
    """
    cost, costs = cost_of(rays, state), candidate_costs(rays, candidates, state)
    alternatives: dict[int, list[Alternative]] = {}
    waiting = list(range(len(state.scene_from_model))) * SWEEPS
    unchanged = 0
    for scene in waiting:
        go_on()
        found = _other_poses(rays, candidates, state, cost, costs, scene)
        alternatives[scene] = found
        unchanged += 1
        if found and found[0].excess < -1e-6:
            state, cost, unchanged = found[0].state, cost + found[0].excess, 0
            costs = candidate_costs(rays, candidates, state)
        if unchanged == len(state.scene_from_model):
            break
    near = [a for found in alternatives.values() for a in found if 0 <= a.excess < NEAR_TIE]
    return Found(state, cost, tuple(sorted(near, key=lambda a: a.excess)))


def settle(rays: Rays, candidates: Sequence[Hypotheses], state: State, *, rounds: int = ROUNDS) -> State:
    """Let keypoints jump to other candidates, and adjust, until nothing changes or the rounds are over."""
    before = state.points_model
    for _ in range(rounds):
        jumped = reassign_keypoints(rays, state, candidates_in_model(candidates, state))
        if np.array_equal(jumped.points_model, state.points_model):
            break
        if np.abs(jumped.points_model - before).max() < DISTINCT_M / 10:
            break  # back to where the last adjustment began, which would end the same
        before, state = jumped.points_model, adjust(rays, jumped, tolerance=ROUGHLY)
    return state


def candidates_in_model(candidates: Sequence[Hypotheses], state: State) -> list[Float64[np.ndarray, "_ 3"]]:
    """All candidate positions of each keypoint, brought to the model frame by the scenes as they stand."""
    return [positions for positions, _ in _candidates_of_scenes(candidates, state)]


def _candidates_of_scenes(
    candidates: Sequence[Hypotheses], state: State
) -> list[tuple[Float64[np.ndarray, "n 3"], Int64[np.ndarray, " n"]]]:
    """Per keypoint: its candidate positions, model frame, and which scene each is of."""
    found = []
    for k in range(len(state.points_model)):
        told = [(s, of_scene[k]) for s, of_scene in enumerate(candidates) if k in of_scene]
        scene = np.repeat([s for s, _ in told], [len(positions) for _, positions in told]).astype(np.int64)
        positions = np.concatenate([np.empty((0, 3)), *(positions for _, positions in told)])
        found.append((transform_each(invert(state.scene_from_model[scene]), positions), scene))
    return found


class CandidateCosts(NamedTuple):
    """What each click of a keypoint says of each of its candidate positions, scenes held; the present first.

    Attributes:
        scene: which scene each candidate is of; -1 for the present position.
        click_scene: which scene each click is of.
        costs: per candidate and click.
    """

    positions: Float64[np.ndarray, "n 3"]
    scene: Int64[np.ndarray, " n"]
    click_scene: Int64[np.ndarray, " m"]
    costs: Float64[np.ndarray, "n m"]

    def without(self, scene: int) -> Float64[np.ndarray, "3"]:
        """The cheapest for the clicks of the other scenes, of the candidates there."""
        chosen, others = self.scene != scene, self.click_scene != scene
        best = self.costs[chosen][:, others].sum(axis=1).argmin()
        position: Float64[np.ndarray, "3"] = self.positions[chosen][best]
        return position


def candidate_costs(rays: Rays, candidates: Sequence[Hypotheses], state: State) -> list[CandidateCosts]:
    """One per keypoint, so that leaving scenes out in turn need not begin anew each time."""
    found = []
    for k, (positions, scene) in enumerate(_candidates_of_scenes(candidates, state)):
        tried = np.vstack([state.points_model[k][None], positions])
        own = rays.keypoint == k
        costs = costs_of_positions(rays.of(own), state, tried)
        found.append(CandidateCosts(tried, np.concatenate([[-1], scene]), rays.scene[own], costs))
    return found


def _other_poses(
    rays: Rays,
    candidates: Sequence[Hypotheses],
    state: State,
    cost: float,
    costs: Sequence[CandidateCosts],
    scene: int,
) -> list[Alternative]:
    """Answers in which one scene stands elsewhere, cheapest first; better ones have a negative excess."""
    points, told = points_without(rays, costs, state, scene)
    own = (rays.scene == scene) & told[rays.keypoint]
    if len(np.unique(rays.keypoint[own])) < 3:
        return []
    now = state.scene_from_model[scene]
    found = likely_poses(rays.of(own), points, candidates[scene], known_poses=now[None])
    in_scene = transform(now, state.points_model)
    tried: list[Alternative] = []
    for pose, held_cost in zip(found.scene_from_model, found.cost, strict=True):
        if held_cost > found.cost[0] + WORTH_TRYING or len(tried) == TRIED_PER_SCENE:
            break
        if _apart_m(pose, points[told], now, state.points_model[told]) < DISTINCT_M:
            continue
        poses = state.scene_from_model.copy()
        poses[scene] = pose
        start = State(poses, np.where(told[:, None], points, transform(invert(pose), in_scene)))
        there = descend(rays, start, noise=Noise(), tolerance=ROUGHLY)
        if cost_of(rays, there) > cost + 2 * NEAR_TIE:
            continue
        there = settle(rays, candidates, there, rounds=2)
        if _apart_m(there.scene_from_model[scene], there.points_model, now, state.points_model) > DISTINCT_M:
            tried.append(Alternative(scene, there, cost_of(rays, there) - cost))
    return sorted(tried, key=lambda a: a.excess)


def _apart_m(
    pose_a: np.ndarray, points_a: Float64[np.ndarray, "n 3"], pose_b: np.ndarray, points_b: np.ndarray
) -> float:
    """Mean distance between the keypoints as two answers put them into a scene."""
    return float(np.linalg.norm(transform(pose_a, points_a) - transform(pose_b, points_b), axis=1).mean())


def points_without(
    rays: Rays, costs: Sequence[CandidateCosts], state: State, scene: int
) -> tuple[Float64[np.ndarray, "k 3"], np.ndarray]:
    """Keypoints as the clicks of all other scenes have them, poses held; and which they tell anything of."""
    others = rays.of(rays.scene != scene)
    told = np.array([bool((of_keypoint.scene[1:] != scene).any()) for of_keypoint in costs])
    seen = np.isin(np.arange(len(costs)), others.keypoint)
    points = state.points_model.copy()
    for k in np.flatnonzero(told & seen).tolist():
        points[k] = costs[k].without(scene)
    found = State(state.scene_from_model, points)
    poses = 6 * len(state.scene_from_model)
    for _ in range(3):
        system = normal_equations(others, found, noise=COARSE)
        normal = system.normal[poses:, poses:]
        ridge = 1e-6 * np.diag(normal) + 1e-3
        points_step = np.linalg.solve(normal + np.diag(ridge), -system.gradient[poses:])
        found = moved(found, np.concatenate([np.zeros(poses), points_step]))
    return found.points_model, told
