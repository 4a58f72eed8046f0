"""Stage `quality`: compare models and labels with the ground truth, where it is known."""

from __future__ import annotations

from dataclasses import asdict

from rpl_data.json_arrays import finite_or_none
from rpl_data.pipeline.context import Context, step, truth_workspace
from rpl_data.pipeline.ledger import Advance, Outcome, Step, stamps

VERSION = 1
"""Increase it when the stage writes something else for the same input: its steps then run again."""


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
