"""A known object found in a scene: shape proposes, print and free space verify."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rpl_data.geometry import Points, Transform, transform, transform_all
from rpl_data.meshes import joined
from rpl_data.place.shape import Field, poses_by_shape
from rpl_data.place.things import things_on_support, windows
from rpl_data.place.verify import Candidate, checked, drawn, judged
from rpl_data.refine.scene_surfaces import SceneSurface, scene_surface
from rpl_data.segment.free_space import DepthView, seen_through
from rpl_data.segment.region_growing import Plane
from rpl_data.types import PointCloud

LARGEST, SMALLEST = 1.2, 0.4
"""Sizes that a thing may have, as shares of the model's: larger ones are looked at in parts."""
WORST_SHAPE = 0.6
"""A thing whose shape disagrees more is not the object."""
MOST_FREE = 0.1
"""A proposal with more of the model's surface in free space is dropped."""
MARGIN_M = 0.012
"""By how much a depth image must see through a point of a proposal, which is a few millimetres off."""
PROPOSED_PX, CLICK_PX = 45.0, 15.0
"""A pose agrees with a click that it misses by less, before and after it is drawn to the surface."""
DRAWN = 24
"""Proposals that are drawn to surface and print."""
CHECKED = 4
"""Candidates whose print is measured on held-out parts."""
APART_M = 0.01
"""Poses that move the surface by less than this (root mean square) are the same."""


class _Proposal(NamedTuple):
    """A pose that shape proposes for a thing; the lower the cost, the better."""

    cost: float
    thing: int
    pose: Transform


def candidates_in(
    model: PointCloud,
    surface: PointCloud,
    cameras: Points,
    views: Sequence[DepthView],
    *,
    off_clicks_px: Callable[[Transform], float] = lambda pose: 0.0,
    proposed: Sequence[Transform] = (),
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> list[Candidate]:
    """Where a known object could stand in a scene, the likeliest first, each with its evidence.

    Args:
        model: the object's surface, object frame.
        surface: points of the scene near what the cameras look at, scene frame.
        cameras: centres of the cameras, scene frame.
        views: depth images, in the scene's frame.
        off_clicks_px: by how much a pose misses the farthest click; 0 without clicks.
        proposed: poses to look at first, beside those that shape proposes.
        advance: receives how many of the proposed poses have been looked at.
    """
    things = things_on_support(surface, cameras)
    size_m = _diameter_m(model)
    whole = [] if things is None else things.clouds
    parts = [p for t in whole for p in (windows(t, size_m) if _diameter_m(t) > LARGEST * size_m else [t])]
    clouds = [part for part in parts if SMALLEST * size_m < _diameter_m(part) < LARGEST * size_m]
    if things is None or not clouds:
        return []
    given = [_Proposal(-np.inf, _nearest(clouds, transform(pose, model.points)), pose) for pose in proposed]
    by_shape = _proposals(model, clouds, things.plane, views)
    near = [one for one in (*given, *by_shape) if off_clicks_px(one.pose) < PROPOSED_PX]
    proposals = _distinct_proposals(near, model)
    if not proposals:
        return []
    seen_model, seen = scene_surface(model), scene_surface(joined(whole))
    asked = [_asked_by(seen, cloud) for cloud in clouds]
    found = []
    for done, one in enumerate(proposals):
        advance(done, len(proposals))
        registered = drawn(seen_model, asked[one.thing], one.pose)
        found.append(judged(one.thing, registered, seen_model, asked[one.thing], views))
    agreed = [one for one in found if off_clicks_px(one.scene_from_object) < CLICK_PX]
    best = distinct(sorted(agreed, key=lambda one: -one.score), model)[:CHECKED]
    return sorted((checked(one, seen_model, asked[one.thing]) for one in best), key=lambda one: -one.score)


def _proposals(
    model: PointCloud, things: Sequence[PointCloud], support: Plane, views: Sequence[DepthView]
) -> list[_Proposal]:
    """Poses on all things by shape, where the cameras did not see through the model."""
    field, few = Field.of(model), _some(model, 150)
    proposals: list[_Proposal] = []
    for number, thing in enumerate(things):
        poses, disagreement = poses_by_shape(field, thing, support)
        there = transform_all(poses, few)
        through = seen_through(there.reshape(-1, 3), views, margin_m=MARGIN_M)
        free = through.reshape(there.shape[:2]).mean(axis=1)
        possible = (free < MOST_FREE) & (disagreement < WORST_SHAPE)
        proposals += [
            _Proposal(float(disagreement[n] + 2 * free[n]), number, poses[n])
            for n in np.flatnonzero(possible)
        ]
    return proposals


def _nearest(things: Sequence[PointCloud], points: Points) -> int:
    """Number of the thing whose middle is nearest to that of some points."""
    middle = points.mean(axis=0)
    return int(np.argmin([np.linalg.norm(thing.points.mean(axis=0) - middle) for thing in things]))


def _distinct_proposals(proposals: Sequence[_Proposal], model: PointCloud) -> list[_Proposal]:
    """The best ones, no two alike."""
    kept: list[_Proposal] = []
    for one in sorted(proposals, key=lambda one: one.cost):
        if all(apart_m(model, one.pose, other.pose) > APART_M for other in kept):
            kept.append(one)
        if len(kept) == DRAWN:
            break
    return kept


def distinct(candidates: Sequence[Candidate], model: PointCloud) -> list[Candidate]:
    """Candidates in their order, without those that repeat an earlier one."""
    kept: list[Candidate] = []
    for one in candidates:
        if all(apart_m(model, one.scene_from_object, other.scene_from_object) > APART_M for other in kept):
            kept.append(one)
    return kept


def apart_m(model: PointCloud, one: Transform, other: Transform) -> float:
    """How far two poses put the model's surface apart, root mean square."""
    points = _some(model, 100)
    return float(np.sqrt(((transform(one, points) - transform(other, points)) ** 2).sum(axis=1).mean()))


def _some(cloud: PointCloud, count: int) -> Points:
    """About so many of the points, spread over the cloud."""
    return cloud.points[:: max(1, len(cloud.points) // count)]


def _diameter_m(cloud: PointCloud) -> float:
    return float(2 * np.linalg.norm(cloud.points - cloud.points.mean(axis=0), axis=1).max())


def _asked_by(scene: SceneSurface, thing: PointCloud) -> SceneSurface:
    """The scene's surface, of which only a thing's points ask."""
    distance, _ = cKDTree(thing.points).query(scene.cloud.points[scene.asking])
    return scene.asked_by(distance < 1e-6)
