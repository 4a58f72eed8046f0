"""The server's state: logs, scenes, results, and the pages that listen for changes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.annotate.actions import named_keypoints
from rpl_data.annotate.live import Lifter, Live, solve_live
from rpl_data.annotate.log import ObjectLog, Revision
from rpl_data.annotate.news import News
from rpl_data.annotate.stores.masks import MaskStore
from rpl_data.annotate.stores.pictures import PictureStore
from rpl_data.annotate.stores.scenes import SceneStore
from rpl_data.annotate.suggest import Suggestion, suggest_frames
from rpl_data.annotate.work import Tell, Work
from rpl_data.clicks.log import Annotation
from rpl_data.geometry import Transform
from rpl_data.types import Click, DataError
from rpl_data.untrusted.names import checked_name
from rpl_data.workspace.workspace import Workspace


@dataclass(frozen=True)
class Result:
    """The result of a revision, and lifted clicks for scenes without a result yet.

    Attributes:
        grasp: `object_from_grasp` if one was marked and can be computed; else `grasp_problem` says why not.
        expected_px: expected error of the keypoints over the images of each scene.
        limits_px: see `Work`.
        judged: scenes whose camera path a build has compared with their images.
    """

    revision: Revision
    live: Live
    lifted: tuple[tuple[Click, Float64[np.ndarray, "3"]], ...]
    grasp: Transform | None = None
    grasp_problem: str = ""
    expected_px: Mapping[str, float] = field(default_factory=dict)
    limits_px: tuple[float, float] = (np.inf, np.inf)
    judged: frozenset[str] = frozenset()

    def rough_scenes(self) -> dict[str, float]:
        """The expected error in px of the scenes whose labels will be rough."""
        return {scene: px for scene, px in self.expected_px.items() if px > self.limits_px[0]}


class Overtaken(Exception):
    """The clicks have changed since the check of their result began."""


class Session:
    """One workspace, open for annotation."""

    def __init__(self, workspace: Workspace, work: Work) -> None:
        self.workspace, self.work = workspace, work
        self.scenes = SceneStore(workspace)
        self.pictures = PictureStore(self.scenes)
        self.masks = MaskStore(workspace)
        self.news = News()
        self._lifter = Lifter(self.scenes)
        self._logs: dict[str, ObjectLog] = {}
        self._results: dict[str, Result] = {}
        self._suggestions: dict[tuple[str, str, bool], list[Suggestion]] = {}
        self._solving = threading.Lock()
        self._solved_with = self._stamps()
        self.when_opened: list[Callable[[], object]] = []
        self.when_closed: list[Callable[[], object]] = [self.news.close]

    def close(self) -> None:
        """End the streams and jobs before the server stops."""
        for does in self.when_closed:
            does()

    def forget(self) -> None:
        """Clear what was computed of scenes and camera poses, which a build may have changed."""
        with self._solving:
            self.scenes.forget()
            before, self._solved_with = self._solved_with, self._stamps()
            if before != self._solved_with:
                self._lifter = Lifter(self.scenes)
                self._results.clear()
                self._suggestions.clear()

    def _stamps(self) -> dict[Path, int]:
        """When the files that results follow besides the clicks were written: poses, registered scenes."""
        files = [self.workspace.trajectory_file(scene) for scene in self.scenes.names()]
        files += [self.workspace.placed_file(name) for name in self.objects()]
        return {path: path.stat().st_mtime_ns for path in files if path.exists()}

    def revisions(self) -> dict[str, int]:
        """The revision on the disk of every object that was opened."""
        return {name: log.now().number for name, log in list(self._logs.items())}

    def objects(self) -> list[str]:
        """Names of the objects, in the order of the recipe."""
        return self.work.objects()

    def log(self, name: str) -> ObjectLog:
        """The log of an object; DataError when there is no such object."""
        if name not in self.objects():
            raise DataError(
                f"there is no object {name!r} in this workspace; if it was replaced while the page was open, "
                "reload the page"
            )
        if name not in self._logs:
            self._logs.setdefault(name, ObjectLog(self.workspace, name, self.scenes))
        return self._logs[name]

    def add_object(self, name: str, keypoints: Sequence[str]) -> None:
        """Add an object with named keypoints."""
        checked_name(name, "object")
        if name in self.objects():
            raise DataError(f"there is an object {name} already")
        names = named_keypoints(list(keypoints))
        if len(names) < 3:
            raise DataError("an object needs at least 3 keypoints")
        self.work.add_object(name, names)
        self.news.tell("objects", name)

    def act(self, name: str, actions: Sequence[dict[str, object]], *, seen: int) -> Revision:
        """Save actions, and notify the other pages."""
        revision = self.log(name).append(actions, seen=seen)
        self.news.tell("object", name, revision.number)
        return revision

    def result(self, name: str, *, checked: bool = True) -> Result:
        """The result of the current clicks; solved and checked once per revision.

        Args:
            checked: whether to wait for the check of the clicks against one another. A click that is made
                meanwhile ends the check, and the result that comes back is then that click's, unchecked.
        """
        log = self.log(name)
        with self._solving:
            kept = self._solved(name, log.now())
            if not checked or kept.live.check is None:
                return kept

            def go_on() -> None:
                if log.now().number != kept.revision.number:
                    raise Overtaken

            try:
                live = kept.live.checked(go_on)
            except Overtaken:
                return self._solved(name, log.now())
            kept = self._results[name] = self._result(kept.revision, live)
            return kept

    def _solved(self, name: str, revision: Revision) -> Result:
        """The result of a revision, checked if it was before."""
        kept = self._results.get(name)
        if kept is None or kept.revision.number != revision.number:
            observations = self._lifter.observations(revision.annotation.clicks)
            live = solve_live(revision.annotation, observations, self.work.solve)
            kept = self._results[name] = self._result(revision, live)
        return kept

    def _result(self, revision: Revision, live: Live) -> Result:
        observations = self._lifter.observations(revision.annotation.clicks)
        lifted = tuple(live.lifted(observations))
        expected_px = {
            scene: self.work.expected_px(live.solution, scene) for scene in live.placed if live.solution
        }
        grasp, problem = self._grasp(revision.annotation, live)
        limits_px, judged = self.work.limits_px(), self._judged(live.placed)
        return Result(revision, live, lifted, grasp, problem, expected_px, limits_px, judged)

    def _judged(self, places: Iterable[str]) -> frozenset[str]:
        """The places in scenes whose camera path a build has measured (stage `drift`)."""
        parts = self.workspace.parts()
        return frozenset(p for p in places if self.workspace.drift_file(parts.video_of(p)).exists())

    def find(self, name: str, scene: str, tell: Tell) -> list[str]:
        """Place a known object in a scene without clicks; see `Work`."""
        self.log(name)
        self.scenes.get(scene)
        lines = self.work.find(name, scene, tell)
        with self._solving:
            self._results.pop(name, None)  # its clicks are the same, but it has one more scene
        return lines

    def _grasp(self, annotation: Annotation, live: Live) -> tuple[Transform | None, str]:
        if annotation.grasp is None or live.solution is None:
            return None, ""
        try:
            return self.work.grasp(annotation.grasp, live.solution), ""
        except DataError as error:
            return None, str(error)

    def suggestions(self, name: str, scene: str) -> list[Suggestion]:
        """Suggest frames of a scene to mark; from all sides of the object once its pose there is known."""
        self.log(name)
        known = self._results.get(name)
        solution = known.live.solution if known else None
        scene_from_object = None if solution is None else solution.scene_from_object.get(scene)
        key = name, scene, scene_from_object is not None
        if key not in self._suggestions:
            centre = None if scene_from_object is None else scene_from_object[:3, 3]
            self._suggestions[key] = suggest_frames(self.scenes.get(scene), centre)
        return self._suggestions[key]
