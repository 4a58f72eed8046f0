"""The clicks as one part of a larger adjustment, and its answer as a solution.

The refine stage puts the scenes' surfaces into the same normal matrix as the clicks (paper Eq. 2). What it
needs of the clicks, and what becomes of them at its answer, is here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.solve.bundle_adjustment import (
    LET_GO,
    Bundle,
    Rays,
    _describe,
    _residuals,
    _shown_sigma_px,
    _weighted_system,
    rays_of,
)
from rpl_data.solve.residuals import click_residuals
from rpl_data.solve.solve import _solution
from rpl_data.types import ClickResidual, Observation, Solution


@dataclass(frozen=True)
class JointClicks:
    """The clicks of an object at its solution.

    Attributes:
        scenes: names, in the order of the unknowns.
        known_points: the keypoints when they are given and only the scenes move; else None.
    """

    solution: Solution
    observations: tuple[Observation, ...]
    scenes: tuple[str, ...]
    rays: Rays
    sigma_px: float
    known_points: Float64[np.ndarray, "k 3"] | None

    @property
    def scene_from_object(self) -> Float64[np.ndarray, "s 4 4"]:
        """The click solution, one pose per scene."""
        return _stacked(self.solution, self.scenes)

    @property
    def points_object(self) -> Float64[np.ndarray, "k 3"]:
        """The keypoints that are unknowns, 0 for those never clicked; none when they are given."""
        if self.known_points is not None:
            return np.empty((0, 3))
        points: Float64[np.ndarray, "k 3"] = np.nan_to_num(self.solution.model.points_object)
        return points

    def terms(
        self, scene_from_object: Float64[np.ndarray, "s 4 4"], points_object: Float64[np.ndarray, "k 3"]
    ) -> tuple[Float64[np.ndarray, "u u"], Float64[np.ndarray, " u"]]:
        """The normal matrix and the gradient of the clicks' robust cost.

        By 6 unknowns per scene (rotation and translation, applied on the left), then 3 per keypoint.
        """
        points = self._points(points_object)
        jacobian, residual, _ = _weighted_system(
            self.rays, scene_from_object, points, sigma_px=self.sigma_px, let_go=LET_GO
        )
        free = jacobian[:, : 6 * len(self.scenes) + points_object.size]
        return free.T @ free, free.T @ residual

    def costs(
        self, scene_from_object: Float64[np.ndarray, "s 4 4"], points_object: Float64[np.ndarray, "k 3"]
    ) -> Float64[np.ndarray, " s"]:
        """The clicks' robust cost per scene, in squared standard deviations."""
        in_camera, lateral_px, depth_m, depth_sigma_m = _residuals(
            self.rays, scene_from_object, self._points(points_object)
        )
        depth = np.nan_to_num((in_camera[:, 2] - depth_m) / depth_sigma_m)
        squared = np.column_stack([((lateral_px / self.sigma_px) ** 2).sum(axis=1), depth**2])
        cost = (squared / (1 + squared / LET_GO**2)).sum(axis=1)
        costs: Float64[np.ndarray, " s"] = np.bincount(
            self.rays.scene, weights=cost, minlength=len(self.scenes)
        )
        return costs

    def solved(
        self,
        scene_from_object: Float64[np.ndarray, "s 4 4"],
        points_object: Float64[np.ndarray, "k 3"],
        normal: Float64[np.ndarray, "u u"],
    ) -> Solution:
        """The solution at the answer of the larger adjustment; its object frame is chosen anew.

        Args:
            normal: the normal matrix of all terms, from which the covariance follows.
        """
        bundle = _describe(self.rays, scene_from_object, self._points(points_object), sigma_px=self.sigma_px)
        model = self.solution.model
        if self.known_points is not None:
            return replace(
                self.solution,
                scene_from_object=dict(zip(self.scenes, scene_from_object, strict=True)),
                residuals=self._residuals(bundle),
            )
        found = _solution(
            model.name,
            model.keypoints,
            model.skeleton,
            self.scenes,
            self.observations,
            bundle._replace(normal=normal),
            model.known,
        )
        return replace(found, warnings=self.solution.warnings)

    def _points(self, points_object: Float64[np.ndarray, "k 3"]) -> Float64[np.ndarray, "k 3"]:
        return points_object if self.known_points is None else self.known_points

    def _residuals(self, bundle: Bundle) -> tuple[ClickResidual, ...]:
        return click_residuals(self.observations, bundle, self.solution.model.keypoints)


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
    rays = rays_of(used, scenes)
    points = np.nan_to_num(solution.model.points_object)
    poses = _stacked(solution, scenes)
    sigma_px = _shown_sigma_px(rays, poses, points)
    return JointClicks(solution, used, scenes, rays, sigma_px, points if hold_points else None)


def _stacked(solution: Solution, scenes: Sequence[str]) -> Float64[np.ndarray, "s 4 4"]:
    poses: Float64[np.ndarray, "s 4 4"] = np.stack([solution.scene_from_object[name] for name in scenes])
    return poses
