"""The dataset card: what an exported folder holds, for whoever gets it without the workspace."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

from rpl_data.export.coco import ExportSummary
from rpl_data.types import Intrinsics, KeypointModel
from rpl_data.version import installed_version
from rpl_data.wording import counted

WHAT = (
    "6-DoF poses, keypoints, boxes and masks of objects in RGB-D images, as COCO with more fields. "
    "Made with rpl-data {version}."
)
NO_LICENCE = "not stated: ask the owner before you pass it on (`export: {license: ...}` in the recipe)"
FIELDS = """\
Each annotation has its pose `camera_from_object` (16 numbers, row by row, metres; camera: x right, y down,
z forward), and says how far off its keypoints should be (`sigma_px`). Images with a label whose `quality` is
below {min_quality:g} were left out; `quality` = 1 / (1 + e / 5 px), where e is the expected error. Keypoints
count from the centre of the first pixel; their third number is 0 for never labelled, 1 for hidden, 2 for
seen."""


def dataset_card(
    name: str,
    *,
    licence: str | None,
    summary: ExportSummary,
    models: Sequence[KeypointModel],
    cameras: Mapping[str, Intrinsics],
    min_quality: float,
) -> str:
    """The card as Markdown, to stand beside the files as README.md.

    Args:
        name: of the dataset.
        licence: as its owner named it; None is said, too.
        cameras: of each scene.
        min_quality: the quality below which labels were left out.
    """
    names = [model.name for model in models]
    return "\n".join(
        [
            f"# {name}",
            "",
            WHAT.format(version=installed_version()),
            "",
            f"Licence: {licence or NO_LICENCE}",
            "",
            *_table(("split", "images", "scenes", *names), _splits(summary, models)),
            "",
            "`test` is whole scenes that training never sees; `val` is random frames of the others.",
            "",
            *_table(("object", "keypoints"), _objects(models)),
            "",
            *_table(("scenes", "size", "fx", "fy", "cx", "cy", "lens"), _cameras(cameras)),
            "",
            FIELDS.format(min_quality=min_quality),
            "",
        ]
    )


def _splits(summary: ExportSummary, models: Sequence[KeypointModel]) -> Iterable[Sequence[str]]:
    for split, images in summary.images.items():
        counts = (str(summary.instances[split].get(model.name, 0)) for model in models)
        yield split, str(images), ", ".join(summary.scenes[split]), *counts


def _objects(models: Sequence[KeypointModel]) -> Iterable[Sequence[str]]:
    for model in models:
        yield model.name, f"{counted(len(model.keypoints), 'keypoint')}: {', '.join(model.keypoints)}"


def _cameras(cameras: Mapping[str, Intrinsics]) -> Iterable[Sequence[str]]:
    """A row per camera: scenes that follow one another with the same one share it."""
    for lens, scenes in groupby(cameras, key=lambda scene: cameras[scene]):
        numbers = (f"{value:.1f}" for value in (lens.fx, lens.fy, lens.cx, lens.cy))
        distortion = ", ".join(f"{value:g}" for value in lens.distortion) or "no distortion"
        yield ", ".join(scenes), f"{lens.width} x {lens.height}", *numbers, distortion


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines]
