"""Shape proposes: every orientation of the model is laid on a thing and drawn to it, all at once.

Thing to model, point to plane (Chen and Medioni 1992), with the nearest point of the model read from a grid:
no correspondences are guessed, so round and plain shapes are as welcome as others. Poses that a shape cannot
tell apart all come back; print and free space tell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rpl_data.geometry import invert, transform_all
from rpl_data.meshes import thinned
from rpl_data.segment.region_growing import Plane
from rpl_data.types import PointCloud

CELL_M = 0.004
BESIDE_M = 0.03
"""The grid reaches this far beyond the model."""
ORIENTATIONS = 700
"""Orientations tried: about 23 degrees apart."""
ASKED = 120
"""Points of a thing that are compared."""
FIRST_STEPS, LAST_STEPS = 5, 10
KEPT = 120
"""Poses that are drawn to the end."""
FAR_M = 0.005
"""A point of the thing this far from the model disagrees wholly."""

Poses = Float64[np.ndarray, "h 4 4"]


@dataclass(frozen=True)
class Field:
    """The model, with the nearest of its points for every cell of space around it.

    Attributes:
        cloud: thinned points of the model, object frame.
        nearest: number of the nearest point, per cell.
        low: centre of the first cell.
    """

    cloud: PointCloud
    nearest: Int64[np.ndarray, "x y z"]
    low: Float64[np.ndarray, "3"]

    @staticmethod
    def of(model: PointCloud) -> Field:
        """Make the field of a model."""
        cloud = thinned(model, voxel_m=CELL_M)
        low = cloud.points.min(axis=0) - BESIDE_M
        size = np.ceil((np.ptp(cloud.points, axis=0) + 2 * BESIDE_M) / CELL_M).astype(int)
        cells = np.indices(size).reshape(3, -1).T * CELL_M + low
        return Field(cloud, cKDTree(cloud.points).query(cells)[1].reshape(size).astype(np.int64), low)

    def at(self, points: Float64[np.ndarray, "*b 3"]) -> Int64[np.ndarray, "*b"]:
        """Number of the model's point nearest to each point; beyond the grid, that of its border."""
        cell = np.rint((points - self.low) / CELL_M).astype(np.int64)
        cell = np.clip(cell, 0, np.array(self.nearest.shape) - 1)
        found: Int64[np.ndarray, "*b"] = self.nearest[cell[..., 0], cell[..., 1], cell[..., 2]]
        return found


class Proposals(NamedTuple):
    """Poses of the model on a thing, best first.

    Attributes:
        disagreement: 0 to 1, mean over the thing's points.
    """

    scene_from_object: Poses
    disagreement: Float64[np.ndarray, " h"]


def poses_by_shape(field: Field, thing: PointCloud, support: Plane, *, seed: int = 0) -> Proposals:
    """Poses in which the model explains a thing's shape.

    Args:
        thing: scene frame.
        support: the plane that the thing stands on; poses start with the model standing on it.
    """
    generator = np.random.default_rng(seed)
    chosen = generator.permutation(len(thing.points))[:ASKED]
    points, normals = thing.points[chosen], thing.normals[chosen]
    object_from_scene = invert(_standing(field.cloud.points, thing.points, support))
    for step in range(FIRST_STEPS):
        object_from_scene = _drawn(field, object_from_scene, points, normals, 0.02 - 0.003 * step)
    cost = _disagreement(field, object_from_scene, points, normals, FAR_M * 2)
    object_from_scene = object_from_scene[np.argsort(cost)[:KEPT]]
    for _ in range(LAST_STEPS):
        object_from_scene = _drawn(field, object_from_scene, points, normals, 0.006)
    cost = _disagreement(field, object_from_scene, points, normals, FAR_M)
    order = np.argsort(cost)
    return Proposals(invert(object_from_scene[order]), cost[order])


