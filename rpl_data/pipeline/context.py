"""The context that every stage receives, and how its steps are made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.clicks.log import Annotation
from rpl_data.json_arrays import Json
from rpl_data.pipeline.choice import ExportChoice
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.pipeline.object_store import url_of
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.recipe import ObjectRecipe, Recipe, SceneSource
from rpl_data.pipeline.remotes import copy_of
from rpl_data.types import DataError, KeypointModel, Solution, Trajectory
from rpl_data.types.instances import places_in, scene_of
from rpl_data.workspace.workspace import Workspace

Box3 = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest corner, metres."""


@dataclass(frozen=True)
class Context:
    """The recipe, workspace and process pool that every stage receives.

    Attributes:
        choice: what an export is limited to; a build limits none.
        lost: recordings that cannot be read, or in which a step of this build failed; all steps after it do
            without them.
        keep_going: whether sources that cannot be read are left out, too.
    """

    recipe: Recipe
    workspace: Workspace
    pool: Pool
    choice: ExportChoice = ExportChoice()
    lost: frozenset[str] = frozenset()
    keep_going: bool = False

    @property
    def scene_sources(self) -> tuple[SceneSource, ...]:
        """Sources of the scenes; the twin's recording when the recipe names none."""
        twin = self.recipe.twin
        casts = () if twin is None else zip(twin.scene_names, twin.casts, strict=True)
        moving = tuple(name for name, cast in casts if cast.moving) or False
        made = SceneSource(self._twin_recording, metres_per_unit=0.001, moving=moving)
        return tuple(map(self._here, self.recipe.scenes)) or (made,)

    def _here(self, source: SceneSource) -> SceneSource:
        """A source with its copy in place of an address in an object store."""
        url = url_of(source.path)
        return source if url is None else replace(source, path=copy_of(self.workspace, url))

    @property
    def objects(self) -> tuple[ObjectRecipe, ...]:
        """The objects; those that the twin wrote when the recipe names none."""
        return self.recipe.objects or tuple(self._twin_objects())

    @property
    def _twin_recording(self) -> Path:
        """As the paths of recipe files, absolute: a build started in another folder is no other build."""
        return self.workspace.recording.absolute()

    def _twin_objects(self) -> Iterator[ObjectRecipe]:
        truth = Workspace(self.workspace.truth)
        for name in truth.object_names():
            model = truth.load_solution(name).model
            clicks = self._twin_recording / "clicks.csv"
            yield ObjectRecipe(name, model.keypoints, clicks, model.skeleton)

    @property
    def object_names(self) -> list[str]:
        """Names of the objects in the recipe's order, which is that of the exported categories."""
        return [item.name for item in self.objects]

    def export_folder(self, name: str) -> Path:
        """The folder of an export: the recipe's own, or one for the choice."""
        return self.workspace.export(self.choice.folder) / name

    @property
    def tracks(self) -> bool:
        """The images have a say in the camera poses: the recording's are not taken as they are."""
        return self.recipe.reconstruct.method != "given"

    @property
    def wants_given(self) -> bool:
        """The recording's own poses are looked at, where it has some."""
        return self.recipe.reconstruct.method != "track"

    def poses_of(self, *scenes: str) -> list[str]:
        """Names of the steps that yield the poses of these scenes (of all scenes when none is named)."""
        if not self.tracks:
            return ["import"]
        parts, known = self.workspace.parts(), scenes or tuple(self.workspace.scene_names())
        videos = {parts.video_of(scene) for scene in known} - self.lost
        return ["import", *sorted(f"track/{video}" for video in videos)]

    def videos(self) -> list[str]:
        """Names of the recordings, without those in which a step failed."""
        return [name for name in self.workspace.video_names() if name not in self.lost]

    def still_places(self, places: Iterable[str]) -> list[str]:
        """Those of an object's places in which it stands still while it is filmed, sorted."""
        parts = self.workspace.parts()
        left_out = parts.moving | self.lost
        return sorted(place for place in places if parts.video_of(place) not in left_out)

    def solutions_in(self, scene: str) -> list[Solution]:
        """Solutions of the objects that have a pose in a scene."""
        return [one for one in self._solutions() if places_in(scene, one.scene_from_object)]

    def _solutions(self) -> list[Solution]:
        """Solutions of all objects; every scene asks for them, so they are only read when they changed."""
        return [_solution(self.workspace, name, _stamp(self.workspace, name)) for name in self.object_names]

    def placed_by(self, object_name: str) -> str:
        """Name of the step whose solution the labels of an object follow."""
        return f"refine/{object_name}" if self.recipe.refine.scenes else f"solve/{object_name}"

    def placed_videos(self) -> list[str]:
        """Recordings in which at least one object has a pose."""
        parts = self.workspace.parts()
        return sorted({parts.video_of(scene) for scene in self.placed_scenes()})

    def clicks_source(self, object_name: str) -> Json:
        """The part of the click log that stages depend on: without crop, grasp, and what was undone."""
        annotation, parts = self.workspace.load_annotation(object_name), self.workspace.parts()
        clicks = [astuple(parts.click_in_video(click)) for click in annotation.clicks]
        content = json.dumps([annotation.keypoints, clicks, annotation.known_points])
        return {object_name: hashlib.sha256(content.encode()).hexdigest()[:16]}

    def frames_of(self, scene: str) -> Json:
        """The frames of its recording that a scene has, for the options of steps; empty when it is whole."""
        parts = self.workspace.parts()
        video = parts.video_of(scene)
        if video not in parts.spans:
            return {}
        return {"frames": list(parts.spans[video][parts.scenes_of(video).index(scene)])}

    def placed_scenes(self) -> list[str]:
        """Scenes in which at least one object has a pose."""
        placed = {scene_of(place) for one in self._solutions() for place in one.scene_from_object}
        parts = self.workspace.parts()
        there = [scene for scene in self.workspace.scene_names() if parts.video_of(scene) not in self.lost]
        return [scene for scene in there if scene in placed]


