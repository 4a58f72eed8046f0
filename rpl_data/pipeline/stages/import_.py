"""Stage `import`: read recordings into scenes of the workspace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from rpl_data.doctor.timing import pose_jumps
from rpl_data.files import remove
from rpl_data.json_arrays import Json
from rpl_data.names import checked_name
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step, stamps
from rpl_data.pipeline.recipe import SceneSource
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Recording
from rpl_data.workspace.workspace import Workspace

VERSION = 1
"""Raised when the stage writes something else for the same input; its steps then run again."""


STANDS_OUT = 4.0
"""A step of the camera that is so many times the usual one stands out."""


def import_steps(context: Context) -> list[Step]:
    """Stage `import`: read recordings into scenes of the workspace."""
    workspace, sources = context.workspace, context.scene_sources

    def run(advance: Advance) -> Outcome:
        unpack = partial(_emptied, workspace)
        recordings = read_recordings(sources, unpack=unpack, poses=not context.tracks)
        lost = sorted(set(workspace.video_names()) - {recording.scene.name for recording in recordings})
        for gone in lost:
            workspace.cut_scene(gone, ())
            remove(workspace.scene_file(gone).parent)
            remove(workspace.labels_file(gone))
        for recording in recordings:
            remove(workspace.cache(recording.scene.name))
            given = recording if context.wants_given else replace(recording, trajectory=None)
            workspace.save_recording(given)
            workspace.save_given(given)
        lines = [f"scene {name}: it is no longer in the recordings; its labels are removed" for name in lost]
        lines += [
            f"scene {recording.scene.name}: {line}"
            for recording in recordings
            for line in (*recording.skipped, *recording.notes, *_certain_faults(recording))
        ]
        return Outcome(sum(len(recording.scene.frames) for recording in recordings), tuple(lines))

    not_here = workspace.truth if context.recipe.twin else workspace.root.resolve()
    seen: Json = {}
    for source in sources:
        seen |= stamps(source.path, but_not=not_here, names=source.names)
    options: Json = {"scenes": [asdict(source) | {"path": str(source.path)} for source in sources]}
    if not context.wants_given:
        options |= {"poses": "tracked"}
    outputs = [workspace.scene_file(name) for name in workspace.video_names()]
    return [
        step(
            "import", "", run, version=VERSION, options=options, sources=seen, after=["twin"], outputs=outputs
        )
    ]


def _certain_faults(recording: Recording) -> list[str]:
    """What times and poses alone prove, without looking at an image; `rpl check` looks closer."""
    scene, trajectory = recording.scene, recording.trajectory
    found = [] if trajectory is None else pose_jumps(scene, trajectory, times_usual=STANDS_OUT)
    return [f"WARNING: {finding.what}; {finding.todo}" for finding in found]


def _emptied(workspace: Workspace, scene: str) -> Path:
    folder = workspace.images(scene)
    remove(folder)
    return folder


def read_recordings(
    sources: Sequence[SceneSource], *, unpack: Callable[[str], Path] | None = None, poses: bool = True
) -> list[Recording]:
    """Read all scenes of all sources; DataError when two share a name or one has no poses.

    Args:
        sources: the sources of the scenes.
        unpack: returns an empty folder for the images of a scene whose recording is a single file.
        poses: whether a scene without poses is refused.
    """
    recordings: dict[str, Recording] = {}
    for source in sources:
        for recording in open_scenes(**vars(source), unpack=unpack):
            name = checked_name(recording.scene.name, "scene", where=str(source.path))
            if name in recordings:
                raise DataError(
                    f"two scenes are called {name}: {recordings[name].scene.source} and "
                    f"{recording.scene.source}; rename a folder, or choose scenes by `names`"
                )
            if recording.trajectory is None and poses:
                raise DataError(
                    f"scene {name} in {source.path} has no camera poses; write "
                    "`reconstruct: {method: track}` in the recipe to compute them"
                )
            recordings[name] = recording
    return list(recordings.values())
