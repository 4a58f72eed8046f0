"""The click solution of an object, refined by what its scenes' surfaces say of one another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.refine.evidence import (
    ClickCosts,
    Verdict,
    cross_validated,
    gains_sigmas,
    left_alone,
    verdicts,
    without_surface,
)
from rpl_data.refine.overlap import Pairs, compared_pairs
from rpl_data.refine.registration import (
    GATES_M,
    ClickTerms,
    Points,
    Poses,
    Registration,
    register_scenes,
)
from rpl_data.refine.same_print import shows_another_print
from rpl_data.refine.scene_surfaces import SceneSurface, scene_surface
from rpl_data.types import PointCloud

WORST_SHARE = 0.25
"""Of many scenes with evidence against them, this share is turned down in each round."""


@dataclass(frozen=True)
class Refined:
    """What became of the scenes.

    Attributes:
        scene_from_object: one per scene, in the order given.
        points_object: one row per keypoint, in the (slightly moved) object frame of the poses.
        normal: normal matrix of the unknowns, 6 per scene and 3 per keypoint.
        verdicts: one per scene; where a scene is not accepted, its pose is that of its own clicks.
    """

    scene_from_object: Poses
    points_object: Points
    normal: Float64[np.ndarray, "u u"]
    verdicts: tuple[Verdict, ...]

    @property
    def registered(self) -> bool:
        """Some scene gained; otherwise everything is as the clicks have it."""
        return any(verdict.accepted for verdict in self.verdicts)


def refine_scenes(
    regions: Mapping[str, PointCloud],
    scenes: Sequence[str],
    scene_from_object: Poses,
    points_object: Points,
    clicks: ClickTerms,
    click_costs: ClickCosts,
) -> Refined:
    """Register the scenes on one another, and keep of it what held-out evidence supports.

    Args:
        regions: the object's surface per scene, scene frame, without what it stands on.
        scenes: names of the scenes, in the order of the poses.
        scene_from_object: the click solution.
        points_object: the keypoints of the click solution; unknown ones anywhere finite.
        clicks: the clicks' part of the normal matrix.
        click_costs: the clicks' cost per scene.
    """
    start = scene_from_object
    surfaces: list[SceneSurface | None] = [
        scene_surface(regions[name]) if name in regions else None for name in scenes
    ]
    rejected = {n: without_surface() for n, surface in enumerate(surfaces) if surface is None}
    unseen = len(rejected)
    while len(scenes) - len(rejected) >= 2:
        pairs = compared_pairs(surfaces, start)
        tests = cross_validated(surfaces, start, points_object, clicks, pairs=pairs)
        found = _registered(surfaces, tests[0].registration, clicks, pairs)
        worse = click_costs(found.scene_from_object, found.points_object) - click_costs(start, points_object)
        another = shows_another_print(tests, pairs, len(scenes))
        judged = verdicts(gains_sigmas(tests, start, pairs=pairs), worse, another_print=another)
        against = [n for n, verdict in enumerate(judged) if n not in rejected and not verdict.accepted]
        if not against:
            final = tuple(rejected.get(n, verdict) for n, verdict in enumerate(judged))
            return Refined(found.scene_from_object, found.points_object, found.normal, final)
        for worst in _turned_down_now(against, judged, another, pairs):
            rejected[worst] = judged[worst]
            surfaces[worst] = None
    alone = without_surface() if len(rejected) == unseen else left_alone()
    left = tuple(rejected.get(n, alone) for n in range(len(scenes)))
    return Refined(start, points_object, clicks(start, points_object)[0], left)


def _registered(
    surfaces: Sequence[SceneSurface | None], near: Registration, clicks: ClickTerms, pairs: Pairs
) -> Registration:
    """Registered on all blocks, from where half of them had brought the scenes."""
    return register_scenes(
        surfaces, near.scene_from_object, near.points_object, clicks, pairs=pairs, gates_m=GATES_M[1:]
    )


def _turned_down_now(
    against: Sequence[int], judged: Sequence[Verdict], another_print: Bool[np.ndarray, " s"], pairs: Pairs
) -> list[int]:
    """The scenes to be turned down before the others are judged again: first those with another print.

    A wrong scene spoils the agreement of those that it is compared with, so of these only the worst is turned
    down. Of eight and more the worst quarter is, so that there are not as many rounds as scenes.
    """
    against = [n for n in against if another_print[n]] or against
    rank = {n: place for place, n in enumerate(sorted(against, key=lambda n: judged[n].gain_sigmas))}
    spared = {a for a, b in pairs if a in rank and b in rank and rank[b] < rank[a]}
    return [n for n in against if n not in spared or rank[n] + 1 <= WORST_SHARE * len(against)]
