"""What every stage is given, and what its steps have in common."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

from rpl_data.json_arrays import Json
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.recipe import ObjectRecipe, Recipe, SceneSource
from rpl_data.types import Frame, Scene, Solution, Trajectory
from rpl_data.workspace.workspace import Workspace


@dataclass(frozen=True)
class Context:
    """What every stage is given."""

    recipe: Recipe
    workspace: Workspace
    pool: Pool

    @property
    def scene_sources(self) -> tuple[SceneSource, ...]:
        """Where scenes come from; a twin's recording when the recipe names none."""
        return self.recipe.scenes or (SceneSource(self.workspace.recording, metres_per_unit=0.001),)

    @property
    def objects(self) -> tuple[ObjectRecipe, ...]:
        """The objects; those a twin wrote when the recipe names none."""
        return self.recipe.objects or tuple(self._twin_objects())

    def _twin_objects(self) -> Iterator[ObjectRecipe]:
        truth = Workspace(self.workspace.truth)
        for name in truth.object_names():
            model = truth.load_solution(name).model
            clicks = self.workspace.recording / "clicks.csv"
            yield ObjectRecipe(name, model.keypoints, clicks, model.skeleton)

    @property
    def object_names(self) -> list[str]:
        """Names in the recipe's order, which is that of the categories."""
        return [item.name for item in self.objects]

    @property
    def tracks(self) -> bool:
        """Camera poses are computed from the images."""
        return self.recipe.reconstruct.method == "track"

    def poses_of(self, *scenes: str) -> list[str]:
        """Names of the steps that the poses of scenes (of all, when none is named) come from."""
        if not self.tracks:
            return ["import"]
        parts, known = self.workspace.parts(), scenes or tuple(self.workspace.scene_names())
        return ["import", *sorted({f"track/{parts.video_of(scene)}" for scene in known})]

    def solutions_in(self, scene: str) -> list[Solution]:
        """Solutions of the objects that stand in a scene."""
        solutions = [self.workspace.load_solution(name) for name in self.object_names]
        return [solution for solution in solutions if scene in solution.scene_from_object]

    def placed_videos(self) -> list[str]:
        """Recordings in which at least one object has a place."""
        parts = self.workspace.parts()
        return sorted({parts.video_of(scene) for scene in self.placed_scenes()})

    def clicks_source(self, object_name: str) -> Json:
        """What of the log the stages depend on: not on crop and grasp, nor on what was undone again."""
        annotation, parts = self.workspace.load_annotation(object_name), self.workspace.parts()
        clicks = [astuple(parts.click_in_video(click)) for click in annotation.clicks]
        content = json.dumps([annotation.keypoints, clicks, annotation.known_points])
        return {object_name: hashlib.sha256(content.encode()).hexdigest()[:16]}

    def frames_of(self, scene: str) -> Json:
        """Which frames of its recording a scene is, for the options of steps; nothing when it is whole."""
        parts = self.workspace.parts()
        video = parts.video_of(scene)
        if video not in parts.spans:
            return {}
        return {"frames": list(parts.spans[video][parts.scenes_of(video).index(scene)])}

    def placed_scenes(self) -> list[str]:
        """Scenes in which at least one object has a place."""
        solutions = [self.workspace.load_solution(name) for name in self.object_names]
        placed = {scene for solution in solutions for scene in solution.scene_from_object}
        return [scene for scene in self.workspace.scene_names() if scene in placed]


def step(
    stage: str,
    item: str,
    run: Callable[[Advance], Outcome],
    *,
    version: int,
    options: Json | None = None,
    sources: Json | None = None,
    after: Sequence[str] = (),
    outputs: Sequence[Path] = (),
) -> Step:
    """A step, with nothing where nothing is said.

    Args:
        version: of the stage, kept beside it as `VERSION`.
    """
    return Step(stage, item, version, options or {}, sources or {}, tuple(after), tuple(outputs), run)


def posed_frames(scene: Scene, trajectory: Trajectory) -> list[Frame]:
    """The frames that have a pose."""
    posed = set(trajectory.frames.tolist())
    return [frame for frame in scene.frames if frame.index in posed]
