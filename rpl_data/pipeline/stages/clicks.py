"""Stage `clicks`: bring keypoint names and clicks into the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rpl_data.clicks.incoming import Incoming, click_key, incoming
from rpl_data.clicks.log import keypoints_event
from rpl_data.clicks.table import clicks_from_csv, objects_in_csv, tables_to_csv
from rpl_data.files import read_text
from rpl_data.geometry import inside_image
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step, stamps
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.types import Click, DataError, Scene
from rpl_data.types.instances import scene_of
from rpl_data.types.keypoint_names import keypoint_titles
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace

VERSION = 1
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def clicks_steps(context: Context) -> list[Step]:
    """Plan the steps that write keypoint names, and the clicks of a CSV file, to each object's log."""
    return [_clicks_step(context, item) for item in context.objects]


def _clicks_step(context: Context, item: ObjectRecipe) -> Step:
    workspace = context.workspace

    def run(advance: Advance) -> Outcome:
        if item.clicks is None:
            return _name_keypoints(workspace, item)
        if context.keep_going and not item.clicks.exists() and workspace.load_annotation(item.name).clicks:
            line = f"{item.name}: {item.clicks} is not there; its clicks stay as they are in the workspace"
            known = {} if before is None else {"clicks": _stored(item, before)}
            return Outcome(messages=(line,), details=known)
        found, clicks, kept = import_clicks(workspace, item, item.clicks, before)
        lines = [f"{item.name}: {found}, from {item.clicks}"] if found.changed else []
        if kept:
            lines.append(
                f"{item.name}: {counted(kept, 'click')} made on the page or by `rpl clicks import` "
                f"{'stays' if kept == 1 else 'stay'}, whatever {item.clicks} says; take them back on the page"
            )
        return Outcome(messages=tuple(lines), details={"clicks": _stored(item, clicks)})

    before = _last_imported(workspace, item)

    options = {
        "keypoints": list(item.keypoint_names),
        "clicks": None if item.clicks is None else str(item.clicks),
    }
    sources = stamps(item.clicks) if item.clicks else {}
    return step("clicks", item.name, run, version=VERSION, options=options, sources=sources)


def _name_keypoints(workspace: Workspace, item: ObjectRecipe) -> Outcome:
    """Take the names from the recipe, once: later changes on the annotation page take precedence."""
    named = workspace.load_annotation(item.name).keypoints
    if not named:
        workspace.append_events(item.name, [keypoints_event(item.keypoint_names)])
    elif named != item.keypoint_names:
        line = f"{item.name}: its keypoints are those of its clicks, {', '.join(named)}; not the recipe's"
        return Outcome(messages=(line,))
    return Outcome()


def _stored(item: ObjectRecipe, clicks: Sequence[Click]) -> list[list[str | int | float]]:
    """The clicks of a file as the ledger keeps them: with the names of their keypoints."""
    return [[item.keypoint_names[c.keypoint], c.scene, c.frame, c.u_px, c.v_px] for c in clicks]


def _last_imported(workspace: Workspace, item: ObjectRecipe) -> list[Click] | None:
    """The clicks of the CSV file when it was last imported; None where nobody knows."""
    entry = Ledger(workspace.stages_file).entries.get(f"clicks/{item.name}")
    if entry is None or "clicks" not in entry.outcome.details:
        return None
    number = {name: k for k, name in enumerate(item.keypoint_names)}
    rows = entry.outcome.details["clicks"]
    return [Click(item.name, number[name], *at) for name, *at in rows if name in number]


def import_clicks(
    workspace: Workspace, item: ObjectRecipe, path: Path, before: Sequence[Click] | None = None
) -> tuple[Incoming, list[Click], int]:
    """Make the log of an object agree with the CSV file, but for what was clicked elsewhere since.

    Args:
        before: the clicks of the file when it was last imported; None where nobody knows, and then no click
            is removed.

    Returns:
        What changes, the clicks of the file, and how many clicks are not as the file has them.
    """
    table = clicks_from_csv(
        read_text(path), source=str(path), object_name=item.name, keypoints=item.keypoint_names
    )
    in_scene = workspace.parts().click_in_scene
    annotation = workspace.load_annotation(item.name)
    was, now = ({click_key(c): c for c in map(in_scene, found)} for found in (before or (), table))
    number = {name: k for k, name in enumerate(item.keypoint_names)}  # the log may have another order
    there = [
        replace(click, keypoint=number[annotation.keypoints[click.keypoint]])
        for click in annotation.clicks
        if annotation.keypoints[click.keypoint] in number
    ]
    old = {click_key(click): click for click in there}
    # Untouched since the last import: such clicks follow the file. All others are the person's own.
    own = {key for key in old.keys() | was.keys() if old.get(key) != was.get(key)}
    if before is None:
        own -= now.keys()
    wanted = {key: click for key, click in now.items() if key not in own}
    wanted |= {key: click for key, click in old.items() if key in own}
    found = incoming(annotation, item.keypoint_names, wanted.values(), replaces=True)
    if found.events:
        workspace.append_events(item.name, found.events)
    return found, table, sum(wanted.get(key) != now.get(key) for key in own)