def _stamp(workspace: Workspace, object_name: str) -> tuple[int, int]:
    path = workspace.solution_file(object_name)
    status = path.stat() if path.exists() else None
    return (0, 0) if status is None else (status.st_mtime_ns, status.st_ino)


@lru_cache(256)
def _solution(workspace: Workspace, object_name: str, stamp: tuple[int, int]) -> Solution:
    return workspace.load_solution(object_name)


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
    """Make a step; what is not given is empty.

    Args:
        version: version of the stage, which its module holds as `VERSION`.
    """
    return Step(stage, item, version, options or {}, sources or {}, tuple(after), tuple(outputs), run)


def truth_workspace(context: Context) -> Workspace | None:
    """The workspace with the ground truth; None when it is not known."""
    if context.recipe.truth is not None and context.recipe.truth.is_dir():
        return Workspace(context.recipe.truth)
    known = context.recipe.truth is not None or context.recipe.twin is not None
    return Workspace(context.workspace.truth) if known else None


def crop_of(workspace: Workspace, item: ObjectRecipe) -> Box3 | None:
    """The box the dense model is cut to: that of the annotation page, else the recipe's; object frame."""
    drawn = workspace.load_annotation(item.name).crop_m
    if drawn is not None or item.crop is None:
        return drawn
    return item.crop.low_m, item.crop.high_m


def known_points(annotation: Annotation) -> Float64[np.ndarray, "k 3"]:
    """The given model, one row per keypoint, NaN where it has none; DataError with fewer than three."""
    given = annotation.known_points or ()
    rows = [given[k] if k < len(given) else None for k in range(len(annotation.keypoints))]
    points = np.array([(np.nan,) * 3 if row is None else row for row in rows], dtype=float).reshape(-1, 3)
    known = int(np.isfinite(points).all(axis=1).sum())
    if known < 3:
        raise DataError(
            f"object {annotation.object}: its known model has {known} keypoints, at least 3 are needed; "
            "pick more of them on its mesh, or load a model that has them"
        )
    return points


def path_key(trajectory: Trajectory) -> str:
    """Stands for the camera poses of a scene, to a micrometre."""
    content = trajectory.frames.tobytes() + np.round(1e6 * trajectory.scene_from_camera).tobytes()
    return hashlib.sha256(content).hexdigest()[:16]


def model_key(model: KeypointModel) -> str:
    """Stands for the keypoints of a model, and the frame they are in, to a micrometre."""
    return hashlib.sha256(np.round(1e6 * model.points_object).tobytes()).hexdigest()[:16]
