"""Correct a given camera path by the images of its frames.

Given poses drift, or are wrong in fast frames, while labels depend on the relative poses of frames. So pairs
of frames with similar views are aligned by brightness and depth (`alignment`), each pair by itself, and a
pose graph combines them (`pose_graph`). Pairs with similar views that are far apart in time close loops, so
that errors do not accumulate. Keyframes are optimised first; every other frame is then aligned to the
keyframes near it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rpl_data.geometry import Pixels, Transform, invert, project, transform
from rpl_data.reconstruct.alignment import Fit, align, approach
from rpl_data.reconstruct.information import Estimate, distances_m, motion_between, moved, size_m
from rpl_data.reconstruct.model_map import Keyframe, keyframe_of
from rpl_data.reconstruct.pose_graph import KERNEL_SCALE_SIGMAS, Edge, optimise
from rpl_data.reconstruct.relocalise import keyframe_from_camera, landmarks_of
from rpl_data.reconstruct.tracking import KEYFRAME_M, PREDICTED, UNREGISTERED_TRUST, holds
from rpl_data.reconstruct.view import View
from rpl_data.types import Frame, Intrinsics, Scene, Trajectory, posed_frames

NEAR_KEYFRAMES, NEAR_FRAME = 4, 3
"""Number of keyframes that a keyframe, and any other frame, is aligned to: those with the most similar
views."""

ROUNDS = 3
SAME_START_M = 0.01
"""Pairs are aligned again, from the corrected poses, until no pose moves farther than this (or for that many
rounds): from a distant start, an alignment may stop too early."""

GIVEN = np.diag([0.02**-2] * 6)
"""Information of the given poses: 1 degree and 2 cm. It matters only where no pair of frames constrains
them."""


@dataclass(frozen=True)
class CorrectedPath:
    """A corrected path and how far the correction moved it.

    Attributes:
        trajectory: corrected poses of the frames of the given path.
        moved_px: for each frame, how far the correction moves its image (median over the surface it sees).
        tied: for each frame, whether aligned pairs connect it to the largest group of frames; where they do
            not, its pose relative to that group is the given one.
    """

    trajectory: Trajectory
    moved_px: Float64[np.ndarray, " n"]
    tied: np.ndarray

    @property
    def most_px(self) -> float:
        """90th percentile of `moved_px`."""
        return float(np.quantile(self.moved_px, 0.9)) if len(self.moved_px) else 0.0

    @property
    def share_tied(self) -> float:
        """Share of the frames that are tied."""
        return float(np.mean(self.tied)) if len(self.tied) else 0.0


def correct_path(
    scene: Scene,
    trajectory: Trajectory,
    look: Callable[[Frame], View],
    *,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> CorrectedPath:
    """Correct the poses of a scene by its own images.

    Memory grows with the space that the camera sees, not with the number of frames.

    Args:
        look: reads a frame and returns its view; called once per frame.
        advance: called with the number of frames done and of all frames.
    """
    given = dict(zip(trajectory.frames.tolist(), trajectory.scene_from_camera, strict=True))
    frames = posed_frames(scene, trajectory, with_depth=True)
    trust = 1.0 if scene.registered else UNREGISTERED_TRUST
    keys = choose_keyframes([given[frame.index] for frame in frames])
    moved_px: dict[int, float] = {}
    tied: dict[int, bool] = {}

    views = {frames[row].index: look(frames[row]) for row in keys}
    keyframes = {index: keyframe_of(index, view, given[index]) for index, view in views.items()}
    for _ in range(ROUNDS):
        edges = _keyframe_edges(keyframes, views, trust)
        found = optimise({index: given[index] for index in keyframes}, edges, prior=GIVEN)
        far = [motion_between(keyframes[index].scene_from_camera, found[index]) for index in keyframes]
        if max(map(size_m, far), default=0.0) < SAME_START_M:
            break
        keyframes = {k: replace(frame, scene_from_camera=found[k]) for k, frame in keyframes.items()}
    joined = largest_piece(list(keyframes), edges)
    for number, (index, view) in enumerate(views.items()):
        advance(number, len(frames))
        tied[index] = index in joined
        moved_px[index] = _moved_px(scene.intrinsics, view, invert(found[index]) @ given[index])
    del views

    known = dict(found)
    for frame in frames:
        if frame.index in known:
            continue
        advance(len(found), len(frames))
        view = look(frame)
        pose, aligned_to = _align_between(view, given, frame.index, keyframes, known, trust)
        found[frame.index], tied[frame.index] = pose, bool(aligned_to & joined)
        moved_px[frame.index] = _moved_px(scene.intrinsics, view, invert(pose) @ given[frame.index])

    for index in given.keys() - found.keys():  # a frame without depth moves as the nearest one that has it
        nearest = min(found, key=lambda other: abs(other - index), default=None)
        found[index] = (
            given[index] if nearest is None else found[nearest] @ invert(given[nearest]) @ given[index]
        )
        moved_px[index], tied[index] = moved_px.get(nearest, 0.0) if nearest is not None else 0.0, False
    order = sorted(found)
    return CorrectedPath(
        Trajectory(np.array(order, dtype=np.int64), np.array([found[i] for i in order]).reshape(-1, 4, 4)),
        np.array([moved_px[i] for i in order], dtype=float),
        np.array([tied[i] for i in order], dtype=bool),
    )


def choose_keyframes(poses: Sequence[Transform]) -> list[int]:
    """Choose as keyframes the poses (by row) whose view differs from that of every keyframe before."""
    chosen: list[int] = []
    for row, pose in enumerate(poses):
        if not chosen or distances_m(np.array([poses[k] for k in chosen]), pose).min() > KEYFRAME_M:
            chosen.append(row)
    return chosen


def largest_piece(frames: Sequence[int], edges: Sequence[Edge]) -> set[int]:
    """The largest group of frames that edges connect, directly or through others."""
    row = {frame: number for number, frame in enumerate(frames)}
    pairs = np.array([(row[edge.first], row[edge.second]) for edge in edges], dtype=int).reshape(-1, 2)
    ones, size = np.ones(len(pairs)), len(frames)
    _, piece = connected_components(coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(size, size)))
    largest = np.bincount(piece).argmax() if size else -1
    return {frame for frame in frames if piece[row[frame]] == largest}


def _keyframe_edges(keyframes: Mapping[int, Keyframe], views: Mapping[int, View], trust: float) -> list[Edge]:
    """Align every keyframe to those with the most similar views and to the next; drop failures."""
    order = list(keyframes)
    poses = np.array([keyframes[index].scene_from_camera for index in order])
    edges = []
    for row, index in enumerate(order):
        nearest = np.argsort(distances_m(poses, poses[row]))
        chosen = [order[k] for k in nearest if k != row][:NEAR_KEYFRAMES]
        if row + 1 < len(order) and order[row + 1] not in chosen:
            chosen.append(order[row + 1])
        for other in chosen:
            edge = _edge(views[index], index, keyframes[other], poses[row], trust)
            if edge is not None:
                edges.append(edge)
    return edges


def _edge(view: View, index: int, keyframe: Keyframe, guess: Transform, trust: float) -> Edge | None:
    """Align a frame to a keyframe; None where the fit does not hold.

    Args:
        guess: `scene_from_camera` of the frame, with the keyframe at its own pose.
    """
    fit = _aligned(view, keyframe, guess, trust)
    if not holds(fit):
        start = keyframe_from_camera(view.levels[0], landmarks_of(view.levels[0]), keyframe.landmarks)
        if start is None:
            return None
        fit = _aligned(view, keyframe, keyframe.scene_from_camera @ start, trust)
        if not holds(fit):
            return None
    relative = invert(keyframe.scene_from_camera) @ fit.estimate.scene_from_camera
    return Edge(keyframe.index, index, relative, fit.estimate.information)


def _aligned(view: View, keyframe: Keyframe, start: Transform, trust: float) -> Fit:
    prior = Estimate(start, PREDICTED)
    return align(view, keyframe, approach(view, keyframe, start, prior), prior, color_trust=trust)


def _align_between(
    view: View,
    given: Mapping[int, Transform],
    index: int,
    keyframes: Mapping[int, Keyframe],
    known: Mapping[int, Transform],
    trust: float,
) -> tuple[Transform, set[int]]:
    """Align a frame to keyframes with known poses; return its pose, and which keyframes were used."""
    order = list(keyframes)
    at_given = np.array([given[key] for key in order])
    nearest = [order[k] for k in np.argsort(distances_m(at_given, given[index]))[:NEAR_FRAME]]
    guess = known[nearest[0]] @ invert(given[nearest[0]]) @ given[index]
    edges = []
    for key in nearest:
        # The pose stored in a keyframe may differ from its known one, so only relative poses are used.
        relative = invert(known[key]) @ guess
        edge = _edge(view, index, keyframes[key], keyframes[key].scene_from_camera @ relative, trust)
        if edge is not None:
            edges.append(edge)
    return _between(guess, edges, known), {edge.first for edge in edges}


def _between(guess: Transform, edges: Sequence[Edge], known: Mapping[int, Transform]) -> Transform:
    """The pose that agrees best with edges to known poses."""
    pose = guess
    for _ in range(6):
        normal, pull = GIVEN.copy(), GIVEN @ motion_between(pose, guess)
        for edge in edges:
            error = motion_between(invert(known[edge.first]) @ pose, edge.first_from_second)
            weight = 1 / (1 + error @ edge.information @ error / KERNEL_SCALE_SIGMAS**2)
            normal = normal + weight * edge.information
            pull = pull + weight * edge.information @ error
        pose = pose @ moved(np.linalg.solve(normal, pull))
    return pose


def _moved_px(intrinsics: Intrinsics, view: View, new_from_old: Transform) -> float:
    """Median distance in the image by which a change of the pose moves the surface that the frame sees."""
    points = view.points[:: max(1, len(view.points) // 200)]
    before: Pixels = project(intrinsics, points)
    steps_px = np.linalg.norm(project(intrinsics, transform(new_from_old, points)) - before, axis=1)
    steps_px = steps_px[np.isfinite(steps_px)]
    return float(np.median(steps_px)) if len(steps_px) else 0.0
