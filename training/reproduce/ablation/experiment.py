"""What each part of the chain is worth: the chain without it, on the same recording and clicks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rpl_data.types import DataError

if TYPE_CHECKING:
    from rpl_data.types import QualityRow
    from rpl_data.workspace.workspace import Workspace


def ablation(
    workspace: Path,
    out: Path = Path("runs/ablation"),
    parts: list[str] | None = None,
    workers: int | None = None,
) -> None:
    """Errors of the labels without each part of the chain, strict protocol: a part that does not help shows.

    The workspace stays as it is: its recording and clicks are built anew for every line of the table, from
    the first stage that differs.

    Args:
        workspace: a built workspace whose truth is known.
        out: folder for ablation.json, ablation.html and the workspaces that are made.
        parts: which lines: no_refine, papers_solve, papers_segmentation, papers_masks, poses_as_given,
            papers_chain; all when left out. The whole chain (`all`) always comes first.
        workers: processes; one per core when left out.
    """
    from .page import as_text, write_page
    from .parts import PARTS

    chosen = list(dict.fromkeys(["all", *(parts or PARTS)]))
    if unknown := [part for part in chosen if part not in PARTS]:
        raise DataError(f"there is no part {unknown[0]!r}; the parts are {', '.join(PARTS)}")
    found = {part: rows_without(workspace, part, out / "workspaces", workers) for part in chosen}
    path = write_page(out, found)
    print(as_text(found))
    print(path)


def rows_without(source: Path, part: str, folder: Path, workers: int | None) -> list[QualityRow]:
    """Build the recording of a workspace with a part switched, and compare its labels with the truth."""
    from rpl_data.evaluate.quality import compare_workspaces
    from rpl_data.workspace.workspace import Workspace

    from ..variants import built_beside, copied
    from .parts import PARTS

    workspace = Workspace(source)
    truth = truth_of(workspace)
    name = source.resolve().name
    if part != "all":
        copied(Workspace(folder / f"{name}_all"), folder / f"{name}_{part}")
    made = built_beside(workspace, folder / f"{name}_{part}", PARTS[part], workers=workers)
    return compare_workspaces(made, truth)


def truth_of(workspace: Workspace) -> Workspace:
    """The truth of a workspace; DataError when it is not known."""
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.context import truth_workspace

    truth = truth_workspace(context_of(workspace))
    if truth is None:
        raise DataError(f"the truth of {workspace.root} is not known: name it with `truth:` in the recipe")
    return truth
