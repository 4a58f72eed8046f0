"""What a build hands over: exported folders, the comparison with truth, and the report, with their files."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import Any

from rpl_data.export import ExportScene, export_bop, export_coco, export_okt, export_yolo
from rpl_data.pipeline.context import VERSIONS, Context, step
from rpl_data.pipeline.grasps import save_grasps
from rpl_data.pipeline.ledger import Advance, Json, Ledger, Outcome, Step, stamps
from rpl_data.types import DataError, FrameLabel, QualityRow
from rpl_data.workspace.workspace import Workspace

EXPORTS: dict[str, Callable[[Context], Any]] = {}
"""By format name; filled below."""


# Export -------------------------------------------------------------------------------------------


def export_steps(context: Context) -> list[Step]:
    """Labels -> folders that trainers read, one a format; `coco` first, since the others are made of it."""
    return [_export_step(context, name) for name in sorted(context.recipe.export, key=lambda n: n != "coco")]


def refuse_unknown_exports(names: Sequence[str]) -> None:
    """DataError at a name without a writer; asked before a long build, not after."""
    for name in names:
        if name not in EXPORTS:
            raise DataError(f"unknown export {name!r} in the recipe; expected one of {', '.join(EXPORTS)}")
    if names and "coco" not in names:
        raise DataError(f"export {', '.join(names)} is made of `coco`; write `export: [coco, {names[0]}]`")


def _export_step(context: Context, name: str) -> Step:
    def run(advance: Advance) -> Outcome:
        refuse_unseen(context)
        summary = asdict(EXPORTS[name](context))
        messages = tuple(summary.pop("messages"))
        return Outcome(sum(summary["images"].values()), messages, finite_or_none(summary))

    left_out = {scene: sorted(context.workspace.load_left_out(scene)) for scene in context.placed_videos()}
    annotations = [context.workspace.load_annotation(item) for item in context.object_names]
    chosen = {
        "left_out": {scene: frames for scene, frames in left_out.items() if frames},
        "grasps": {item.object: asdict(item.grasp) for item in annotations if item.grasp is not None},
    }
    options = {"split": asdict(context.recipe.split), "objects": context.object_names}
    return step(
        "export",
        name,
        run,
        options=options | {key: value for key, value in chosen.items() if value},
        after=[f"label/{v}" for v in context.placed_videos()] if name == "coco" else ["export/coco"],
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
            f"object {', '.join(unseen)} is in none of the {frames} labelled frames; expected it in at least "
            "one. Check its clicks and the poses of its scenes, or raise `label.rate`"
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
        lines = _kept(labels.load_labels(scene_name), workspace.load_left_out(scene_name))
        scenes.append(ExportScene(scene, workspace.load_trajectory(scene), lines))
    models = [labels.load_solution(item).model for item in context.object_names]
    meshes = {
        item: labels.mesh_file(item) for item in context.object_names if labels.mesh_file(item).exists()
    }
    grasps = save_grasps(workspace, context.object_names) if labels == workspace else {}
    return export_coco(
        workspace.export(name),
        scenes,
        models,
        split=context.recipe.split,
        meshes=meshes,
        grasps=grasps,
        **options,
    )


def _kept(labels: Iterator[FrameLabel], left_out: frozenset[int]) -> Iterator[FrameLabel]:
    """Without the frames that a person keeps out."""
    return (label for label in labels if label.frame not in left_out)


def _yolo(context: Context) -> Any:
    return export_yolo(context.workspace.export("yolo"), context.workspace.export("coco"))


def _bop(context: Context) -> Any:
    workspace = context.workspace
    units = {name: workspace.load_scene(name).metres_per_unit for name in workspace.labelled_scene_names()}
    return export_bop(workspace.export("bop"), workspace.export("coco"), units)


def _okt(context: Context) -> Any:
    return export_okt(context.workspace.export("okt"), context.workspace.export("coco"))


EXPORTS |= {"coco": export_labels, "yolo": _yolo, "bop": _bop, "okt": _okt}


# Quality ------------------------------------------------------------------------------------------


def truth_workspace(context: Context) -> Workspace | None:
    """Where the truth is, when it is known."""
    if context.recipe.truth is not None and context.recipe.truth.is_dir():
        return Workspace(context.recipe.truth)
    known = context.recipe.truth is not None or context.recipe.twin is not None
    return Workspace(context.workspace.truth) if known else None


def quality_steps(context: Context) -> list[Step]:
    """Models and labels against truth, where it is known."""
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
    return [step("quality", "", run, options={}, sources=sources, after=["twin", *before])]


def quality_rows(ledger: Ledger) -> list[QualityRow]:
    """The comparison that the quality stage made last; empty when there was none."""
    entry = ledger.entries.get("quality")
    rows: Any = [] if entry is None else entry.outcome.details["rows"]
    filled: list[dict[str, Any]] = [{k: math.nan if v is None else v for k, v in row.items()} for row in rows]
    return [QualityRow(**row) for row in filled]


def _quality_row(row: Json) -> QualityRow:
    numbers: Json = {name: math.nan if value is None else value for name, value in row.items()}
    return QualityRow(**numbers)


def finite_or_none(value: Any) -> Any:
    """JSON-ready: NaN becomes null, tuples lists."""
    if isinstance(value, dict):
        return {key: finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# Report -------------------------------------------------------------------------------------------


def report_steps(context: Context) -> list[Step]:
    """Everything -> one page a person looks at."""
    workspace = context.workspace

    def run(advance: Advance) -> Outcome:
        from rpl_data.report import write_report

        ledger = Ledger(workspace.stages_file)
        write_report(
            workspace,
            rows=quality_rows(ledger),
            timings=timings(ledger),
            split=split_summary(ledger),
            warnings=[
                line
                for stage in ("cut", "export")
                for entry in ledger.of_stage(stage).values()
                for line in entry.outcome.messages
            ],
            remarks={video: drift_remarks(workspace, ledger, video) for video in workspace.video_names()},
        )
        return Outcome()

    before = ["quality", *(f"export/{name}" for name in context.recipe.export)]
    options = {"name": context.recipe.name}
    return [step("report", "", run, options=options, after=before, outputs=[workspace.report])]


def drift_remarks(workspace: Workspace, ledger: Ledger, video: str) -> list[str]:
    """How far the poses of a recording stray by its depth images, and by the clicks of its keypoints."""
    lines = []
    measured = ledger.entries.get(f"drift/{video}")
    if measured is not None:
        lines.append(f"poses stray by {measured.outcome.details['drift_mm']:.0f} mm")
    for scene in workspace.parts().scenes_of(video):
        spreads = {
            f"{name} {keypoint}": spread
            for name in workspace.object_names()
            if f"solve/{name}" in ledger.entries
            for keypoint, spread in ledger.entries[f"solve/{name}"]
            .outcome.details.get("spread_mm", {})
            .get(scene, {})
            .items()
        }
        if spreads:
            worst = max(spreads, key=lambda keypoint: spreads[keypoint])
            middle = sorted(spreads.values())[len(spreads) // 2]
            where = "" if scene == video else f"{scene}: "
            lines.append(
                f"{where}clicks of a keypoint are {middle:.1f} mm apart over the frames (median), "
                f"at most {spreads[worst]:.1f} mm ({worst})"
            )
    return lines


def timings(ledger: Ledger) -> dict[str, dict[str, float | int]]:
    """Seconds and frames of every stage that ran, in order."""
    found: dict[str, dict[str, float | int]] = {}
    for stage in VERSIONS:
        outcomes = ledger.of_stage(stage).values()
        if outcomes:
            seconds = sum(entry.seconds for entry in outcomes)
            found[stage] = {"seconds": seconds, "frames": sum(entry.outcome.frames for entry in outcomes)}
    return found


def split_summary(ledger: Ledger) -> str:
    """Images and scenes of every split, and how near its views are to training's, a line each."""
    entry = ledger.entries.get("export/coco")
    if entry is None:
        return ""
    lines = []
    for name, images in entry.outcome.details["images"].items():
        scenes = ", ".join(entry.outcome.details["scenes"].get(name, []))
        line = f"{name}: {images} images of {scenes or 'no scene'}"
        near = entry.outcome.details["views"].get(name)
        if near is not None and near["angle_median_deg"] is not None:
            line += (
                f"; views {near['angle_median_deg']:.1f} deg (median), {near['angle_p90_deg']:.1f} deg (p90) "
                "from the nearest of training"
            )
        if near is not None and near["time_median_s"] is not None:
            line += f", {near['time_median_s']:.2f} s (median) from it in time"
        lines.append(line)
    return "\n".join(lines)
