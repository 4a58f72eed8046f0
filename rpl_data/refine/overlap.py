"""Which scenes are compared with which: each with a few, so that the cost grows with their number.

Comparing all pairs would gain little, since further partners repeat what the first few say of a part of the
surface. Partners are chosen one after another, each for the parts that those before it do not show (the
greedy choice for submodular functions of Nemhauser, Wolsey and Fisher, 1978).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float64
from scipy.sparse.csgraph import connected_components

from rpl_data.geometry import invert, transform
from rpl_data.refine.scene_surfaces import SceneSurface

PARTNERS = 5
"""How many partners a scene chooses; others may choose it besides."""
CELL_M = 0.02
"""Edge of the cubes of the object frame by which parts of the surface are told apart; with the side that the
surface faces there."""
WORTH_AGAIN = 0.5
"""What a part of the surface is worth to the next partner once more of those before it have shown it."""

Pairs = list[tuple[int, int]]
"""A scene that asks and one that it asks, by number; each pair in both orders."""


def all_pairs(surfaces: Sequence[SceneSurface | None]) -> Pairs:
    """Every scene with every other one that takes part."""
    return list(permutations([n for n, surface in enumerate(surfaces) if surface is not None], 2))


def compared_pairs(
    surfaces: Sequence[SceneSurface | None], scene_from_object: Float64[np.ndarray, "s 4 4"]
) -> Pairs:
    """Choose the pairs of scenes to compare; all of them where the scenes are few.

    Scenes that are tied to one another by surfaces that they share, directly or through others, stay so.

    Args:
        surfaces: the object's surface per scene; None where it takes no part.
        scene_from_object: right to about a centimetre.
    """
    present = [n for n, surface in enumerate(surfaces) if surface is not None]
    if len(present) <= PARTNERS + 1:
        return all_pairs(surfaces)
    seen = _cells_seen([s for s in surfaces if s is not None], scene_from_object[present])
    linked = np.zeros((len(present), len(present)), dtype=bool)
    for scene in range(len(present)):
        linked[scene, _partners(seen, scene)] = True
    linked = _tied(linked | linked.T, seen)
    return [(present[a], present[b]) for a, b in np.argwhere(linked)]


def _cells_seen(
    surfaces: Sequence[SceneSurface], scene_from_object: Float64[np.ndarray, "n 4 4"]
) -> Float64[np.ndarray, "n c"]:
    """1 where a scene sees a part of the object, 0 where it does not."""
    cells = []
    for surface, object_from_scene in zip(surfaces, invert(scene_from_object), strict=True):
        normals = surface.cloud.normals @ object_from_scene[:3, :3].T
        axis = np.abs(normals).argmax(axis=1)
        facing = 2 * axis + (normals[np.arange(len(axis)), axis] > 0)
        cube = np.floor(transform(object_from_scene, surface.cloud.points) / CELL_M).astype(np.int64)
        cells.append(np.unique(np.column_stack([cube, facing]), axis=0))
    number = np.unique(np.concatenate(cells), axis=0, return_inverse=True)[1].ravel()
    seen = np.zeros((len(surfaces), number.max() + 1))
    seen[np.repeat(np.arange(len(cells)), [len(of_scene) for of_scene in cells]), number] = 1
    return seen


def _partners(seen: Float64[np.ndarray, "n c"], scene: int) -> list[int]:
    """The scenes that together see most of what one scene sees, several times over."""
    worth, chosen = seen[scene].copy(), list[int]()
    for _ in range(PARTNERS):
        gain = seen @ worth
        gain[[scene, *chosen]] = 0
        best = int(gain.argmax())
        if gain[best] == 0:
            break
        chosen.append(best)
        worth[seen[best] > 0] *= WORTH_AGAIN
    return chosen


def _tied(linked: Bool[np.ndarray, "n n"], seen: Float64[np.ndarray, "n c"]) -> Bool[np.ndarray, "n n"]:
    """The links, with those added that tie separate groups together where they share most."""
    shared = seen @ seen.T
    while True:
        group = connected_components(linked, directed=False)[1]
        across = np.where(group[:, None] == group, 0, shared)
        if not across.any():
            return linked
        a, b = np.unravel_index(across.argmax(), across.shape)
        linked[a, b] = linked[b, a] = True
