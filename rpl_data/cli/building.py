"""What the commands that build share. No command is defined here.

jsonargparse imports what stands under `if TYPE_CHECKING` in the module of a command, which would make
`rpl --help` slow.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rpl_data.export.coco import ExportSummary
    from rpl_data.export.dialect import DialectSummary
    from rpl_data.pipeline.ledger import Ledger
    from rpl_data.pipeline.recipe import Recipe

HERE = Path(".")
"""The workspace, when none is named."""


def workspace_for(source: Path) -> Path:
    """The workspace of a recipe or recording when none is named.

    The current folder if it is a workspace, else a folder in `workspaces/`.
    """
    from rpl_data.workspace.paths import Paths

    return HERE if Paths(HERE).stages_file.exists() else Path("workspaces") / source.resolve().stem


def run_stage(
    workspace: Path, stage: str, again: bool, workers: int | None = None, *, results: bool = True
) -> Ledger:
    """Run a stage of a workspace, and what is out of date before it."""
    from rpl_data.pipeline.build import recipe_of
    from rpl_data.workspace.workspace import Workspace

    recipe = recipe_of(Workspace(workspace))
    return run_build(recipe, workspace, stage, stage if again else None, workers, results=results)


def run_build(
    recipe: Recipe,
    workspace: Path,
    until: str | None,
    again: str | None,
    workers: int | None = None,
    *,
    dask: str | None = None,
    keep_going: bool = False,
    results: bool = True,
) -> Ledger:
    """Build with progress on the terminal, and say what came out unless more is to follow."""
    from rpl_data.cli.screen import Screen, print_results
    from rpl_data.pipeline.build import build, fresh_steps, stages_named
    from rpl_data.workspace.workspace import Workspace

    chosen = stages_named(again, until)
    place = Workspace(workspace)
    with Screen() as screen:
        ledger = build(
            recipe,
            place,
            until=until,
            again=chosen,
            workers=workers,
            dask=dask,
            keep_going=keep_going,
            tell=screen.tell,
        )
    if results:
        print_results(place, ledger, screen, until, fresh_steps(recipe, place))
    return ledger


def say_written(folder: Path, summary: ExportSummary | DialectSummary) -> None:
    """Print where an export is, how many images it has, and what it left out."""
    images = f": {sum(summary.images.values())} images" if summary.images else ""
    print(f"{folder}{images}")
    for line in summary.messages:
        print(f"    {line}")
