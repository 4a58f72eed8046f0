"""The segmentation figure: Mask R-CNN trained on our masks and on true ones, both tested on true ones."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rpl_data.files import write_json
from rpl_data.types import DataError
from rpl_data.wording import counted

from ...runs.options import Precision
from .progress import Progress, load_progress

if TYPE_CHECKING:
    from ...masks.scores import SplitScore
    from ...masks.settings import MaskSettings

OURS, MANUAL = "OURS", "MANUAL"
"""The paper's names for training on generated and on true labels."""
ROUND_EPOCHS = 3
"""Epochs of one source before it is the other's turn; scoring both on val costs about a third of one."""


def segmentation(
    workspace: Path,
    out: Path = Path("runs/segmentation"),
    preset: Path = Path("masks_cpu"),
    epochs: int | None = None,
    weights: str | None = None,
    threads: int | None = None,
    precision: Precision | None = None,
) -> None:
    """Mean IoU per class of Mask R-CNN trained on OURS and on MANUAL labels (the paper's figure).

    Both are trained on the same images for the same number of epochs, in turns, and tested on the true masks
    of val (random frames, as in the paper) and of test (scenes that training never saw). An interrupted
    experiment goes on when the same command is given again. After every round the figure is drawn from what
    there is.

    Args:
        workspace: a built workspace whose truth is known.
        out: folder for segmentation.json, segmentation.html, the figure and both runs.
        preset: options of the training: `masks_cpu`, `masks_paper`, or a YAML file.
        epochs: of each source; those of the preset when left out.
        weights: what both start from: `scratch`, `imagenet`, or the path of trained weights; the preset's
            when left out. From scratch all layers learn from the first epoch.
        threads: processor threads of torch; those of the preset when left out.
        precision: `bf16-mixed`, for example; that of the preset when left out.
    """
    from rpl_data.formats.datasets.coco import read_coco

    from ...masks.settings import load_settings
    from ...runs.presets import preset_file

    sources = sources_of(workspace)
    settings = load_settings(preset_file(preset))
    if epochs is not None:
        settings = replace(settings, learning=replace(settings.learning, epochs=epochs))
    if weights is not None:
        settings = with_weights(settings, weights)
    if threads is not None:
        settings = replace(settings, machine=replace(settings.machine, threads=threads))
    if precision is not None:
        settings = replace(settings, machine=replace(settings.machine, precision=precision))
    progress = load_progress(out, settings)
    while progress.epochs < settings.learning.epochs:
        progress = train_round(sources, settings, progress, out)
        print(_line(progress, settings), flush=True)
    splits = [name for name in ("val", "test") if read_coco(sources[MANUAL] / f"{name}.json")["images"]]
    scores = score_sources(sources, out, splits)
    print(write_figure(sources, scores, progress, settings, out))


def with_weights(settings: MaskSettings, weights: str) -> MaskSettings:
    """The settings with other weights to start from; a random ResNet knows nothing, so it is not frozen."""
    frozen = 0 if weights == "scratch" else settings.head_epochs
    return replace(settings, weights=weights, head_epochs=frozen)


def sources_of(workspace: Path) -> dict[str, Path]:
    """Find the export folders of both sources; the true labels are exported when they are not there.

    Raises:
        DataError: the truth is not known, or the two do not have the same training images.
    """
    from rpl_data.formats.datasets.coco import read_coco
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.exported_labels import export_truth
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    sources = {OURS: place.export("coco"), MANUAL: place.export("coco_truth")}
    if not (sources[OURS] / "train.json").exists():
        raise DataError(f"{sources[OURS]} has no train.json; build the workspace first with `rpl build`")
    if not (sources[MANUAL] / "train.json").exists():
        export_truth(context_of(place))
    names = [
        [image["file_name"] for image in read_coco(f / "train.json")["images"]] for f in sources.values()
    ]
    if names[0] != names[1]:
        raise DataError(
            f"{sources[OURS]} and {sources[MANUAL]} have other training images; run "
            "`rpl export --labels truth` again"
        )
    return sources


