"""Closed-form start: scenes are joined to a growing model one after another.

The scene that shares most keypoints with the model is joined next, by the rigid transform of a
triple of keypoints that most others agree with (RANSAC, Fischler & Bolles 1981). A keypoint may have
several hypotheses of where it is, in the model and in the scene; a transform is judged by the best
pair of each keypoint, which is how wrong depths are found before they can do harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import fit_rigid, invert, is_collinear, transform
from rpl_data.solve.procrustes import Fragments, kabsch_stack

Hypotheses = dict[int, Float64[np.ndarray, "_ 3"]]
"""By keypoint, candidate positions of it, most likely first."""

AGREE_M = 0.015
"""Two hypotheses closer than this are the same position."""
LINE_M = 0.004
"""Points whose spread across their main direction is less lie on a line."""


class Start(NamedTuple):
    """What the start found: one transform per joined scene, and one point per scene and keypoint.

    Attributes:
        scene_from_model: None for a scene that could not be joined by itself.
    """

    scene_from_model: list[Float64[np.ndarray, "4 4"] | None]
    fragments: Fragments


def join_scenes(
    scenes: Sequence[Hypotheses], keypoints: int, *, samples: int = 400, first_rank: int = 0
) -> Start:
    """Join all scenes that share at least three keypoints with the model grown so far.

    Args:
        samples: triples of keypoints drawn for each scene.
        first_rank: which scene to begin with: 0 the best connected, 1 the next, ...
    """
    random = np.random.default_rng(0)
    first = sorted(range(len(scenes)), key=lambda s: _connectedness(scenes, s), reverse=True)[first_rank]
    model: Hypotheses = dict(scenes[first])
    transforms: list[Float64[np.ndarray, "4 4"] | None] = [None] * len(scenes)
    transforms[first] = np.eye(4)
    waiting = set(range(len(scenes))) - {first}
    while waiting:
        scene = max(waiting, key=lambda s: (len(model.keys() & scenes[s].keys()), -s))
        waiting.remove(scene)
        joined = match(model, scenes[scene], samples=samples, random=random)
        if joined is None:
            continue
        transforms[scene] = joined
        model = _merge(model, scenes[scene], invert(joined))
    return Start(transforms, choose_fragments(scenes, transforms, model, keypoints))


def join_clean(fragments: Fragments) -> list[Float64[np.ndarray, "4 4"] | None]:
    """Transforms when every point can be believed: each scene fitted to all it shares (no RANSAC)."""
    points, clicked = fragments
    seen = clicked > 0
    shared = seen.astype(int) @ seen.T.astype(int)
    first = int(shared.sum(axis=1).argmax())
    transforms: list[Float64[np.ndarray, "4 4"] | None] = [None] * len(points)
    transforms[first], model, known = np.eye(4), points[first].copy(), seen[first].copy()
    waiting = set(range(len(points))) - {first}
    while waiting:
        scene = max(waiting, key=lambda s: int((seen[s] & known).sum()))
        waiting.remove(scene)
        both = seen[scene] & known
        if both.sum() < 3 or is_collinear(points[scene][both], tolerance_m=LINE_M):
            continue
        joined = fit_rigid(points[scene][both], model[both])
        transforms[scene] = joined
        new = seen[scene] & ~known
        model[new], known = transform(invert(joined), points[scene][new]), known | seen[scene]
    return transforms


def _connectedness(scenes: Sequence[Hypotheses], s: int) -> tuple[int, int]:
    shared = [len(scenes[s].keys() & other.keys()) for i, other in enumerate(scenes) if i != s]
    return sum(n >= 3 for n in shared) * 100 + sum(shared), -s


def match(
    model: Hypotheses, scene: Hypotheses, *, samples: int, random: np.random.Generator
) -> Float64[np.ndarray, "4 4"] | None:
    """`scene_from_model` that most shared keypoints agree with; None with fewer than three."""
    shared = sorted(model.keys() & scene.keys())
    if len(shared) < 3:
        return None
    padded_model, padded_scene = _padded(model, shared), _padded(scene, shared)
    poses = kabsch_of_triples(model, scene, shared, samples=samples, random=random)
    if not len(poses):
        return None
    distances = _best_pair_distances(poses, padded_model, padded_scene)
    best = int(np.minimum(distances / AGREE_M, 1).sum(axis=1).argmin())
    return _polish(poses[best], padded_model, padded_scene)


def kabsch_of_triples(
    model: Hypotheses,
    scene: Hypotheses,
    shared: list[int],
    *,
    samples: int,
    random: np.random.Generator,
) -> Float64[np.ndarray, "b 4 4"]:
    """`scene_from_model` of random triples of shared keypoints whose triangles are congruent."""
    padded_model, padded_scene = _padded(model, shared), _padded(scene, shared)
    triples, picks_model, picks_scene = _draw_triples(padded_model, padded_scene, samples, random)
    corners_model = padded_model[triples, picks_model]
    corners_scene = padded_scene[triples, picks_scene]
    usable = _congruent(corners_model, corners_scene)
    corners_model, corners_scene = corners_model[usable], corners_scene[usable]
    return kabsch_stack(corners_model, corners_scene, np.ones(corners_model.shape[:2]))


def _padded(hypotheses: Hypotheses, shared: list[int]) -> Float64[np.ndarray, "_ _ 3"]:
    """A dense array; a keypoint with fewer hypotheses repeats its first."""
    most = max(len(hypotheses[k]) for k in shared)
    return np.stack(
        [hypotheses[k][[*range(len(hypotheses[k])), *[0] * (most - len(hypotheses[k]))]] for k in shared]
    )


def _draw_triples(
    model: Float64[np.ndarray, "n h 3"],
    scene: Float64[np.ndarray, "n g 3"],
    samples: int,
    random: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keypoint triples and hypotheses of each; the first hypotheses are drawn half of the time."""
    n = len(model)
    triples = random.random((samples, n)).argsort(axis=1)[:, :3]
    likely = random.random((samples, 3)) < 0.5
    picks_model = np.where(likely, 0, random.integers(0, model.shape[1], (samples, 3)))
    picks_scene = np.where(likely, 0, random.integers(0, scene.shape[1], (samples, 3)))
    return triples, picks_model, picks_scene


