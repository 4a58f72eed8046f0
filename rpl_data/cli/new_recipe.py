"""The recipe of a recording that has none: the doctor looks at it, the person names the object."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory

from rpl_data.cli.building import workspace_for
from rpl_data.cli.check import recordings_at
from rpl_data.cli.screen import Screen, print_diagnoses
from rpl_data.pipeline.build import alone_in, context_of
from rpl_data.pipeline.first_recipe import (
    HowStored,
    KeypointsSaid,
    keypoints_from,
    objects_clicked,
    path_from,
    recipe_text,
)
from rpl_data.pipeline.recipe import Recipe
from rpl_data.pipeline.recipe_file import recipe_from_text, resolve_paths
from rpl_data.pipeline.remotes import fetched
from rpl_data.recordings.open import only_format
from rpl_data.types import DataError
from rpl_data.untrusted.names import checked_name
from rpl_data.workspace.workspace import Workspace

NOTHING_TOLD = HowStored()
USUAL_OBJECT, USUAL_KEYPOINTS = "object", "8"


def text_for(
    recording: Path,
    recipe: Path,
    *,
    object: str | None = None,
    keypoints: str | None = None,
    told: HowStored = NOTHING_TOLD,
    asks: bool = False,
) -> str:
    """The recipe's text; prints in a line per scene what the doctor says on the way.

    Args:
        recording: where it is.
        recipe: the file that the text is for; paths in it start at its folder.
        object: what the object is called; as in the recording's clicks.csv, or asked for, when None.
        keypoints: how many, or their names with commas; likewise.
        told: how it is stored; the format is guessed when it is None.
        asks: whether somebody is there to ask.

    Raises:
        DataError: nothing can be read there, or a name cannot be one.
    """
    chosen = told.format or only_format(recording)
    clicks = recording / "clicks.csv"
    clicked = objects_clicked(clicks) if object is None else []
    objects = clicked or [_named(object, keypoints, asks=asks)]
    if clicked and keypoints is not None:
        raise DataError(f"{clicks} says which keypoints there are; give --keypoints together with --object")
    with TemporaryDirectory() as scratch:
        found = recordings_at(recording, Path(scratch), format=chosen, camera=told.camera, topics=told.topics)
        examined = list(zip(found, print_diagnoses(found, briefly=True), strict=True))
    if any(diagnosis.findings for _, diagnosis in examined):
        full = f"rpl check {quote(str(recording))}"
        print(f"the recipe mends what can be mended and names the rest; in full:  {full}")
    return recipe_text(
        path_from(recipe, recording),
        replace(told, format=chosen),
        examined,
        name=recipe.stem,
        objects=objects,
        clicks=path_from(recipe, clicks) if clicked else None,
    )


def recipe_for(
    recording: Path,
    workspace: Path,
    *,
    object: str | None = None,
    keypoints: str | None = None,
    told: HowStored = NOTHING_TOLD,
) -> Recipe:
    """The recipe of a lone recording, which no file holds; DataError as `text_for`.

    A workspace that was made of this recording keeps the recipe it has: objects may have been added to it.
    """
    kept = Workspace(workspace)
    if kept.recipe_file.exists() and object is None and keypoints is None and told == NOTHING_TOLD:
        known = context_of(kept)
        if [source.path.resolve() for source in known.scene_sources] == [recording.resolve()]:
            return known.recipe
    stem = "recording" if workspace.name in ("", "..") else workspace.name
    place = Path.cwd() / f"{stem}.yaml"
    text = text_for(recording, place, object=object, keypoints=keypoints, told=told)
    return resolve_paths(recipe_from_text(text, source=str(recording)), place.parent)


def recipe_at(
    address: Path,
    workspace: Path,
    *,
    object: str | None = None,
    keypoints: str | None = None,
    told: HowStored = NOTHING_TOLD,
) -> Recipe:
    """As `recipe_for`, of a recording in an object store, which is copied into the workspace first."""
    place = Workspace(workspace)
    with alone_in(place), Screen() as screen:
        copy = fetched(address, place, screen.tell)
    recipe = recipe_for(copy, workspace, object=object, keypoints=keypoints, told=told)
    return replace(recipe, scenes=tuple(replace(source, path=address) for source in recipe.scenes))


def next_commands(recipe: Path, *, clicked: bool) -> str:
    """What to run now, as a shell takes it: a path with a space is quoted."""
    file, workspace = quote(str(recipe)), quote(str(workspace_for(recipe)))
    build = f"rpl build {file} --workspace {workspace}"
    if clicked:
        return f"its keypoints are clicked; make the dataset:  {build}"
    annotate = f"rpl annotate {workspace} --recipe {file}"
    return f"next, click the keypoints in the browser:  {annotate}\nthen make the dataset:  {build}"


def assumed(object: str | None, keypoints: str | None) -> str:
    """What nobody said of the object, so that a recipe has what is usual; empty where all was said."""
    name = [f"that the object is called {USUAL_OBJECT!r}"] if object is None else []
    number = [f"{USUAL_KEYPOINTS} keypoints without names"] if keypoints is None else []
    return " and ".join([*name, *number])


def _named(object: str | None, keypoints: str | None, *, asks: bool) -> tuple[str, KeypointsSaid]:
    """The object, as the options say, or as the person answers."""
    if object is None:
        object = _asked("what is the object called?", USUAL_OBJECT) if asks else USUAL_OBJECT
    if keypoints is None:
        question = "how many keypoints has it, or their names with commas?"
        keypoints = _asked(question, USUAL_KEYPOINTS) if asks else USUAL_KEYPOINTS
    return checked_name(object, "object"), keypoints_from(keypoints, where="--keypoints")


def _asked(question: str, usual: str) -> str:
    return input(f"{question} [{usual}] ").strip() or usual
