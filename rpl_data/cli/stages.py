"""The commands that run one stage of a workspace, and what is out of date before it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rpl_data.cli.building import HERE, run_stage, say_written
from rpl_data.types import DataError


def track(workspace: Path = HERE, again: bool = False) -> None:
    """Compute camera poses from the images where a recording has none, and check those that it has.

    Frames are aligned to frames with a similar view by brightness and depth. Poses of the recording are kept
    where that moves the image by less than half a pixel; otherwise both paths are compared on corners and
    depth, and the better one becomes `trajectory.txt`. Frames that cannot be tracked are left out and named.

    Example: rpl track --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "track", again)


def drift(workspace: Path = HERE, again: bool = False) -> None:
    """Measure how far the camera poses of each recording drift, from its own depth images.

    Example: rpl drift --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "drift", again)


def cut(workspace: Path = HERE, again: bool = False) -> None:
    """Cut recordings whose poses drift too far into scenes that are placed by their own clicks.

    The recipe's `reconstruct: {max_drift_mm: 15}` says how far is too far.

    Example: rpl cut --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "cut", again)


def solve(workspace: Path = HERE, again: bool = False) -> None:
    """Turn clicks into sparse models: where each keypoint is, and where the objects stand in each scene.

    The recipe's `solve: {method: slsqp}` is the paper's way: the depth of the clicked pixel, Eq. 2 by SLSQP.

    Example: rpl solve --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "solve", again)


def surface(workspace: Path = HERE, again: bool = False) -> None:
    """Fuse the depth images near the objects into a surface for each scene.

    Example: rpl surface --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "surface", again)


def refine(workspace: Path = HERE, again: bool = False) -> None:
    """Register the scenes of each object on one another, by their surfaces and colours and the clicks.

    A scene keeps the pose of its clicks where parts of its surface that were left out of the registration do
    not agree better with the other scenes afterwards; that is said.

    Example: rpl refine --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "refine", again)


def segment(workspace: Path = HERE, again: bool = False) -> None:
    """Cut the dense model of each object out of the surfaces.

    The recipe's `segment: {method: smooth}` is the paper's way: region growing as in the Point Cloud Library,
    seeded by the keypoints, nothing closed.

    Example: rpl segment --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "segment", again)


def label(workspace: Path = HERE, again: bool = False, workers: int | None = None) -> None:
    """Compute poses, keypoints, boxes and masks of the objects in the chosen frames.

    The recipe's `label: {method: splat}` makes masks the paper's way: the dense model's points, gaps closed.
    `refine: {frames: auto}` corrects the pose of single frames by the print on the object, as slower frames
    show it, where held-out parts of the print agree. `true` corrects without that evidence, `false` never.

    Example: rpl label --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
        workers: number of processes; as many as there are cores when left out, 1 = only this one.
    """
    run_stage(workspace, "label", again, workers)


def export(
    workspace: Path = HERE,
    labels: Literal["own", "truth"] = "own",
    format: str | None = None,
    object: str | None = None,
    min_quality: float | None = None,
    split: Literal["train", "val", "test"] | None = None,
    color: Literal["recorded", "png", "jpg"] | None = None,
    to: str | None = None,
    again: bool = False,
) -> None:
    """Write the labels in the formats of the recipe, to export/ of the workspace.

    A frame is left out, and counted, when a label in it has a lower quality than the recipe's
    `export: {min_quality: 0.25}`. Quality is 1 / (1 + e / 5 px), where e is the label's expected error: 0.25
    stands for 15 px, 0.5 for 5 px. `min_quality: 0` keeps all.

    Formats: coco, and coco_per_object, one file per object and split; yolo for Ultralytics; bop, and
    bop_onboarding, its static videos of each object; ycb_video and linemod, in the layouts of these datasets;
    okt for ObjectKeypointTrainer; foundationpose, reference views for its model-free mode; bundlesdf, a video
    of each object and scene; nerfstudio (with COLMAP's text); huggingface, an image folder for `datasets`;
    webdataset, tar shards; assets, the objects' textured meshes.

    A format with fewer labels (`--object`, `--min-quality`, `--split`) goes to a folder of its own, such as
    export/only_object-mug_split-test/, with the splits of the recipe's export.

    `export: {frame: up}` in the recipe gives all of them a canonical object frame: z up from the table, the
    origin at the centre of the box around the mesh; `box` keeps the axes; three keypoints give origin, x axis
    and plane. Nothing moves in the images.

    Example: rpl export --workspace workspaces/demo --format yolo --object carton --split test

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        labels: `own`, or `truth`: export/coco_truth with the same images, labelled by the truth where it is
            known.
        format: one more format, this time only; the recipe says which are written by every build.
        object: in that format, only this object, in the scenes that have it.
        min_quality: in that format, only frames whose labels have this quality, instead of the recipe's.
        split: in that format, only this split.
        color: in that format, colour images as they were recorded, or all as PNG or JPEG
            (bop, bop_onboarding).
        to: copy what is exported to this address in an object store, such as s3://bucket/cups, this time
            only: a folder per format, only what has changed. `export: {to: ...}` in the recipe says it for
            good.
        again: run the stage even if nothing it depends on has changed.
    """
    from rpl_data.pipeline.choice import ExportChoice

    choice = ExportChoice(object, min_quality, split, color)
    if choice.folder and format is None:
        raise DataError(
            "object, min_quality, split and color choose from one format: add `--format`, such as coco"
        )
    if format is not None:
        from rpl_data.pipeline.stages.export import check_format

        check_format(format)
    if to is not None:
        from rpl_data.pipeline.object_store import check_address

        check_address(to)
    ledger = run_stage(workspace, "export", again, results=format is None)
    if labels == "truth" or format is not None or to is not None:
        from rpl_data.export.checksums import keeping_edited
        from rpl_data.pipeline.build import alone_in, context_of
        from rpl_data.pipeline.exported_labels import export_truth
        from rpl_data.pipeline.remotes import upload_exports
        from rpl_data.pipeline.stages.export import export_chosen
        from rpl_data.workspace.workspace import Workspace

        place = Workspace(workspace)
        with alone_in(place):
            context = context_of(place)
            folders = []
            if labels == "truth":
                truth = place.export("coco_truth")
                with keeping_edited(truth) as kept:
                    say_written(truth, export_truth(context))
                print("".join(f"    {line}\n" for line in kept), end="")
                folders.append(truth)
            if format is not None:
                folder, summary = export_chosen(context, format, choice)
                say_written(folder, summary)
                folders.append(folder)
            if to is not None:
                written = sorted(place.export(item) for item in ledger.of_stage("export"))
                folders = folders or [folder for folder in written if folder.is_dir()]
                print("\n".join(upload_exports(place, folders, to, lambda done, total: None).messages))


def quality(workspace: Path = HERE, again: bool = False) -> None:
    """Compare labels with the truth, where the recipe has a twin or names the truth: mm, px, IoU.

    Example: rpl quality --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    ledger = run_stage(workspace, "quality", again)
    if "quality" not in ledger.entries:
        raise DataError(
            f"the truth of {workspace} is not known; name it with `truth:` in the recipe and build again"
        )


def report(workspace: Path = HERE, again: bool = False) -> None:
    """Write the page to look at: pictures, clicks, models, counts and timings.

    Example: rpl report --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "report", again)
