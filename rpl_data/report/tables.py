"""The tables of the report: quality beside the paper's, label counts, timings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rpl_data.report.counts import SceneReport
from rpl_data.report.html import Cell, number, section, table
from rpl_data.types import QualityRow

PAPER_MEANS = {"3D mm": 1.94, "2D px": 6.56, "IoU": 0.812}
"""Means of the paper's Table I over its eleven objects."""


def quality_section(rows: Sequence[QualityRow]) -> str:
    """The section with the quality rows, their mean, and the paper's means."""
    pixels = ("2D px", "median", "p95", "IoU full", "worst", "IoU visible", "worst")
    header = (
        "object",
        "keypoints",
        "3D mm",
        "max",
        *pixels,
        "pose mm",
        "deg",
        "frames",
        "missed",
        "invented",
    )
    body = [_quality_row(row) for row in rows]
    if len(rows) > 1:
        body.append(_mean_row(rows))
    paper: list[str | Cell] = [
        "paper, Table I",
        "",
        number(PAPER_MEANS["3D mm"]),
        "",
        number(PAPER_MEANS["2D px"]),
    ]
    paper += ["", "", number(PAPER_MEANS["IoU"], 3), *[""] * 8]
    note = (
        "Strict: keypoint by keypoint and frame by frame, nothing aligned in the image; 3D and pose after "
        "one rigid fit of the models. Green is at or better than the paper's mean, red is worse."
    )
    kinds = ["" for _ in body] + ["quiet"]
    return section("quality", "Quality against truth", table(header, [*body, paper], kinds=kinds), note=note)


def _quality_row(row: QualityRow) -> list[str | Cell]:
    return [
        row.object,
        f"{row.keypoints_known}/{row.keypoints}",
        _judged(row.error_3d_mean_mm, "3D mm"),
        number(row.error_3d_max_mm),
        _judged(row.error_2d_mean_px, "2D px"),
        number(row.error_2d_median_px),
        number(row.error_2d_p95_px),
        _judged(row.iou_full_mean, "IoU"),
        number(row.iou_full_worst, 3),
        number(row.iou_visible_mean, 3),
        number(row.iou_visible_worst, 3),
        number(row.position_mm),
        number(row.rotation_deg),
        f"{row.frames}/{row.truth_frames}",
        str(row.missed),
        str(row.invented),
    ]


def _mean_row(rows: Sequence[QualityRow]) -> list[str | Cell]:
    """The mean over objects of the figures that the paper gives; the other cells are empty."""
    means = {
        name: float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")
        for name in ("error_3d_mean_mm", "error_2d_mean_px", "iou_full_mean", "iou_visible_mean")
        for values in [np.array([getattr(row, name) for row in rows])]
    }
    mean: list[str | Cell] = ["mean", "", _judged(means["error_3d_mean_mm"], "3D mm"), ""]
    mean += [_judged(means["error_2d_mean_px"], "2D px"), "", "", _judged(means["iou_full_mean"], "IoU"), ""]
    return [*mean, number(means["iou_visible_mean"], 3), *[""] * 6]


def _judged(value: float, column: str) -> Cell:
    """A cell that is green when the value is at or better than the paper's mean, else red."""
    shown = number(value, 3 if column == "IoU" else 2)
    if value != value:
        return Cell(shown, kind="n")
    better = value >= PAPER_MEANS[column] if column == "IoU" else value <= PAPER_MEANS[column]
    return Cell(shown, kind="good" if better else "over")


def labels_section(scenes: Sequence[SceneReport]) -> str:
    """The section with counts per scene and object; empty text when nothing is labelled."""
    header = (
        "scene",
        "object",
        "instances",
        "keypoints seen",
        "hidden",
        "not labelled",
        "cut off",
        "visible",
        "off by, px",
        "quality",
        "too low",
    )
    body: list[list[str | Cell]] = []
    for scene in scenes:
        for name, tally in sorted(scene.tallies.items()):
            counts = (tally.instances, tally.seen, tally.hidden, tally.unlabelled, tally.truncated)
            means = (
                f"{100 * tally.visib_fract / tally.instances:.0f} %",
                number(float(np.median(tally.off_px)), 1) if tally.off_px else "–",
                number(tally.quality / tally.instances),
                number(tally.low_quality, 0),
            )
            body.append([scene.recording.scene.name, name, *(number(count, 0) for count in counts), *means])
    note = (
        "Off by: how far a keypoint should be from its true place in the image, which is the square root of "
        "2 times `sigma_px`, that of one axis (median). "
        "Quality is 1 / (1 + e / 5 px), where e is the expected error of a label: 0.5 stands for 5 px, 0.25 "
        "for 15 px. Frames with a label whose quality is too low (`export: {min_quality: ...}` in the "
        "recipe) are left out of the export."
    )
    return section("labels", "Labels", table(header, body, left=2), note=note) if body else ""


def timings_section(timings: Mapping[str, Mapping[str, float | int]]) -> str:
    """The section with the seconds of every stage as bars, and frames per second where counted."""
    longest = max((stage.get("seconds", 0.0) for stage in timings.values()), default=0.0) or 1.0
    body: list[list[str | Cell]] = []
    for name, stage in timings.items():
        seconds, frames = stage.get("seconds", 0.0), stage.get("frames", 0.0)
        rate = number(frames / seconds, 1) if frames and seconds else "–"
        body.append(
            [
                name,
                Cell(f"{number(seconds, 1)} s", seconds / longest),
                number(frames, 0) if frames else "–",
                rate,
            ]
        )
    total = sum(stage.get("seconds", 0.0) for stage in timings.values())
    body.append(["all", f"{number(total, 1)} s", "", ""])
    return section("timings", "Timings", table(("stage", "time", "frames", "frames/s"), body))
