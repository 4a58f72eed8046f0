"""`rpl_data.build`: the whole pipeline in one call, from Python."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from rpl_data.pipeline import build as pipeline
from rpl_data.pipeline.build import stages_named
from rpl_data.pipeline.progress import Progress, Tell
from rpl_data.pipeline.recipe import Recipe
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace


def build(
    recipe: str | Path | Recipe,
    workspace: str | Path | Workspace,
    *,
    root: str | Path | None = None,
    until: str | None = None,
    again: str | Collection[str] = (),
    workers: int | None = None,
    dask: str | None = None,
    keep_going: bool = False,
    tell: Tell | None = None,
) -> Workspace:
    """Make everything that a recipe asks for; only what is out of date is run.

    It may be interrupted anywhere: call it again and it goes on from there. Relative paths of a recipe file
    start at the folder of that file, or at `root`.

    Args:
        recipe: the YAML file, or what `load_recipe` returned.
        workspace: the folder for everything that is made; it is created when it is not there.
        root: where the relative paths of the recipe file start.
        until: the last stage to run, "solve" say; all of them when left out.
        again: a stage, or several, to run although nothing they depend on has changed; "all" for all.
        workers: number of processes; one per core when left out, 1 = this process only. More than one needs
            a program that can be imported: keep its calls below `if __name__ == "__main__":`.
        dask: a Dask cluster that does the work instead: `tcp://HOST:PORT` of its scheduler, or `local:N`, N
            processes of this machine. Its workers must see recordings and workspace at the same paths.
        keep_going: where a step fails in one scene, or a recording cannot be read now, leave that out and
            make the rest; what failed is raised at the end.
        tell: called with the `Progress` of every step, as often as it advances; its `state` is "ran" when
            the step is finished. `print` shows a line each time; nothing is printed when left out.

    Returns:
        The workspace. `print` it to see what it holds; what the stages had to say is in its report.

    Raises:
        DataError: something that you can mend; the message says what, where and how. Steps that were
            finished stay finished.
    """
    place = workspace if isinstance(workspace, Workspace) else Workspace(workspace)
    chosen = stages_named(again, until)
    pipeline.build(
        _recipe(recipe, root),
        place,
        until=until,
        again=chosen,
        workers=workers,
        dask=dask,
        keep_going=keep_going,
        tell=tell or _say_nothing,
    )
    return place


def _say_nothing(progress: Progress) -> None:
    """Progress that nobody asked for."""


def _recipe(recipe: str | Path | Recipe, root: str | Path | None) -> Recipe:
    if not isinstance(recipe, Recipe):
        return load_recipe(recipe, root=root)
    if root is not None:
        raise DataError("root is for a recipe file; give it to `load_recipe`, which made this recipe")
    return recipe
