"""Builds of the experiments, with the lines that `rpl build` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rpl_data.pipeline.recipe import Recipe
    from rpl_data.workspace.workspace import Workspace


def build_and_tell(
    recipe: Recipe, workspace: Workspace, *, until: str | None = None, workers: int | None
) -> None:
    """Run the steps that are out of date, and say which workspace it is and how far they are."""
    from rpl_data.cli.screen import Screen
    from rpl_data.pipeline.build import build

    print(f"building {workspace.root}", flush=True)
    with Screen() as screen:
        build(recipe, workspace, until=until, workers=workers, tell=screen.tell)
