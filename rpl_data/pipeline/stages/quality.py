"""Stage `quality`: compare models and labels with the ground truth, where it is known."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step, stamps
from rpl_data.types import QualityRow
from rpl_data.workspace.workspace import Workspace

VERSION = 1
"""Raised when the stage writes something else for the same input; its steps then run again."""


def truth_workspace(context: Context) -> Workspace | None:
    """The workspace with the ground truth; None when it is not known."""
    if context.recipe.truth is not None and context.recipe.truth.is_dir():
        return Workspace(context.recipe.truth)
    known = context.recipe.truth is not None or context.recipe.twin is not None
    return Workspace(context.workspace.truth) if known else None


def quality_steps(context: Context) -> list[Step]:
    """Plan the comparison of models and labels with the truth, where it is known."""
    recipe, workspace = context.recipe, context.workspace
    truth = truth_workspace(context)
    if truth is None:
        return []

    def run(advance: Advance) -> Outcome:
        from rpl_data.evaluate.quality import compare_workspaces
        from rpl_data.evaluate.truth import truth_from_poses

        if recipe.truth is not None and not recipe.truth.is_dir():
            truth_from_poses(workspace, truth, recipe.truth)
        rows = compare_workspaces(workspace, truth)
        return Outcome(
            sum(row.frames for row in rows), details={"rows": [finite_or_none(asdict(r)) for r in rows]}
        )

    before = [f"label/{video}" for video in context.placed_videos()]
    sources = {} if recipe.truth is None else stamps(recipe.truth)
    return [step("quality", "", run, version=VERSION, options={}, sources=sources, after=["twin", *before])]


def quality_rows(ledger: Ledger) -> list[QualityRow]:
    """Rows of the last comparison that this stage made; empty when there was none."""
    entry = ledger.entries.get("quality")
    rows: Any = [] if entry is None else entry.outcome.details["rows"]
    filled: list[dict[str, Any]] = [{k: math.nan if v is None else v for k, v in row.items()} for row in rows]
    return [QualityRow(**row) for row in filled]


def finite_or_none(value: Any) -> Any:
    """Make a value JSON-ready: NaN becomes null, tuples become lists."""
    if isinstance(value, dict):
        return {key: finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
