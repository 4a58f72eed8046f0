"""The result after every click: scenes that the clicks tie together, and what the others lack."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.annotate.stores.scenes import SceneStore
from rpl_data.annotate.work import Check, GoOn, Solve
from rpl_data.clicks.lift import lift
from rpl_data.clicks.log import Annotation
from rpl_data.clicks.rigidity import describe_loose, generic_points, loose_scenes
from rpl_data.geometry import Transform, transform
from rpl_data.types import Click, DataError, Observation, Solution, Statement
from rpl_data.types.keypoint_names import keypoint_titles
from rpl_data.wording import counted

FEWEST = 3
"""Keypoints to click per scene; fewer cannot tie it to others."""


@dataclass(frozen=True)
class Live:
    """The current result of the clicks.

    Attributes:
        solution: solution of the scenes that are tied together; None when there is none yet.
        loose: what each scene lacks, by scene; scenes without clicks are left out.
        problem: why scenes that should be tied have no solution; empty when all is well.
        seconds: time that solving took.
        check: gives the final solution, with the check of its clicks; None when this is the final one.
    """

    solution: Solution | None
    loose: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""
    seconds: float = 0.0
    check: Check | None = None

    def checked(self, go_on: GoOn = lambda: None) -> Live:
        """The final result, with what its clicks say about one another.

        Args:
            go_on: called again and again meanwhile; what it raises ends the check.
        """
        return self if self.check is None else replace(self, solution=self.check(go_on), check=None)

    @property
    def placed(self) -> Mapping[str, Transform]:
        """`scene_from_object` by scene; empty while there is no solution."""
        return self.solution.scene_from_object if self.solution else {}

    @property
    def statements(self) -> tuple[Statement, ...]:
        """What the solution says of clicks, the strongest first; empty while there is none."""
        return self.solution.statements if self.solution else ()

    def lifted(self, observations: Sequence[Observation]) -> list[tuple[Click, Float64[np.ndarray, "3"]]]:
        """Clicks of scenes in which the object has no pose yet, in the scene frame, at the nearest depth."""
        return [
            (o.click, transform(o.scene_from_camera, o.depths_m[0] * o.ray_camera))
            for o in observations
            if o.click.scene not in self.placed and len(o.depths_m)
        ]


class Lifter:
    """Lifts clicks to 3D by their depth; each click is lifted once and cached."""

    def __init__(self, scenes: SceneStore) -> None:
        self.scenes = scenes
        self._kept: dict[tuple[str, int, float, float], Observation] = {}

    def observations(self, clicks: Sequence[Click]) -> list[Observation]:
        """Lift the clicks: one observation per click, in order."""
        found = {}
        for click in sorted(clicks, key=lambda c: (c.scene, c.frame)):  # so that each file is read once
            found[self._key(click)] = self._kept.get(self._key(click)) or self._lift(click)
        self._kept = {**found} if len(found) > 5000 else self._kept | found
        return [replace(found[self._key(click)], click=click) for click in clicks]

    def _lift(self, click: Click) -> Observation:
        posed = self.scenes.get(click.scene)
        posed.frame(click.frame)
        pose = posed.trajectory.at(click.frame)
        depth_m = self.scenes.depth_m(click.scene, click.frame)
        return lift(click, posed.scene.intrinsics, pose, depth_m)

    def _key(self, click: Click) -> tuple[str, int, float, float]:
        return click.scene, click.frame, click.u_px, click.v_px


def solve_live(annotation: Annotation, observations: Sequence[Observation], solve: Solve) -> Live:
    """Solve the scenes that the clicks tie together; raises nothing that more clicks would mend."""
    started = time.perf_counter()
    if annotation.known_points is not None:
        return _solve_known(annotation, observations, solve, started)
    tied, loose = tied_scenes(annotation.keypoints, observations)
    problem = ""
    while tied:
        chosen = [o for o in observations if o.click.scene in tied]
        try:
            solution, check = solve(annotation, chosen)
            return Live(solution, loose, problem, time.perf_counter() - started, check)
        except DataError as error:
            problem = problem or str(error).removeprefix(f"object {annotation.object}: ")
            worst = min(
                tied, key=lambda scene: len({o.click.keypoint for o in chosen if o.click.scene == scene})
            )
            tied.remove(worst)
            loose[worst] = problem
    return Live(None, loose, problem, time.perf_counter() - started)


def _solve_known(
    annotation: Annotation, observations: Sequence[Observation], solve: Solve, started: float
) -> Live:
    """Place each scene by itself on a known model, so that a scene that fails does not affect others."""
    loose: dict[str, str] = {}
    placed: list[Observation] = []
    for scene in sorted({o.click.scene for o in observations}):
        mine = [o for o in observations if o.click.scene == scene]
        try:
            solve(annotation, mine)
            placed += mine
        except DataError as error:
            loose[scene] = str(error).removeprefix(f"object {annotation.object}, scene {scene}: ")
    solution, check = solve(annotation, placed) if placed else (None, None)
    return Live(solution, loose, "", time.perf_counter() - started, check)


def tied_scenes(
    keypoints: Sequence[str], observations: Sequence[Observation]
) -> tuple[list[str], dict[str, str]]:
    """Return the scenes that the pattern of clicks ties together, and what the others lack."""
    seen: dict[str, set[int]] = {}
    for o in observations:
        seen.setdefault(o.click.scene, set()).add(o.click.keypoint)
    enough = sorted(scene for scene, clicked in seen.items() if len(clicked) >= FEWEST)
    loose = {
        scene: f"{counted(len(clicked), 'keypoint')} clicked; at least {FEWEST} are needed"
        for scene, clicked in seen.items()
        if scene not in enough
    }
    tied = list(enough)
    while len(tied) > 1:
        clicked = np.array([[k in seen[scene] for k in range(len(keypoints))] for scene in tied])
        points = generic_points(len(keypoints))
        untied = loose_scenes(points, clicked)
        if not untied:
            break
        lines = describe_loose(untied, clicked, tied, keypoint_titles(keypoints), points).splitlines()
        for line, s in zip(lines, untied, strict=True):
            loose[tied[s]] = line.removeprefix(f"scene {tied[s]} ")
        tied = [scene for s, scene in enumerate(tied) if s not in untied]
    return tied, loose
