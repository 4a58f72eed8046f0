"""The clicks as one part of a larger adjustment, and its answer as a solution.

The refine stage puts the scenes' surfaces into the same normal matrix as the clicks (paper Eq. 2). What it
needs of the clicks, and what becomes of them at its answer, is here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.solve.bundle_adjustment import State, cost_of, normal_equations, points_in_cameras
from rpl_data.solve.click_rays import Noise, Rays, click_costs, misfit, rays_of
from rpl_data.solve.noise import (
    USUAL,
    estimate_noise,
    inverse_normal,
    joint_covariance,
    points_in_scene_covariance,
    shape_covariance,
    widened_for_all_scenes,
    with_shared_errors,
)
from rpl_data.solve.object_frame import object_frame
from rpl_data.solve.residuals import click_fit, click_residuals
from rpl_data.solve.witnesses import Contradiction
from rpl_data.types import Observation, Solution

Poses = Float64[np.ndarray, "s 4 4"]
Points = Float64[np.ndarray, "k 3"]


@dataclass(frozen=True)
class JointClicks:
    """The clicks of an object at its solution.

    Attributes:
        observations: the clicks that are used, in the order of `rays`.
        scenes: names, in the order of the unknowns.
        known_points: the keypoints when they are given and only the scenes move; else None.
    """

    solution: Solution
    observations: tuple[Observation, ...]
    scenes: tuple[str, ...]
    rays: Rays
    noise: Noise
    known_points: Points | None

    @property
    def scene_from_object(self) -> Poses:
        """The click solution, one pose per scene."""
        return _stacked(self.solution, self.scenes)

    @property
    def points_object(self) -> Points:
        """The keypoints that are unknowns, 0 for those never clicked; none when they are given."""
        if self.known_points is not None:
            return np.empty((0, 3))
        points: Points = np.nan_to_num(self.solution.model.points_object)
        return points

    def terms(
        self, scene_from_object: Poses, points_object: Points
    ) -> tuple[Float64[np.ndarray, "u u"], Float64[np.ndarray, " u"]]:
        """The normal matrix and the gradient of the clicks' robust cost.

        By 6 unknowns per scene (rotation and translation, applied on the left), then 3 per keypoint.
        """
        system = normal_equations(self.rays, self._state(scene_from_object, points_object), noise=self.noise)
        free = 6 * len(self.scenes) + points_object.size
        return system.normal[:free, :free].copy(), system.gradient[:free].copy()

    def costs(self, scene_from_object: Poses, points_object: Points) -> Float64[np.ndarray, " s"]:
        """The clicks' robust cost per scene, in squared standard deviations."""
        found = misfit(self.rays, points_in_cameras(self.rays, self._state(scene_from_object, points_object)))
        costs: Float64[np.ndarray, " s"] = np.bincount(
            self.rays.scene, weights=click_costs(found, self.noise), minlength=len(self.scenes)
        )
        return costs

    def contradiction(
        self, scene_from_object: Poses, points_object: Points, settled: Collection[str]
    ) -> Contradiction:
        """By how much the larger adjustment and the clicks contradict what is stated of both (`witnesses`).

        Args:
            settled: as for `solved`.
        """
        at_answer = cost_of(self.rays, self._state(scene_from_object, points_object), self.noise)
        at_start = cost_of(self.rays, self._state(self.scene_from_object, self.points_object), self.noise)
        return Contradiction(at_answer - at_start, len(settled))

    def solved(
        self,
        scene_from_object: Poses,
        points_object: Points,
        normal: Float64[np.ndarray, "u u"],
        *,
        settled: Collection[str] = (),
        widened: float = 1.0,
    ) -> Solution:
        """The solution at the answer of the larger adjustment.

        Its object frame is chosen anew (`object_frame`).

        Args:
            normal: the normal matrix of all terms, from which the covariances follow.
            settled: scenes in which more than the clicks speaks for the answer, so that other answers
                which fit the clicks almost as well no longer widen their covariance.
            widened: factor of all standard deviations that are stated of an unknown model
                (`Contradiction.factor`).
        """
        state, held = self._state(scene_from_object, points_object), self.known_points is not None
        fitted = click_residuals(
            self.observations, click_fit(self.rays, state, self.noise), self.solution.statements
        )
        by_click = {residual.click: residual for residual in fitted}
        residuals = tuple(by_click.get(old.click, old) for old in self.solution.residuals)
        known = self.solution.model.known
        if held:  # the covariance of a given model in a scene is dominated by the model: it stays
            placed = dict(zip(self.scenes, state.scene_from_model, strict=True))
            return replace(self.solution, scene_from_object=placed, residuals=residuals)
        inverse = inverse_normal(normal, scenes=len(self.scenes), hold_points=False)
        joint = widened**2 * with_shared_errors(inverse, self.rays, state, noise=self.noise)
        besides = self._variances_besides_clicks(settled)
        model_from_object, points = object_frame(state, known)
        turn = model_from_object[:3, :3]
        return replace(
            self.solution,
            model=replace(self.solution.model, points_object=points),
            covariance=turn.T @ shape_covariance(joint, state, known) @ turn,
            scene_from_object={
                name: pose @ model_from_object
                for name, pose in zip(self.scenes, state.scene_from_model, strict=True)
            },
            residuals=residuals,
            covariance_in_scene={
                name: points_in_scene_covariance(joint, state, s, known) + besides.get(name, 0.0)
                for s, name in enumerate(self.scenes)
            },
        )

    def _variances_besides_clicks(
        self, settled: Collection[str]
    ) -> Mapping[str, Float64[np.ndarray, "k 3 3"]]:
        """What the stated covariance of the keypoints in each scene holds that is no noise of the clicks.

        Poses that stray within a scene, of which no other term tells, and where a scene is not settled,
        other answers that fit the clicks almost as well.
        """
        start = self._state(self.scene_from_object, self.points_object)
        joint = joint_covariance(self.rays, start, noise=self.noise)
        stated, known = self.solution.covariance_in_scene, self.solution.model.known
        strayed_m = self.solution.trajectory_sigma_m
        return {
            name: strayed_m.get(name, 0.0) ** 2 * np.tile(np.eye(3), (len(known), 1, 1))
            if name in settled
            else stated[name] - points_in_scene_covariance(joint, start, s, known)
            for s, name in enumerate(self.scenes)
            if name in stated
        }

    def _state(self, scene_from_object: Poses, points_object: Points) -> State:
        return State(scene_from_object, points_object if self.known_points is None else self.known_points)


