"""Whether the best candidate is believed, and which click would tell where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from rpl_data.geometry import NEAREST_M, Pixels, Points, Transform, inside_image, invert, project, transform
from rpl_data.place.verify import Candidate
from rpl_data.types import Intrinsics, KeypointModel, Observation, PointCloud, Trajectory

LEAST_SCORE, LEAST_SCORE_CLICKED = 0.35, 0.2
"""Score from which a candidate can be believed, without and with a click that agrees."""
LEAST_CLEAR = 0.12
"""By how much its score must exceed that of any other candidate."""
MOST_FREE = 0.03
"""Share of the model's surface that may lie where the cameras saw through."""
LEAST_SEEN = 0.15
"""Share of the model's surface that must be found in the scene: little of it proves nothing."""
AROUND = 12
"""Points of the surface around a keypoint, which mostly lies on an edge: one must face the camera."""


class Ask(NamedTuple):
    """A click that would tell the candidates apart.

    Attributes:
        apart_px: by how much the two best put the keypoint apart there.
    """

    frame: int
    keypoint: int
    apart_px: float


@dataclass(frozen=True)
class Decision:
    """What is believed.

    Attributes:
        chosen: the best candidate; None when nothing came near.
        sure: whether it is believed.
        words: how sure, and why not, for a person.
    """

    chosen: Candidate | None
    sure: bool
    words: str


def decide(candidates: Sequence[Candidate], *, clicked: bool = False) -> Decision:
    """Believe the best candidate, or not.

    Args:
        candidates: best first; all that disagree with clicks left out.
        clicked: whether there were clicks.
    """
    if not candidates:
        return Decision(None, False, "no pose explains what stands there")
    best = candidates[0]
    rival = candidates[1].score if len(candidates) > 1 else -1.0
    needed = LEAST_SCORE_CLICKED if clicked else LEAST_SCORE
    words = (
        f"score {best.score:.2f} (at least {needed} needed): its colours agree to {best.likeness:.2f}, "
        f"{best.free:.1%} of its surface lies where the cameras saw through, {1 - best.explained:.0%} of "
        "what stands there is not explained"
    )
    if best.score < needed or best.free > MOST_FREE or best.seen < LEAST_SEEN:
        return Decision(best, False, f"the best pose is not good enough: {words}")
    if best.score - rival < LEAST_CLEAR:
        return Decision(best, False, f"two poses are nearly as good: scores {best.score:.2f} and {rival:.2f}")
    others = "no other pose comes near" if len(candidates) < 2 else f"the next best pose scores {rival:.2f}"
    return Decision(best, True, f"{words}; {others}")


def off_px(scene_from_object: Transform, model: KeypointModel, click: Observation) -> float:
    """How far a pose puts a keypoint from its click.

    Infinite behind the camera; 0 for a keypoint that the model has no position of.
    """
    point = model.points_object[click.click.keypoint]
    if not np.isfinite(point).all():
        return 0.0
    x, y, z = transform(invert(click.scene_from_camera) @ scene_from_object, point[None])[0]
    if z < NEAREST_M:
        return float("inf")
    return float(np.linalg.norm(np.array([x, y]) / z - click.ray_camera[:2]) / click.pixel_rad)


def click_to_ask(
    candidates: Sequence[Candidate],
    model: KeypointModel,
    surface: PointCloud,
    intrinsics: Intrinsics,
    trajectory: Trajectory,
) -> Ask | None:
    """The frame and keypoint that tell the two best candidates apart most; None without candidates.

    Args:
        surface: the object's surface, object frame; a keypoint counts as seen where its surface faces the
            camera.
    """
    if not candidates:
        return None
    known = np.flatnonzero(model.known)
    around = cKDTree(surface.points).query(model.points_object[known], k=AROUND)[1]
    normals = surface.normals[around]
    best: Ask | None = None
    for frame, scene_from_camera in zip(trajectory.frames, trajectory.scene_from_camera, strict=True):
        camera_from_scene = invert(scene_from_camera)
        places = [
            _shown(camera_from_scene @ one.scene_from_object, model.points_object[known], normals, intrinsics)
            for one in candidates[:2]
        ]
        apart = np.linalg.norm(places[0] - places[-1], axis=1) if len(places) > 1 else 0 * places[0][:, 0]
        for k in np.flatnonzero(np.isfinite(places[0]).all(axis=1)):
            gap = float(apart[k]) if np.isfinite(apart[k]) else 0.0
            if best is None or gap > best.apart_px:
                best = Ask(int(frame), int(known[k]), gap)
    return best


def _shown(
    camera_from_object: Transform,
    points: Points,
    normals: Float64[np.ndarray, "n a 3"],
    intrinsics: Intrinsics,
) -> Pixels:
    """Pixels of keypoints; NaN where all surface around one faces away, or the image ends."""
    in_camera = transform(camera_from_object, points)
    facing = ((normals @ camera_from_object[:3, :3].T * in_camera[:, None]).sum(axis=2) < 0).any(axis=1)
    pixels = project(intrinsics, in_camera)
    pixels[~(facing & inside_image(intrinsics, pixels))] = np.nan
    return pixels