def orientations(count: int) -> Float64[np.ndarray, "h 3 3"]:
    """Evenly spread rotations: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    s = np.arange(count) + 0.5
    one, other = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    near, far = np.sqrt(s / count), np.sqrt(1 - s / count)
    quaternions = np.column_stack(
        [near * np.sin(one), near * np.cos(one), far * np.sin(other), far * np.cos(other)]
    )
    rotations: Float64[np.ndarray, "h 3 3"] = Rotation.from_quat(quaternions).as_matrix()
    return rotations


def _standing(model: Float64[np.ndarray, "n 3"], thing: Float64[np.ndarray, "m 3"], support: Plane) -> Poses:
    """The model in all orientations, standing on the support, in the middle of the thing's outline."""
    axes = np.linalg.svd(support.normal[None])[2]  # up or down, then two along the plane
    axes[0] = support.normal
    turned = orientations(ORIENTATIONS)
    spread = np.einsum("hij,nj->hni", axes @ turned, model)
    low, high = spread.min(axis=1), spread.max(axis=1)
    there = thing @ axes.T
    target = (there.min(axis=0) + there.max(axis=0)) / 2 - (low + high) / 2
    target[:, 0] = support.offset_m - low[:, 0]
    poses = np.tile(np.eye(4), (len(turned), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turned, target @ axes
    return poses


def _compared(
    field: Field,
    poses: Poses,
    points: Float64[np.ndarray, "p 3"],
    normals: Float64[np.ndarray, "p 3"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points in the object frame, the model's normals there, offsets from it, and whether normals agree."""
    there = transform_all(poses, points)
    nearest = field.at(there)
    slope = field.cloud.normals[nearest]
    offset = there - field.cloud.points[nearest]
    facing = np.einsum("hij,pj->hpi", poses[:, :3, :3], normals)
    same_way = (facing * slope).sum(axis=2) > 0.5
    return there, slope, offset, same_way


def _drawn(
    field: Field,
    poses: Poses,
    points: Float64[np.ndarray, "p 3"],
    normals: Float64[np.ndarray, "p 3"],
    scale_m: float,
) -> Poses:
    """One robust Gauss-Newton step of all poses (object_from_scene)."""
    there, slope, offset, same_way = _compared(field, poses, points, normals)
    before = (offset * slope).sum(axis=2)
    squared = (offset**2).sum(axis=2) / scale_m**2
    weight = np.where(same_way, 1, 0.1) / (1 + squared) ** 2
    jacobian = np.concatenate([np.cross(there, slope), slope], axis=2)
    weighted = jacobian * weight[..., None]
    normal = np.swapaxes(weighted, 1, 2) @ jacobian
    gradient = (weighted * before[..., None]).sum(axis=1)
    ridge = 1e-3 * np.trace(normal, axis1=1, axis2=2)[:, None, None] / 6 * np.diag([0.01] * 3 + [1.0] * 3)
    step = np.linalg.solve(normal + ridge + 1e-12 * np.eye(6), -gradient[..., None])[..., 0]
    moves = np.tile(np.eye(4), (len(poses), 1, 1))
    turn = step[:, :3]
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    moves[:, :3, :3] = Rotation.from_rotvec(turn * np.minimum(1, 0.3 / np.maximum(length, 1e-9))).as_matrix()
    moves[:, :3, 3] = np.clip(step[:, 3:], -0.02, 0.02)
    drawn: Poses = moves @ poses
    return drawn


def _disagreement(
    field: Field,
    poses: Poses,
    points: Float64[np.ndarray, "p 3"],
    normals: Float64[np.ndarray, "p 3"],
    far_m: float,
) -> Float64[np.ndarray, " h"]:
    _, _, offset, same_way = _compared(field, poses, points, normals)
    squared = (offset**2).sum(axis=2) / far_m**2
    each = np.where(same_way, np.minimum(squared, 1), 1)
    mean: Float64[np.ndarray, " h"] = each.mean(axis=1)
    return mean
