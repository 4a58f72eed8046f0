"""What a build hands over: exported folders, the comparison with truth, and the report, with their files."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from rpl_data.export import ExportScene, export_coco
from rpl_data.stages import Context, step
from rpl_data.steps import Advance, Json, Ledger, Outcome, Step, stamps
from rpl_data.types import DataError, FrameLabel, QualityRow
from rpl_data.workspace import Workspace

EXPORTS: dict[str, Callable[[Context], Any]] = {}
"""By format name; filled below."""


# Export -------------------------------------------------------------------------------------------


def export_steps(context: Context) -> list[Step]:
    """Labels -> folders that trainers read, one a format."""
    return [_export_step(context, name) for name in context.recipe.export]


def _export_step(context: Context, name: str) -> Step:
    if name not in EXPORTS:
        raise DataError(f"unknown export {name!r} in the recipe; expected one of {', '.join(EXPORTS)}")

    def run(advance: Advance) -> Outcome:
        refuse_unseen(context)
        summary = asdict(EXPORTS[name](context))
        messages = tuple(summary.pop("messages"))
        return Outcome(sum(summary["images"].values()), messages, finite_or_none(summary))

    return step(
        "export",
        name,
        run,
        options={"split": asdict(context.recipe.split), "objects": context.object_names},
        after=[f"label/{scene}" for scene in context.placed_scenes()],
        outputs=[context.workspace.export(name)],
    )


def refuse_unseen(context: Context) -> None:
    """DataError when an object is in none of the labelled frames."""
    counts: Counter[str] = Counter()
    frames = 0
    for entry in Ledger(context.workspace.stages_file).of_stage("label").values():
        counts.update(entry.outcome.details["instances"])
        frames += entry.outcome.frames
    unseen = [name for name in context.object_names if not counts[name]]
    if unseen:
        raise DataError(
            f"object {', '.join(unseen)} is in none of the {frames} labelled frames; expected it in at least one. "
            "Check its clicks and the poses of its scenes, or raise `label.rate`"
        )


def export_labels(context: Context) -> Any:
    """`export/coco` from the labels of the workspace."""
    return _export_coco(context, context.workspace, "coco", {})


def export_truth(context: Context) -> Any:
    """`export/coco_truth`: the same images, ids and schema, with the labels of the truth."""
    truth = truth_workspace(context)
    if truth is None:
        raise DataError(
            "the truth of these scenes is not known; only a recipe with `twin:` or `truth:` can export it"
        )
    coco = context.workspace.export("coco")
    if not coco.exists():
        raise DataError(
            f"there is no {coco} yet; run `rpl export --workspace {context.workspace.root}` first"
        )
    return _export_coco(context, truth, "coco_truth", {"as_in": coco})


def _export_coco(context: Context, labels: Workspace, name: str, options: Json) -> Any:
    workspace = context.workspace
    scenes = []
    for scene_name in labels.labelled_scene_names():
        if not workspace.scene_file(scene_name).exists():
            continue
        scene = workspace.load_scene(scene_name)
        lines: Iterator[FrameLabel] = labels.load_labels(scene_name)
        scenes.append(ExportScene(scene, workspace.load_trajectory(scene), lines))
    models = [labels.load_solution(item).model for item in context.object_names]
    meshes = {
        item: labels.mesh_file(item) for item in context.object_names if labels.mesh_file(item).exists()
    }
    return export_coco(
        workspace.export(name), scenes, models, split=context.recipe.split, meshes=meshes, **options
    )


EXPORTS["coco"] = export_labels


# Quality ------------------------------------------------------------------------------------------


def truth_workspace(context: Context) -> Workspace | None:
    """Where the truth is, when it is known."""
    if context.recipe.truth is not None and context.recipe.truth.is_dir():
        return Workspace(context.recipe.truth)
    known = context.recipe.truth is not None or context.recipe.twin is not None
    return context.workspace.truth if known else None


def quality_steps(context: Context) -> list[Step]:
    """Models and labels against truth, where it is known."""
    recipe, workspace = context.recipe, context.workspace
    truth = truth_workspace(context)
    if truth is None:
        return []

    def run(advance: Advance) -> Outcome:
        from rpl_data.quality import compare_workspaces
        from rpl_data.truth import truth_from_poses

        if recipe.truth is not None and not recipe.truth.is_dir():
            truth_from_poses(workspace, truth, recipe.truth)
        rows = compare_workspaces(workspace, truth)
        return Outcome(
            sum(row.frames for row in rows), details={"rows": [finite_or_none(asdict(r)) for r in rows]}
        )

    before = [f"label/{scene}" for scene in context.placed_scenes()]
    sources = {} if recipe.truth is None else stamps(recipe.truth)
    return [step("quality", "", run, options={}, sources=sources, after=["twin", *before])]


def quality_rows(ledger: Ledger) -> list[QualityRow]:
    """The comparison that the quality stage made last; empty when there was none."""
    entry = ledger.entries.get("quality")
    rows = [] if entry is None else entry.outcome.details["rows"]
    return [QualityRow(**{k: math.nan if v is None else v for k, v in row.items()}) for row in rows]


def finite_or_none(value: Any) -> Any:
    """JSON-ready: NaN becomes null, tuples lists."""
    if isinstance(value, dict):
        return {key: finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# Report -------------------------------------------------------------------------------------------


def timings(ledger: Ledger, stages: Sequence[str]) -> list[tuple[str, float, int]]:
    """Seconds and frames of every stage that ran, in order."""
    rows = []
    for stage in stages:
        entries = ledger.of_stage(stage).values()
        if entries:
            rows.append((stage, sum(e.seconds for e in entries), sum(e.outcome.frames for e in entries)))
    return rows
