"""The page of Table II: numbers beside the paper's, OURS by MANUAL, times, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from ..paper import TABLE_2

if TYPE_CHECKING:
    from rpl_data.report.html import Cell as HtmlCell

    from .pose_comparison import Cell, Ratio

METHODS = {"epnp": "EPnP (paper)", "consensus": "consensus + LM"}
SPLITS = {
    "val": "the paper's protocol: frames beside those trained on, the label's crop",
    "test": "the strict protocol: scenes never trained on, the detector's crop, failures infinite",
}


def write_page(out: Path, workspace: Path, objects: list[str]) -> Path:
    """Write table2.json and table2.html of what has been trained so far."""
    from rpl_data.report.html import section

    from ..results import write_results
    from .pictures import curves, mosaic, samples, worst
    from .pose_comparison import counts, measure, ratios

    found = list(measure(out, workspace, objects))
    cells, compared = [cell for cell, _ in found], ratios(found)
    valid = {name: counts(found, name) for name in objects}
    times = seconds(out, objects)
    parts = [
        section(split, f"Errors, {split}", _errors(cells, split), note=SPLITS[split]) for split in SPLITS
    ]
    parts += [
        section("ratios", "OURS by MANUAL", _ratios(compared, valid), note=RATIO_NOTE),
        section("paper", "The paper's Table II", _paper()),
        section("time", "Time", _times(times)),
    ]
    pictures = {}
    if curve := curves(out, objects):
        pictures["table2_curves"] = curve
    shown = {f"table2_samples_{split}": samples(found, split) for split in SPLITS}
    for name, rows in (shown | {"table2_worst": worst(found)}).items():
        if rows:
            pictures[name] = mosaic(workspace, rows)
    parts += [
        section(name, title, _shown(pictures[name])) for name, title in TITLES.items() if name in pictures
    ]
    data = {
        "cells": [{**asdict(cell), "score": asdict(cell.score)} for cell in cells],
        "ratios": [asdict(ratio) for ratio in compared],
        "counts": valid,
        "seconds": times,
        "paper": TABLE_2,
    }
    note = f"{workspace.name}: {', '.join(objects)}"
    return write_results(
        out, "table2", title="Table II", data=data, sections=parts, note=note, figures=pictures
    )


TITLES = {
    "table2_curves": "Learning",
    "table2_samples_val": "Samples, val: the 10th, 30th, 50th, 70th and 90th percentile of ADD",
    "table2_samples_test": "Samples, test: the same percentiles",
    "table2_worst": "Worst cases of test, of those with a pose",
}
CLAIMED = 1.15
"""The paper's claim is comparable accuracy: within 15 %."""

RATIO_NOTE = (
    "Of median errors; the interval holds 95 % of resampled instances. The paper's claim is comparable "
    "accuracy: within 15 %. It counts only where MANUAL has PCK 0.8 or more on val."
)


def seconds(out: Path, objects: Sequence[str]) -> dict[str, dict[str, float]]:
    """CPU and wall-clock seconds of every training so far."""
    from rpl_data.files import read_json

    runs = [f"{source}/{name}" for source in ("OURS", "MANUAL") for name in (*objects, "detector")]
    return {run: read_json(path) for run in runs if (path := out / run / "seconds.json").exists()}


def _shown(png: bytes) -> str:
    from ..results import picture

    return picture(png, "Circles: keypoints with two standard deviations. Crosses: true. Axes: the pose.")


# Tables -------------------------------------------------------------------------------------------


def _errors(cells: Sequence[Cell], split: str) -> str:
    from rpl_data.report.html import number, table

    header = (
        "object", "PnP", "labels", "position mm", "orientation deg", "ADD mm", "ADD-S mm", "ADD < 0.1 d",
        "ADD-S < 0.1 d", "5 cm 5 deg", "PCK 0.1", "instances", "no pose",
    )  # fmt: skip
    rows: list[list[str | HtmlCell]] = []
    for cell in sorted(cells, key=lambda c: (c.object, c.method != "epnp", c.source)):
        if cell.split == split:
            s = cell.score
            figures = [number(v, 2) for v in (s.position_mm, s.orientation_deg, s.add_mm, s.adds_mm)]
            figures += [number(v, 3) for v in (s.recall_add, s.recall_adds, s.recall_5cm_5deg, s.pck)]
            counted = [str(s.instances), str(s.failures)]
            rows.append([cell.object, METHODS[cell.method], cell.source, *figures, *counted])
    return table(header, rows, left=3)


def _ratios(compared: Sequence[Ratio], valid: dict[str, bool]) -> str:
    from rpl_data.report.html import number, table

    rows: list[list[str | HtmlCell]] = [
        [
            r.object,
            r.split,
            METHODS[r.method],
            r.figure,
            number(r.value, 2),
            f"{number(r.low, 2)} to {number(r.high, 2)}",
            verdict(r) if valid[r.object] else "does not count",
        ]
        for r in compared
    ]
    header = ("object", "split", "PnP", "error", "ratio", "95 %", "within 15 %")
    return table(header, rows, left=4)


def verdict(ratio: Ratio) -> str:
    """Whether OURS is within the claim, and whether the interval leaves it open."""
    within = "yes" if ratio.value <= CLAIMED else "no"
    return f"{within}, not surely" if ratio.low <= CLAIMED < ratio.high else within


def _paper() -> str:
    from rpl_data.report.html import number, table

    rows: list[list[str | HtmlCell]] = [[name, *(number(v) for v in rest)] for name, *rest in TABLE_2]
    header = ("object", "position OURS mm", "MANUAL mm", "orientation OURS deg", "MANUAL deg")
    return table(header, rows)


def _times(times: dict[str, dict[str, float]]) -> str:
    from rpl_data.report.html import number, table

    rows: list[list[str | HtmlCell]] = [
        [run, number(t["cpu_s"] / 60, 1), number(t["wall_s"] / 60, 1)] for run, t in times.items()
    ]
    total = [sum(t[key] for t in times.values()) / 60 for key in ("cpu_s", "wall_s")]
    rows.append(["all", number(total[0], 1), number(total[1], 1)])
    return table(("training", "CPU minutes", "wall minutes"), rows)
