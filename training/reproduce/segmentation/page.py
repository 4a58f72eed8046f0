"""What the segmentation experiment shows: bars, tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rpl_data.files import read_json
from rpl_data.formats.datasets.coco import read_coco
from rpl_data.report.html import Cell, number, section, table

from ..results import picture, png_of

if TYPE_CHECKING:
    from ...masks.scores import SplitScore
    from .progress import Progress

Scores = Mapping[str, Mapping[str, "SplitScore"]]
PROTOCOLS = {"val": "random frames of the training scenes (the paper's)", "test": "unseen scenes"}
COLORS = {"OURS": "#2a9d8f", "MANUAL": "#8d99ae"}
LEAST_IOU, MOST_POINTS = 0.5, 5.0
"""The comparison counts when MANUAL reaches this mean IoU; OURS is as good within so many points."""


def verdict(arms: Mapping[str, SplitScore]) -> dict[str, Any]:
    """Whether the comparison counts, and how far OURS is from MANUAL in points of mean IoU."""
    ours, manual = arms["OURS"].mean_iou, arms["MANUAL"].mean_iou
    points = None if ours is None or manual is None else 100 * (ours - manual)
    return {
        "valid": manual is not None and manual >= LEAST_IOU,
        "ours_minus_manual_points": points,
        "within_5_points": points is not None and points >= -MOST_POINTS,
    }


def bars(scores: Scores) -> bytes:
    """The paper's figure: mean IoU per class, both sources beside each other, one panel per split."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5 * len(scores), 3.6), layout="constrained")
    axes = figure.subplots(1, len(scores), sharey=True, squeeze=False)[0]
    for panel, (split, arms) in zip(axes, scores.items(), strict=True):
        classes = [row.name for row in arms["MANUAL"].classes]
        for side, (name, score) in zip((-0.2, 0.2), arms.items(), strict=True):
            heights = [100 * (row.mean_iou or 0.0) for row in score.classes]
            drawn = panel.bar(np.arange(len(classes)) + side, heights, 0.38, color=COLORS[name], label=name)
            panel.bar_label(drawn, fmt="%.0f", fontsize=8, padding=1)
        panel.set_xticks(range(len(classes)), [name.replace("_", " ") for name in classes], rotation=20)
        panel.set_title(f"{split}: {PROTOCOLS[split]}", fontsize=10)
        panel.set_ylim(0, 100)
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("mean IoU, %")
    axes[-1].legend(frameon=False, ncols=2, loc="upper right")
    return png_of(figure)


def sections(
    sources: Mapping[str, Path], scores: Scores, progress: Progress, figure: bytes, out: Path
) -> list[str]:
    """The parts of the page."""
    parts = [section("figure", "Mean IoU per class", picture(figure, _caption(scores)))]
    for split, arms in scores.items():
        parts.append(section(split, f"{split}: {PROTOCOLS[split]}", _table(arms), note=_sentence(arms)))
    if len(progress.history) > 1:
        parts.append(section("curve", "While training", picture(_curve(progress), "Mean IoU on val")))
    split = "test" if "test" in scores else "val"
    examples = _examples(sources["MANUAL"] / f"{split}.json", list(scores[split]), out)
    parts.append(section("examples", f"Images of {split}: truth, OURS, MANUAL", examples))
    return parts


def _caption(scores: Scores) -> str:
    counts = ", ".join(f"{split} {arms['MANUAL'].images} images" for split, arms in scores.items())
    return f"Trained on our masks and on true ones, both tested on the true masks of {counts}"


def _sentence(arms: Mapping[str, SplitScore]) -> str:
    found = verdict(arms)
    if not found["valid"]:
        return f"The comparison does not count: MANUAL is below a mean IoU of {LEAST_IOU}."
    return f"OURS minus MANUAL: {found['ours_minus_manual_points']:+.1f} points of mean IoU."


def _table(arms: Mapping[str, SplitScore]) -> str:
    header = ["class", "images"]
    for name in arms:
        header += [f"{name} {what}" for what in ("IoU", "missed", "false", "mask AP", "AP50")]
    rows: list[list[str | Cell]] = []
    for lines in zip(*(score.classes for score in arms.values()), strict=True):
        row: list[str | Cell] = [lines[0].name, str(lines[0].images)]
        for line in lines:
            row += [number(line.mean_iou, 3), str(line.missed), str(line.false_alarms)]
            row += [number(line.mask_ap, 3), number(line.mask_ap50, 3)]
        rows.append(row)
    mean: list[str | Cell] = ["mean", str(next(iter(arms.values())).images)]
    for score in arms.values():
        mean += [number(score.mean_iou, 3), "", "", number(score.mask_ap, 3), number(score.mask_ap50, 3)]
    return table(header, [*rows, mean])


def _curve(progress: Progress) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.2), layout="constrained")
    panel = figure.subplots()
    rounds = np.array(progress.history, dtype=float)
    for column, name in enumerate(("OURS", "MANUAL"), start=1):
        panel.plot(rounds[:, 0], 100 * rounds[:, column], color=COLORS[name], marker="o", ms=3, label=name)
    panel.set_xlabel("epoch")
    panel.set_ylabel("mean IoU on val, %")
    panel.set_ylim(0, 100)
    panel.legend(frameon=False)
    return png_of(figure)


def _examples(coco_json: Path, arms: list[str], out: Path, count: int = 3) -> str:
    """Some images of the split with the true masks and with what each network found."""
    import cv2

    from rpl_data.torch.image_files import read_image

    from ...masks.pictures import draw
    from ...masks.settings import SCORE_THRESHOLD

    data = read_coco(coco_json)
    names = ["background", *(c["name"] for c in sorted(data["categories"], key=lambda c: int(c["id"])))]
    layers = {"truth": [{**a, "score": 1.0} for a in data["annotations"]]}
    for arm in arms:
        found = read_json(out / arm.lower() / f"{coco_json.stem}_results.json")
        layers[arm] = [entry for entry in found if entry["score"] >= SCORE_THRESHOLD]
    figures = []
    for row in np.linspace(0, len(data["images"]) - 1, min(count, len(data["images"]))).astype(int):
        entry = data["images"][row]
        pixels = read_image(str(coco_json.parent / entry["file_name"]))
        drawn = [
            draw(pixels, [found for found in layer if found["image_id"] == entry["id"]], names)
            for layer in layers.values()
        ]
        strip = cv2.resize(np.hstack(drawn), None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        png = cv2.imencode(".png", cv2.cvtColor(strip, cv2.COLOR_RGB2BGR))[1].tobytes()
        figures.append(picture(png, f"{entry['file_name']}: {', '.join(layers)}"))
    return "".join(figures)