def _congruent(a: Float64[np.ndarray, "b 3 3"], b: Float64[np.ndarray, "b 3 3"]) -> np.ndarray:
    """Triangles with equal sides (within the tolerance) that are not slivers."""
    sides_a = np.linalg.norm(a - np.roll(a, 1, axis=1), axis=2)
    sides_b = np.linalg.norm(b - np.roll(b, 1, axis=1), axis=2)
    equal = (np.abs(sides_a - sides_b) < 2 * AGREE_M).all(axis=1)
    doubled_area = np.linalg.norm(np.cross(b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]), axis=1)
    wide: np.ndarray = equal & (doubled_area / np.maximum(sides_b.max(axis=1), 1e-9) > 2 * LINE_M)
    return wide


def _best_pair_distances(
    candidates: Float64[np.ndarray, "b 4 4"],
    model: Float64[np.ndarray, "n h 3"],
    scene: Float64[np.ndarray, "n g 3"],
) -> Float64[np.ndarray, "b n"]:
    """For each candidate and keypoint, how far apart its nearest two hypotheses come to lie."""
    moved = model @ candidates[:, None, :3, :3].swapaxes(2, 3) + candidates[:, None, None, :3, 3]
    apart = moved[:, :, :, None] - scene[None, :, None]
    squared = apart[..., 0] ** 2 + apart[..., 1] ** 2 + apart[..., 2] ** 2
    nearest: Float64[np.ndarray, "b n"] = np.sqrt(squared.min(axis=(2, 3)))
    return nearest


def _polish(
    scene_from_model: Float64[np.ndarray, "4 4"],
    model: Float64[np.ndarray, "n h 3"],
    scene: Float64[np.ndarray, "n g 3"],
) -> Float64[np.ndarray, "4 4"] | None:
    """Fit again to all pairs that agree, a few times; None when they lie on a line."""
    for _ in range(3):
        gaps = np.linalg.norm(transform(scene_from_model, model)[:, :, None] - scene[:, None], axis=-1)
        flat = gaps.reshape(len(gaps), -1)
        best = flat.argmin(axis=1)
        agree = flat[np.arange(len(flat)), best] < AGREE_M
        pairs_model = model[np.arange(len(flat)), best // scene.shape[1]][agree]
        pairs_scene = scene[np.arange(len(flat)), best % scene.shape[1]][agree]
        if len(pairs_model) < 3 or is_collinear(pairs_scene, tolerance_m=LINE_M):
            return None
        scene_from_model = fit_rigid(pairs_scene, pairs_model)
    return scene_from_model


def _merge(model: Hypotheses, scene: Hypotheses, model_from_scene: Float64[np.ndarray, "4 4"]) -> Hypotheses:
    """Where both agree, their mean comes first; all other hypotheses are kept behind."""
    merged = dict(model)
    for keypoint, positions in scene.items():
        moved = transform(model_from_scene, positions)
        if keypoint not in model:
            merged[keypoint] = moved
            continue
        gaps = np.linalg.norm(model[keypoint][:, None] - moved[None], axis=-1)
        i, j = np.unravel_index(gaps.argmin(), gaps.shape)
        if gaps[i, j] < AGREE_M:
            others = np.delete(model[keypoint], i, axis=0)
            merged[keypoint] = np.vstack([(model[keypoint][i] + moved[j])[None] / 2, others])[:6]
        else:
            merged[keypoint] = np.vstack([model[keypoint], moved])[:6]
    return merged


def choose_fragments(
    scenes: Sequence[Hypotheses],
    transforms: Sequence[Float64[np.ndarray, "4 4"] | None],
    model: Hypotheses,
    keypoints: int,
) -> Fragments:
    """The paper's W: of every scene's hypotheses the one next to the model's first."""
    points = np.zeros((len(scenes), keypoints, 3))
    clicked = np.zeros((len(scenes), keypoints))
    for s, (scene, scene_from_model) in enumerate(zip(scenes, transforms, strict=True)):
        for keypoint, positions in scene.items():
            choice = 0
            if scene_from_model is not None and keypoint in model:
                expected = transform(scene_from_model, model[keypoint][0])
                choice = int(np.linalg.norm(positions - expected, axis=1).argmin())
            points[s, keypoint] = positions[choice]
            clicked[s, keypoint] = 1
    return Fragments(points, clicked)
