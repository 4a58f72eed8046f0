"""Stage `export`: write the labels to folders that trainers read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from rpl_data.export import (
    ExportSummary,
    export_assets,
    export_bop,
    export_bop_onboarding,
    export_bundlesdf,
    export_coco_per_object,
    export_foundationpose,
    export_huggingface,
    export_linemod,
    export_nerfstudio,
    export_okt,
    export_webdataset,
    export_ycb_video,
    export_yolo,
)
from rpl_data.export.checksums import keeping_edited
from rpl_data.export.color_images import ColorFormat
from rpl_data.export.dialect import DialectSummary
from rpl_data.json_arrays import finite_or_none
from rpl_data.pipeline.choice import ExportChoice
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.exported_labels import export_labels
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step
from rpl_data.pipeline.remotes import upload_exports
from rpl_data.pipeline.symmetry import symmetry_turns
from rpl_data.types import DataError

Export = Callable[[Context], ExportSummary | DialectSummary]

UPLOAD = "to"
"""What the step that copies exports to an object store is called among them."""
VERSION = 4
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def export_steps(context: Context) -> list[Step]:
    """Plan one step per export format; `coco` first, since the others are made from it."""
    formats = sorted(context.recipe.export.formats, key=lambda name: name != "coco")
    steps = [_export_step(context, name) for name in formats]
    return [*steps, _upload_step(context, formats)] if context.recipe.export.to and formats else steps


def _upload_step(context: Context, formats: Sequence[str]) -> Step:
    """The step that copies the exports to an object store."""
    workspace, url = context.workspace, context.recipe.export.to
    assert url is not None

    def run(advance: Advance) -> Outcome:
        return upload_exports(workspace, [workspace.export(name) for name in formats], url, advance)

    after = [f"export/{name}" for name in formats]
    return step("export", UPLOAD, run, version=VERSION, options={"to": url}, after=after)


def refuse_unknown_exports(names: Sequence[str]) -> None:
    """Raise a DataError for an unknown format; called before a long build, not after."""
    for name in names:
        check_format(name)
    if names and "coco" not in names:
        raise DataError(f"export {', '.join(names)} is made from `coco`; write `export: [coco, {names[0]}]`")


def check_format(name: str) -> None:
    """Raise a DataError for a format that nothing writes."""
    if name not in EXPORTS:
        raise DataError(f"unknown export {name!r}; expected one of {', '.join(EXPORTS)}")


def _export_step(context: Context, name: str) -> Step:
    def run(advance: Advance) -> Outcome:
        refuse_unseen(context)
        summary = asdict(_written(context, name))
        messages = tuple(summary.pop("messages"))
        return Outcome(sum(summary["images"].values()), messages, finite_or_none(summary))

    left_out = {scene: sorted(context.workspace.load_left_out(scene)) for scene in context.placed_videos()}
    annotations = [context.workspace.load_annotation(item) for item in context.object_names]
    symmetries = {
        item.name: [asdict(one) for one in symmetry_turns(context, item)] for item in context.objects
    }
    chosen = {
        "left_out": {scene: frames for scene, frames in left_out.items() if frames},
        "corrections": context.workspace.corrections_digest(),
        "symmetries": {name: turns for name, turns in symmetries.items() if turns},
        "grasps": {item.object: asdict(item.grasp) for item in annotations if item.grasp is not None},
        "color": context.recipe.export.color if name in CONVERTING else "recorded",
        "moving": sorted(context.workspace.parts().moving) if name == "bop_onboarding" else [],
    }
    chosen = {key: value for key, value in chosen.items() if value and value != "recorded"}
    options = {
        "split": asdict(context.recipe.split),
        "objects": context.object_names,
        "min_quality": context.recipe.export.min_quality,
        **({} if context.recipe.export.frame == "keypoints" else {"frame": context.recipe.export.frame}),
        "images": context.recipe.export.images,
        **({"license": context.recipe.export.license} if context.recipe.export.license else {}),
    }
    return step(
        "export",
        name,
        run,
        version=VERSION,
        options=options | chosen,
        after=[f"label/{v}" for v in context.placed_videos()] if name == "coco" else ["export/coco"],
        outputs=[context.workspace.export(name)],
    )


def refuse_unseen(context: Context) -> None:
    """Raise a DataError when an object is in none of the labelled frames."""
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


def export_chosen(
    context: Context, name: str, choice: ExportChoice
) -> tuple[Path, ExportSummary | DialectSummary]:
    """Write one format, limited to the choice; returns its folder, too.

    Without a choice this is the recipe's own export. Else `coco`, which is chosen from the labels, and the
    format, which is made of it, go to a folder of the choice; both keep the splits of the recipe's export.

    Raises:
        DataError: the format or the object is not known, the format has no such choice, or nothing is left to
            export.
    """
    check_format(name)
    if choice.color is not None and name not in CONVERTING:
        raise DataError(
            f"{name} has colour images as they were recorded; --color is for {', '.join(CONVERTING)}"
        )
    recipe = replace(context.recipe, export=choice.recipe(context.recipe.export))
    context = replace(context, recipe=recipe, choice=choice)
    try:
        if choice.folder and name != "coco":
            export_labels(context)
        return context.export_folder(name), _written(context, name)
    except DataError:
        _remove_empty(context.export_folder(name).parent)
        raise


def _remove_empty(folder: Path) -> None:
    """Remove the folder of a choice from which nothing could be exported."""
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _written(context: Context, name: str) -> ExportSummary | DialectSummary:
    """Write a format; what somebody edited in the export that it replaces is kept, and said."""
    with keeping_edited(context.export_folder(name)) as kept:
        summary = EXPORTS[name](context)
    return replace(summary, messages=(*kept, *summary.messages))


def _dialect(name: str, write: Callable[[Path, Path], DialectSummary]) -> Export:
    """A format made from `coco` alone."""
    return lambda context: write(context.export_folder(name), context.export_folder("coco"))


def _with_units(name: str, write: Callable[[Path, Path, dict[str, float]], DialectSummary]) -> Export:
    """A format that must say what the depth images of each scene count in."""
    return lambda context: write(context.export_folder(name), context.export_folder("coco"), _units(context))


def _with_color(
    name: str, write: Callable[[Path, Path, dict[str, float], ColorFormat], DialectSummary]
) -> Export:
    """A format that also stores colour images as the recipe says."""
    return lambda context: write(
        context.export_folder(name),
        context.export_folder("coco"),
        _units(context),
        context.recipe.export.color,
    )


def _units(context: Context) -> dict[str, float]:
    """Metres per unit of the depth images, by scene."""
    workspace = context.workspace
    return {name: workspace.load_scene(name).metres_per_unit for name in workspace.labelled_scene_names()}


def _guessed(context: Context) -> dict[str, float]:
    """Share of each object's triangles that close unseen sides, as the segment stage counted them."""
    entries = Ledger(context.workspace.stages_file).of_stage("segment")
    details = {name: entry.outcome.details for name, entry in entries.items()}
    return {
        name: found["unseen_triangles"] / found["triangles"]
        for name, found in details.items()
        if found.get("triangles") and "unseen_triangles" in found
    }