# Training -----------------------------------------------------------------------------------------


def train_round(
    sources: Mapping[str, Path], settings: MaskSettings, progress: Progress, out: Path
) -> Progress:
    """Train both sources for a few more epochs, score them on val, and draw the figure as it stands."""
    from ...train_masks import train_masks

    clock, cpu = time.perf_counter(), _cpu_s()
    done = min(progress.epochs + ROUND_EPOCHS, settings.learning.epochs)
    unvalidated = {**given(settings), "validate_every": 0}  # scored on true masks below
    for name, coco in sources.items():
        train_masks(coco, out / name.lower(), **unvalidated, resume=True, until=done)
    scores = score_sources(sources, out, ["val"])
    means = [score.mean_iou for score in scores["val"].values()]
    progress = replace(
        progress,
        epochs=done,
        seconds=progress.seconds + time.perf_counter() - clock,
        cpu_seconds=progress.cpu_seconds + _cpu_s() - cpu,
        history=[*progress.history, [done, *means]],
    )
    write_json(out / "progress.json", asdict(progress))
    write_figure(sources, scores, progress, settings, out)
    return progress


def given(settings: MaskSettings) -> dict[str, Any]:
    """The settings as arguments of `train_masks`."""
    return {field.name: getattr(settings, field.name) for field in fields(settings)}


def _cpu_s() -> float:
    """CPU seconds of this process and of its finished child processes."""
    return sum(os.times()[:4])


def _line(progress: Progress, settings: MaskSettings) -> str:
    epoch, *means = progress.history[-1]
    pairs = zip((OURS, MANUAL), means, strict=True)
    found = ", ".join(f"{name} {'-' if mean is None else f'{mean:.3f}'}" for name, mean in pairs)
    done = f"epoch {epoch} of {settings.learning.epochs}"
    return f"{done}: mean IoU on val {found}; {progress.seconds / 60:.1f} min"


# Scores -------------------------------------------------------------------------------------------


def score_sources(
    sources: Mapping[str, Path], out: Path, splits: list[str]
) -> dict[str, dict[str, SplitScore]]:
    """Score both networks on each split, against the true masks."""
    from ...masks.evaluation import evaluate
    from ...masks.weights import load_segmenter
    from ...runs.folder import LAST

    scores: dict[str, dict[str, SplitScore]] = {split: {} for split in splits}
    for name in sources:
        folder = out / name.lower()
        segmenter = load_segmenter(folder / LAST)
        for split in splits:
            scores[split][name] = evaluate(segmenter, sources[MANUAL] / f"{split}.json", folder)
    return scores


def write_figure(
    sources: Mapping[str, Path],
    scores: Mapping[str, Mapping[str, SplitScore]],
    progress: Progress,
    settings: MaskSettings,
    out: Path,
) -> Path:
    """Write segmentation.json, segmentation.html and segmentation.png; the path of the page comes back."""
    from rpl_data.formats.datasets.coco import read_coco

    from ..results import write_results
    from .page import bars, sections, verdict

    figure = bars(scores)
    images = len(read_coco(sources[OURS] / "train.json")["images"])
    data = {
        "settings": asdict(settings),
        "progress": asdict(progress),
        "training_images": images,
        "verdict": {split: verdict(arms) for split, arms in scores.items()},
        "scores": {split: {k: asdict(v) for k, v in arms.items()} for split, arms in scores.items()},
    }
    return write_results(
        out,
        "segmentation",
        title="Segmentation",
        data=data,
        sections=sections(sources, scores, progress, figure, out),
        note=f"{settings.network.backbone} FPN at {settings.network.size_px} px, "
        f"{counted(progress.epochs, 'epoch')} of {counted(images, 'image')} per label "
        f"source, {progress.seconds / 60:.0f} min on the clock, {progress.cpu_seconds / 60:.0f} CPU min",
        figures={"segmentation": figure},
    )
