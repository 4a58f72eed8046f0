"""The labels of a workspace, or the truth of its scenes, as the COCO folder that all formats are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rpl_data.export import ExportScene, ExportSummary, export_coco
from rpl_data.export.card import dataset_card
from rpl_data.export.checksums import write_checksums
from rpl_data.export.corrections import Corrector
from rpl_data.files import write_text
from rpl_data.json_arrays import Json
from rpl_data.pipeline.choice import recipe_splits, splits_like, videos_with
from rpl_data.pipeline.context import Context, truth_workspace
from rpl_data.pipeline.frames import exported_mesh, frames_for, moved_label, moved_model
from rpl_data.pipeline.good_enough import Keep, QualityTally
from rpl_data.pipeline.grasp import save_grasps
from rpl_data.pipeline.symmetry import frame_change, symmetry_turns
from rpl_data.symmetries import moved_symmetries, symmetries_of
from rpl_data.types import DataError, FrameLabel, KeypointModel, Symmetries
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace


def export_labels(context: Context) -> ExportSummary:
    """Write `export/coco` from the labels of the workspace that are good enough."""
    least = context.recipe.export.min_quality
    tally = QualityTally()
    models = [context.workspace.load_placed(name).model for name in context.object_names]
    corrector = Corrector(context.workspace.load_corrections(), models)
    try:
        summary = _export_coco(
            context, context.workspace, "coco", {}, tally.good_enough(least), corrector.corrected
        )
    except DataError as error:
        if not tally.frames or tally.frames_left_out < tally.frames:
            raise
        raise DataError(
            f"all {counted(tally.frames, 'labelled frame')} would be left out, since a label in each has a "
            f"quality below {least:g}: check the clicks and the trajectories, or lower `min_quality`"
        ) from error
    _write_card(context, summary, models)
    said = (*tally.messages(least), *corrector.messages(), *earlier_lines(context.workspace))
    return replace(summary, low_quality=dict(tally.low), messages=(*summary.messages, *said))


def earlier_lines(workspace: Workspace) -> list[str]:
    """One line per recording that has labels of an earlier build alone."""
    return [
        f"scene {name} is left out: its labels in {workspace.earlier_labels_file(name)} are of an earlier "
        "build, and in no export and not in the report"
        for name in workspace.earlier_labelled_names()
    ]


def _write_card(context: Context, summary: ExportSummary, models: Sequence[KeypointModel]) -> None:
    """Put the dataset's card beside its files."""
    scenes = [scene for split in summary.scenes.values() for scene in split]
    counted_objects = {name for counts in summary.instances.values() for name in counts}
    card = dataset_card(
        context.recipe.name,
        licence=context.recipe.export.license,
        summary=summary,
        models=[model for model in models if model.name in counted_objects],
        cameras={scene: context.workspace.load_scene(scene).intrinsics for scene in sorted(set(scenes))},
        min_quality=context.recipe.export.min_quality,
    )
    folder = context.export_folder("coco")
    write_text(folder / "README.md", card)
    write_checksums(folder, beside=folder)


def export_truth(context: Context) -> ExportSummary:
    """Write `export/coco_truth`: the same images, ids and schema, with the labels of the truth."""
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


def _export_coco(
    context: Context,
    labels: Workspace,
    name: str,
    options: Json,
    keep: Keep = lambda label: True,
    correct: Callable[[FrameLabel], FrameLabel] = lambda label: label,
) -> ExportSummary:
    workspace, objects = context.workspace, context.choice.objects(context.object_names)
    known = recipe_splits(workspace) if context.choice.folder else {}
    frames = frames_for(context, labels)
    scenes = []
    for scene_name in labels.labelled_scene_names():
        if not workspace.scene_file(scene_name).exists():
            continue
        if objects != context.object_names and scene_name not in videos_with(workspace, objects):
            continue
        scene = workspace.load_scene(scene_name)
        kept = _without(labels.load_labels(scene_name), workspace.load_left_out(scene_name))
        lines = filter(keep, context.choice.chosen(map(correct, kept), splits_like(known)))
        moved = (moved_label(line, frames) for line in lines)
        scenes.append(ExportScene(scene, workspace.load_trajectory(scene), moved))
    models = [moved_model(labels.load_placed(item).model, frames.get(item)) for item in objects]
    meshes = {
        item: exported_mesh(workspace, labels, item, frames.get(item))
        for item in objects
        if labels.mesh_file(item).exists()
    }
    grasps = save_grasps(workspace, objects) if labels == workspace else {}
    grasps = {item: frames.get(item, np.eye(4)) @ grasp for item, grasp in grasps.items()}
    return export_coco(
        context.export_folder(name),
        scenes,
        models,
        split=splits_like(known) if context.choice.folder else context.recipe.split,
        meshes=meshes,
        grasps=grasps,
        symmetries=_symmetries(context, models),
        frames=frames,
        images=context.recipe.export.images,
        **options,
    )


def _symmetries(context: Context, models: Sequence[KeypointModel]) -> dict[str, Symmetries]:
    """What leaves the objects looking the same, in the frames of these models."""
    found = {}
    items = {item.name: item for item in context.objects}
    for model in models:
        item = items[model.name]
        turns = symmetry_turns(context, item)
        if turns:
            own = context.workspace.load_placed(item.name).model
            found[item.name] = moved_symmetries(symmetries_of(turns), frame_change(model, own))
    return found


def _without(labels: Iterator[FrameLabel], left_out: frozenset[int]) -> Iterator[FrameLabel]:
    """Drop the frames that the user excluded."""
    return (label for label in labels if label.frame not in left_out)
