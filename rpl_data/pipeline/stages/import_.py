"""Stage `import`: read recordings into scenes of the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from rpl_data.doctor.tags import orientation_tags
from rpl_data.doctor.timing import odd_times, pose_jumps
from rpl_data.files import remove
from rpl_data.json_arrays import Json
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step, stamps
from rpl_data.pipeline.recipe import SceneSource
from rpl_data.pipeline.sources import recordings_of
from rpl_data.types import DataError, Recording
from rpl_data.workspace.workspace import Workspace

VERSION = 2
"""Increase it when the stage writes something else for the same input: its steps then run again."""

NOT_REGISTERED = (
    "depth is not registered to colour, so this scene cannot be labelled; before you click, write "
    "`registered: true` for it in the recipe if the camera aligned it, or the `mend:` that `rpl check` "
    "names, or record again with depth aligned to colour"
)
"""Said at once: the stage that refuses it comes after all the clicking."""
KEPT_APART = (
    "scene {}: it was not read, as it or another scene of the same source in the recipe cannot be read now; "
    "what was made of it is kept, and left out of this build"
)


def import_steps(context: Context) -> list[Step]:
    """Plan the step that reads all recordings, and removes scenes that are in them no longer."""
    workspace, sources = context.workspace, context.scene_sources

    def run(advance: Advance) -> Outcome:
        unpack = partial(_emptied, workspace)
        faults: dict[str, DataError] | None = {} if context.keep_going else None
        recordings = recordings_of(sources, unpack=unpack, faults=faults)
        if not context.tracks:
            _refuse_without_poses(recordings)
        gone = sorted(set(workspace.video_names()) - {recording.scene.name for recording in recordings})
        lines = [KEPT_APART.format(name) if faults else _removed(workspace, name) for name in gone]
        for recording in recordings:
            remove(workspace.cache(recording.scene.name))
            _save(context, recording)
        lines += [
            f"scene {recording.scene.name}: {line}"
            for recording in recordings
            for line in (*recording.skipped, *recording.notes, *_certain_faults(recording))
        ]
        frames = sum(len(recording.scene.frames) for recording in recordings)
        if not faults:
            return Outcome(frames, tuple(lines))
        left_out = {path: str(error) for path, error in faults.items()}
        return Outcome(frames, tuple(lines), {"left_out": left_out, "unread": gone})

    not_here = workspace.truth if context.recipe.twin else workspace.root.resolve()
    seen: Json = {}
    for source in sources:
        seen |= stamps(source.path, but_not=not_here, names=source.names)
    options: Json = {"scenes": [_options(source) for source in sources]}
    if not context.wants_given:
        options |= {"poses": "tracked"}
    outputs = [workspace.scene_file(name) for name in workspace.video_names()]
    return [
        step(
            "import", "", run, version=VERSION, options=options, sources=seen, after=["twin"], outputs=outputs
        )
    ]


def unread_recordings(ledger: Ledger) -> frozenset[str]:
    """Recordings of earlier builds that the last import could not read: they stay, and are left out."""
    entry = ledger.entries.get("import")
    return frozenset(entry.outcome.details.get("unread", ()) if entry else ())


def _removed(workspace: Workspace, name: str) -> str:
    """Remove a scene that is not in the recordings any more, but for its labels, and say so."""
    is_labelled = workspace.set_labels_aside(name)
    workspace.cut_scene(name, ())
    remove(workspace.scene_file(name).parent)
    kept = f"; its labels are kept in {workspace.earlier_labels_file(name)}" if is_labelled else ""
    return f"scene {name}: it is no longer in the recordings, so it is removed{kept}"


def _save(context: Context, recording: Recording) -> None:
    """Write a scene; its path stays where it was made of the same poses, as `track` may not run again."""
    workspace = context.workspace
    given = recording if context.wants_given else replace(recording, trajectory=None)
    has_path = context.tracks and workspace.has_path_of(given)
    workspace.save_recording(replace(given, trajectory=None) if has_path else given)
    workspace.save_given(given)


def _options(source: SceneSource) -> Json:
    options: Json = asdict(source) | {"path": str(source.path)}
    if source.topics is None:  # as ledgers had it before there were topics: old imports stay valid
        del options["topics"]
    del options["masks"]  # they are not read with the recording
    if not source.moving:
        del options["moving"]
    return options


def _certain_faults(recording: Recording) -> list[str]:
    """What times, poses and tags alone prove, without decoding an image; `rpl check` looks closer."""
    scene, trajectory = recording.scene, recording.trajectory
    found = orientation_tags(scene) + odd_times(scene)
    found += [] if trajectory is None else pose_jumps(scene, trajectory)
    lines = [f"{finding.what}; {finding.todo}" for finding in found]
    return [f"WARNING: {line}" for line in lines + ([] if scene.registered else [NOT_REGISTERED])]


def _emptied(workspace: Workspace, scene: str) -> Path:
    folder = workspace.images(scene)
    remove(folder)
    return folder


def _refuse_without_poses(recordings: Sequence[Recording]) -> None:
    for recording in recordings:
        if recording.trajectory is None:
            raise DataError(
                f"scene {recording.scene.name} in {recording.scene.source} has no camera poses; write "
                "`reconstruct: {method: track}` in the recipe to compute them"
            )