def joint_clicks(
    solution: Solution, observations: Sequence[Observation], *, hold_points: bool = False
) -> JointClicks:
    """The clicks of an object, ready for a larger adjustment.

    Args:
        observations: the lifted clicks that the solution was made of; those of other scenes are left out.
        hold_points: the keypoints are given, and only the scenes move.
    """
    scenes = tuple(sorted(solution.scene_from_object))
    known = solution.model.known
    used = tuple(o for o in observations if o.click.scene in scenes and known[o.click.keypoint])
    rays = rays_of(used, scenes, solution.trajectory_sigma_m)
    points = np.nan_to_num(solution.model.points_object)
    rays = widened_for_all_scenes(rays, State(_stacked(solution, scenes), points))
    if solution.click_sigma_px is not None and solution.depth_sigma_ratio is not None:
        noise = Noise(solution.click_sigma_px, solution.depth_sigma_ratio)
    else:
        state = State(_stacked(solution, scenes), points)
        noise = estimate_noise(rays, state, noise=USUAL, hold_points=hold_points)
    return JointClicks(solution, used, scenes, rays, noise, points if hold_points else None)


def _stacked(solution: Solution, scenes: Sequence[str]) -> Poses:
    poses: Poses = np.stack([solution.scene_from_object[name] for name in scenes])
    return poses
