"""Figures of Table II: what the trained networks reach, and OURS by MANUAL."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...pose.evaluation import TrueObject, evaluate, true_objects
from ...pose.pipeline import load_pipeline
from ...pose.scores import Judged, PoseScore, errors_table, load_judged, save_judged, score
from ..label_sources import EXPORTS, Source, exports_of

PROTOCOLS = {"val": "given", "test": "detected"}
"""The paper's: frames beside those trained on, the label's crop. The strict one: scenes never trained on."""

LEAST_PCK = 0.8
"""Of MANUAL on val: below, the networks have not learned enough for a comparison of their labels."""


@dataclass(frozen=True)
class Cell:
    """The score of one object, label source, protocol and PnP method."""

    object: str
    source: str
    split: str
    method: str
    score: PoseScore


@dataclass(frozen=True)
class Ratio:
    """The ratio of two medians, OURS / MANUAL, with its central 95 % over resampled instances."""

    object: str
    split: str
    method: str
    figure: str
    value: float
    low: float
    high: float


def measure(out: Path, workspace: Path, objects: list[str]) -> Iterator[tuple[Cell, list[Judged]]]:
    """Score the networks that are trained so far: one cell per object, source, protocol and method.

    Judged instances are kept in <out>/<source>/<object>/judged_<split>.json: only new checkpoints are run.
    """
    truth = true_objects(exports_of(workspace)["MANUAL"] / "train.json")
    for source in EXPORTS:
        for name in objects:
            for split in PROTOCOLS:
                judged = _judged(out, workspace, source, name, split, truth)
                for method in sorted({each.method for each in judged}):
                    rows = [each for each in judged if each.method == method]
                    yield Cell(name, source, split, method, score(rows, truth[name].surface)), rows


def _judged(
    out: Path, workspace: Path, source: Source, name: str, split: str, truth: dict[str, TrueObject]
) -> list[Judged]:
    """Instances of a split, judged by the last checkpoints; none while a checkpoint is missing."""
    crops: Any = PROTOCOLS[split]
    needed = [out / source / name / "last.ckpt"]
    needed += [out / source / "detector" / "last.ckpt"] if crops == "detected" else []
    if not all(path.exists() for path in needed):
        return []
    kept = out / source / name / f"judged_{split}.json"
    if kept.exists() and kept.stat().st_mtime > max(path.stat().st_mtime for path in needed):
        return load_judged(kept)
    pipeline = load_pipeline(needed[:1], needed[1] if crops == "detected" else None)
    coco_json = exports_of(workspace)["MANUAL"] / f"{split}.json"
    judged = list(evaluate(pipeline, coco_json, crops=crops, methods=["epnp", "consensus"], truth=truth))
    save_judged(kept, judged)
    return judged


def ratios(found: list[tuple[Cell, list[Judged]]], *, draws: int = 2000) -> list[Ratio]:
    """The ratios OURS / MANUAL per object, protocol and method; instances are resampled in pairs."""
    by_key = {(c.source, c.object, c.split, c.method): rows for c, rows in found}
    result = []
    for (source, name, split, method), manual in by_key.items():
        ours = by_key.get(("OURS", name, split, method))
        if source != "MANUAL" or ours is None or len(ours) != len(manual) or not manual:
            continue
        picks = np.random.default_rng(0).integers(0, len(manual), (draws, len(manual)))
        for column, figure in ((0, "position"), (1, "orientation")):
            mine, true = errors_table(ours)[:, column], errors_table(manual)[:, column]
            with np.errstate(invalid="ignore"):  # both infinite: no ratio
                drawn = np.median(mine[picks], axis=1) / np.median(true[picks], axis=1)
                value = float(np.median(mine) / np.median(true))
            known = drawn[~np.isnan(drawn)]
            # Nearest: between a number and an infinite one there is nothing to interpolate.
            low, high = (
                np.percentile(known, [2.5, 97.5], method="nearest") if len(known) else (np.nan, np.nan)
            )
            result.append(Ratio(name, split, method, figure, value, float(low), float(high)))
    return result


def counts(found: list[tuple[Cell, list[Judged]]], name: str) -> bool:
    """Whether MANUAL has learned the object well enough to compare: a PCK of `LEAST_PCK` on val."""
    keys = ("MANUAL", "val")
    return any(
        (cell.source, cell.split) == keys and cell.object == name and cell.score.pck >= LEAST_PCK
        for cell, _ in found
    )