CONVERTING = ("bop", "bop_onboarding")
"""The formats for which `export.color` says how colour images are stored."""

EXPORTS: dict[str, Export] = {
    "coco": export_labels,
    "coco_per_object": _dialect("coco_per_object", export_coco_per_object),
    "yolo": _dialect("yolo", export_yolo),
    "bop": _with_color("bop", export_bop),
    "bop_onboarding": lambda context: export_bop_onboarding(
        context.export_folder("bop_onboarding"),
        context.export_folder("coco"),
        _units(context),
        context.recipe.export.color,
        moving=context.workspace.parts().moving,
    ),
    "ycb_video": _with_units("ycb_video", export_ycb_video),
    "linemod": _with_units("linemod", export_linemod),
    "okt": _dialect("okt", export_okt),
    "foundationpose": _with_units("foundationpose", export_foundationpose),
    "bundlesdf": _with_units("bundlesdf", export_bundlesdf),
    "nerfstudio": _with_units("nerfstudio", export_nerfstudio),
    "huggingface": _dialect("huggingface", export_huggingface),
    "assets": lambda context: export_assets(
        context.export_folder("assets"), context.export_folder("coco"), _guessed(context)
    ),
    "webdataset": _dialect("webdataset", export_webdataset),
}
"""The writer of each format, by its name in the recipe."""