def add_clicks(
    context: Context, path: Path, *, proposed: bool = False, replaces: bool = False
) -> dict[str, Incoming]:
    """Add the clicks of a CSV file to the logs, or put them in place of others; what changed, by object.

    Args:
        context: context of the workspace.
        path: the CSV file.
        proposed: the clicks come from a program: skip keypoints that were already clicked in that scene
            or declared not visible there.
        replaces: the other clicks of the objects in the file are removed.

    Raises:
        DataError: the file names an object, a keypoint, a scene or a frame that is not there, or a
            pixel outside the image, or holds no click; nothing is added then.
    """
    text = read_text(path)
    named = set(objects_in_csv(text, source=str(path)))
    if not named:
        raise DataError(f"{path} holds no click, only the names of its columns; nothing is added")
    chosen = [item for item in context.objects if item.name in named]
    if not chosen or named - set(context.object_names):
        raise DataError(
            f"{path} has clicks for {', '.join(sorted(named))}; "
            f"the recipe has the objects {', '.join(context.object_names)}; use the same names"
        )
    found = {}
    for item in chosen:
        annotation = context.workspace.load_annotation(item.name)
        names = annotation.keypoints or item.keypoint_names
        clicks = clicks_from_csv(text, source=str(path), object_name=item.name, keypoints=names)
        clicks = [context.workspace.parts().click_in_scene(click) for click in clicks]
        _refuse_unknown_places(context.workspace, clicks, names, path)
        read = len(clicks)
        if proposed:
            decided = annotation.skipped | {(click.keypoint, click.scene) for click in annotation.clicks}
            clicks = [click for click in clicks if (click.keypoint, click.scene) not in decided]
        change = incoming(annotation, names, clicks, replaces=replaces)
        found[item.name] = replace(change, decided=read - len(clicks))
    for name, change in found.items():  # only after the whole file was read
        context.workspace.append_events(name, change.events)
    return found


def _refuse_unknown_places(
    workspace: Workspace, clicks: Sequence[Click], keypoints: Sequence[str], path: Path
) -> None:
    """Such a click would stop every later solve, and only the annotation page could take it back."""
    known = workspace.scene_names()
    titles = keypoint_titles(keypoints)
    for name in dict.fromkeys(click.scene for click in clicks):
        if scene_of(name) not in known:
            raise DataError(
                f"{path} has clicks in scene {scene_of(name)}; the workspace has the scenes "
                f"{', '.join(known)}; use the same names"
            )
        scene = workspace.load_scene(scene_of(name))
        for click in clicks:
            if click.scene == name:
                _refuse_outside(scene, click, where=f"{path}, keypoint {titles[click.keypoint]}")


def _refuse_outside(scene: Scene, click: Click, *, where: str) -> None:
    """Raise a DataError where a scene has no such frame, or the click is not on its image."""
    try:
        scene.frame(click.frame)
    except DataError as error:
        raise DataError(f"{where}: {error}") from error
    camera = scene.intrinsics
    if not inside_image(camera, np.array([[click.u_px, click.v_px]])).all():
        raise DataError(
            f"{where}: ({click.u_px:.1f}, {click.v_px:.1f}) px lies outside the image of scene "
            f"{scene.name}, which has {camera.width} x {camera.height} px; give pixels of the whole image"
        )


def clicks_table(workspace: Workspace) -> str:
    """Write the clicks of all objects as CSV with one heading."""
    annotations = [workspace.load_annotation(name) for name in workspace.object_names()]
    in_video = workspace.parts().click_in_video
    tables = [(map(in_video, found.clicks), found.keypoints) for found in annotations if found.clicks]
    if not tables:
        raise DataError(f"{workspace.root} has no clicks to export")
    return tables_to_csv(tables)
