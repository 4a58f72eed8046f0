"""Where the adjustment starts: scenes joined from several first scenes, and Eq. 2 minimised on each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.geometry import rigid
from rpl_data.solve.bundle_adjustment import State
from rpl_data.solve.initial_guess import Hypotheses, Start, join_scenes
from rpl_data.solve.procrustes import Fragments, adjust_points, best_of_starts

STARTS = 2
"""How many scenes the joining begins with in turn, best connected first."""


def start_states(groups: Sequence[Hypotheses], keypoints: int) -> Iterator[State]:
    """Starts that differ in the scene with which the joining begins; those that end the same only once.

    Each is computed when it is asked for.
    """
    found: list[Fragments] = []
    for rank in range(min(STARTS, len(groups))):
        start = join_scenes(groups, keypoints, first_rank=rank)
        if any(np.array_equal(start.fragments.points_scene, other.points_scene) for other in found):
            continue
        found.append(start.fragments)
        adjusted = adjust_points(start.fragments, complete(start))
        yield State(adjusted.scene_from_model, adjusted.points_model)


def complete(start: Start) -> Float64[np.ndarray, "s 4 4"]:
    """Transforms of all scenes; those that could not be joined one by one start from many turns.

    Such scenes are tied only by the graph as a whole. Eq. 2 has a wide basin (the original code
    starts from the identity), so a few random starts and the lowest cost will do.
    """
    if all(found is not None for found in start.scene_from_model):
        return np.stack([found for found in start.scene_from_model if found is not None])
    random = np.random.default_rng(0)
    tries = [
        np.stack([_random_turn(random) if t is None else t for t in start.scene_from_model])
        for _ in range(30)
    ]
    return best_of_starts(start.fragments, np.stack(tries))


def _random_turn(random: np.random.Generator) -> Float64[np.ndarray, "4 4"]:
    return rigid(Rotation.random(rng=random).as_matrix(), np.zeros(3))
