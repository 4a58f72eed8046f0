"""Print and free space verify: what a scene says about a pose that shape has proposed.

A registration makes alike what it is fitted to, right or wrong. So the likeness of the print is measured
where the registration did not look: it is fitted to every other block of the object, and judged on the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Points, Transform, invert, transform
from rpl_data.refine.align import HELD, beside_model
from rpl_data.refine.evidence import cross_validated
from rpl_data.refine.registration import Poses, Registration, register_scenes
from rpl_data.refine.scene_surfaces import SceneSurface, match, print_differences
from rpl_data.segment.free_space import DepthView, seen_through

NEAR_M = 0.006
"""A point of the scene is explained by model surface this near."""


@dataclass(frozen=True)
class Candidate:
    """A pose, drawn to the scene's surface and print, and the evidence for it.

    Attributes:
        thing: number of the thing it stands for.
        scene_from_object: the pose.
        explained: share of the thing's surface that the model explains.
        free: share of the model's surface that lies in space which the cameras saw through.
        seen: share of the model's surface that was found in the scene.
        likeness: correlation of the model's print with the scene's, -1 to 1; 0 where there is none.
        normal: normal matrix of the pose (rotation, translation, applied on the left).
    """

    thing: int
    scene_from_object: Transform
    explained: float
    free: float
    seen: float
    likeness: float
    normal: Float64[np.ndarray, "6 6"]

    @property
    def score(self) -> float:
        """One number to compare candidates by: print, less what contradicts and what is left unexplained."""
        return self.likeness - 5 * self.free - (1 - self.explained)


def drawn(model: SceneSurface, scene: SceneSurface, pose: Transform) -> Registration:
    """A proposed pose, registered on surface and print without clicks; the model is the first "scene"."""
    return register_scenes([model, scene], beside_model(pose), np.empty((0, 3)), _model_held)


def judged(
    thing: int, found: Registration, model: SceneSurface, scene: SceneSurface, views: Sequence[DepthView]
) -> Candidate:
    """The evidence for a registered pose.

    Args:
        scene: asked by the points of the thing.
        views: depth images of the scene, in the scene's frame.
    """
    pose: Transform = found.scene_from_object[1]
    likeness, matched = _likeness(pose, model, scene)
    on_surface = max(int((~scene.rim[scene.asking]).sum()), 1)
    free = float(seen_through(transform(pose, model.cloud.points[model.asking]), views).mean())
    seen = len(match(model, scene, pose, gate_m=NEAR_M).asking) / max(len(model.asking), 1)
    return Candidate(thing, pose, matched / on_surface, free, seen, likeness, found.normal[6:, 6:])


def checked(candidate: Candidate, model: SceneSurface, scene: SceneSurface) -> Candidate:
    """The candidate with its likeness measured on parts that its pose was not fitted to."""
    start = beside_model(candidate.scene_from_object)
    tests = cross_validated([model, scene], start, np.empty((0, 3)), _model_held)
    found = []
    for registration, (_, held_out) in tests:
        assert held_out is not None
        found.append(_likeness(registration.scene_from_object[1], model, held_out)[0])
    return replace(candidate, likeness=float(np.mean(found)))


def _model_held(poses: Poses, points: Points) -> tuple[np.ndarray, np.ndarray]:
    """No clicks; the model stands still."""
    normal = np.zeros((12, 12))
    normal[:6, :6] = HELD * np.eye(6)
    return normal, np.zeros(12)


def _likeness(pose: Transform, model: SceneSurface, scene: SceneSurface) -> tuple[float, int]:
    """Correlation of the print where the scene's asking points found the model, and how many did."""
    matches = match(scene, model, invert(pose), gate_m=NEAR_M)
    own = scene.texture.values[scene.asking[matches.asking]]
    return _correlation(own, own + print_differences(scene, model, matches)), len(matches.asking)


def _correlation(a: Float64[np.ndarray, "m c"], b: Float64[np.ndarray, "m c"]) -> float:
    """Of all channels together, each about its mean."""
    if not a.size:
        return 0.0
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    return float((a * b).sum() / np.sqrt(max((a * a).sum() * (b * b).sum(), 1e-12)))
