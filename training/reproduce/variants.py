"""The same recording and the same clicks, built by other recipes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rpl_data.files import write_text
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.context import crop_of, truth_workspace
from rpl_data.pipeline.recipe import CropBox, ObjectRecipe, Recipe
from rpl_data.pipeline.stages.clicks import clicks_table
from rpl_data.workspace.workspace import Workspace

from .building import build_and_tell

Change = Callable[[Recipe], Recipe]


def built_beside(
    workspace: Workspace, folder: Path, change: Change, *, until: str = "label", workers: int | None
) -> Workspace:
    """Build a workspace's recording and clicks in another folder by a changed recipe.

    Steps that are up to date there are not run again.
    """
    made = Workspace(folder)
    build_and_tell(change(same_input(workspace, folder / "clicks.csv")), made, until=until, workers=workers)
    return made


def copied(workspace: Workspace, folder: Path) -> None:
    """Copy a workspace that `built_beside` made, so that a variant need not build anew what they share."""
    if workspace.root.exists() and not folder.exists():
        shutil.copytree(workspace.root, folder)


def same_input(workspace: Workspace, clicks: Path) -> Recipe:
    """The recipe of a workspace with its recording and truth in place, and its clicks in a file."""
    context = context_of(workspace)
    truth = truth_workspace(context)
    write_text(clicks, clicks_table(workspace))

    def with_input(item: ObjectRecipe) -> ObjectRecipe:
        crop = crop_of(workspace, item)
        return replace(item, clicks=clicks, crop=None if crop is None else CropBox(*crop))

    return replace(
        context.recipe,
        twin=None,
        scenes=context.scene_sources,
        objects=tuple(with_input(item) for item in context.objects),
        truth=None if truth is None else truth.root,
    )
