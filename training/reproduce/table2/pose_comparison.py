"""Figures of Table II: what the trained networks reach, and OURS by MANUAL."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from rpl_data.types import DataError

from ...pose.evaluation import TrueObject, evaluate, true_objects
from ...pose.pipeline import load_pipeline
from ...pose.scores import Judged, PoseScore, errors_table, load_judged, save_judged, score
from ...runs.options import Crops
from ...runs.trained_scenes import trained_scenes
from ..label_sources import EXPORTS, Source, exports_of

Split = Literal["val", "test"]

PROTOCOLS: tuple[tuple[Split, Crops], ...] = (
    ("val", "given"),
    ("val", "detected"),
    ("test", "given"),
    ("test", "detected"),
)
"""The four cells, from the paper's (random frames, the label's crop) to the strict one."""

LEAST_PCK = 0.8
"""Of MANUAL with given crops: below, the networks have not learned enough to compare their labels."""

DRAWS = 2000
"""Resamples of the bootstrap."""

Interval = tuple[float, float]
"""The central 95 % of the resamples."""


@dataclass(frozen=True)
class Cell:
    """The score of one object, label source, split, kind of crop and PnP method, over all seeds.

    Attributes:
        position_95, orientation_95: intervals of the median errors (mm, deg); frames are resampled, and seeds
            where there are several.
    """

    object: str
    source: str
    split: str
    crops: str
    method: str
    score: PoseScore
    position_95: Interval = (np.nan, np.nan)
    orientation_95: Interval = (np.nan, np.nan)


@dataclass(frozen=True)
class Ratio:
    """The ratio of two medians, OURS / MANUAL, with its central 95 % over resampled frames and seeds."""

    object: str
    split: str
    crops: str
    method: str
    figure: str
    value: float
    low: float
    high: float


Found = tuple[Cell, list[list[Judged]]]
"""A cell with its judged instances, one list per seed, each in the order of the frames."""


def run_folder(out: Path, source: str, seed: int, name: str) -> Path:
    """The folder of a training: of an object's hourglass, or of the `detector`."""
    return out / source / f"seed{seed}" / name


def measure(out: Path, workspace: Path, objects: Sequence[str], seeds: int) -> Iterator[Found]:
    """Score the networks that are trained so far: one cell per object, source, protocol and method.

    Judged instances are kept in judged_<split>_<crops>.json beside their checkpoint: only new checkpoints,
    or those of labels that were exported anew, are run.
    """
    manual = exports_of(workspace)["MANUAL"]
    truth = true_objects(manual / "train.json", objects)
    for source, name, (split, crops) in product(EXPORTS, objects, PROTOCOLS):
        judged = [_judged(out, manual, source, name, split, crops, seed, truth) for seed in range(seeds)]
        judged = [rows for rows in judged if rows]
        for method in sorted({each.method for rows in judged for each in rows}):
            mine = [[each for each in rows if each.method == method] for rows in judged]
            pooled = score([each for rows in mine for each in rows], truth[name].surface)
            intervals = _intervals(mine)
            yield Cell(name, source, split, crops, method, pooled, *intervals), mine


def _judged(
    out: Path,
    manual: Path,
    source: Source,
    name: str,
    split: Split,
    crops: Crops,
    seed: int,
    truth: Mapping[str, TrueObject],
) -> list[Judged]:
    """Instances of a split, judged by the last checkpoints; none while a checkpoint is missing."""
    run = run_folder(out, source, seed, name)
    needed = [run / "last.ckpt"]
    if crops == "detected":
        needed.append(run_folder(out, source, seed, "detector") / "last.ckpt")
    if not all(path.exists() for path in needed):
        return []
    coco_json = manual / f"{split}.json"
    if split == "test":
        refuse_trained(needed, coco_json)
    kept = run / f"judged_{split}_{crops}.json"
    if kept.exists() and kept.stat().st_mtime > max(path.stat().st_mtime for path in (*needed, coco_json)):
        return load_judged(kept)
    pipeline = load_pipeline(needed[:1], needed[1] if crops == "detected" else None)
    judged = list(evaluate(pipeline, coco_json, crops=crops, methods=["epnp", "consensus"], truth=truth))
    save_judged(kept, judged)
    return judged


def refuse_trained(checkpoints: Sequence[Path], coco_json: Path) -> None:
    """Raise a DataError where a network was trained on a scene that is tested by now."""
    for checkpoint in checkpoints:
        if scenes := trained_scenes(checkpoint, coco_json):
            raise DataError(
                f"{checkpoint} was trained on scene {', '.join(scenes)}, which {coco_json} tests by now: the "
                "workspace was split anew; give another --out, or delete the folder of this one"
            )


# Intervals ----------------------------------------------------------------------------------------


def _errors(judged: Sequence[Sequence[Judged]]) -> Float64[np.ndarray, "seeds frames 2"]:
    """Position (mm) and orientation error (deg) per seed and frame."""
    units = np.array([1e3, 180 / np.pi])
    errors: Float64[np.ndarray, "seeds frames 2"] = np.array(
        [errors_table(rows)[:, :2] * units for rows in judged]
    )
    return errors


def resampled_medians(
    errors: Float64[np.ndarray, "seeds frames 2"],
) -> Float64[np.ndarray, "draws 2"]:
    """Medians of bootstrap resamples: each draws frames with replacement, and seeds where there are several.

    A drawn frame comes from all drawn seeds. Two arrays of the same shape are resampled alike, so that their
    ratios are those of pairs.
    """
    seeds, frames, _ = errors.shape
    rng = np.random.default_rng(0)
    of_seeds, of_frames = rng.integers(0, seeds, (DRAWS, seeds)), rng.integers(0, frames, (DRAWS, frames))
    drawn = errors[of_seeds[:, :, None], of_frames[:, None, :]]
    medians: Float64[np.ndarray, "draws 2"] = np.median(drawn.reshape(DRAWS, -1, 2), axis=1)
    return medians


def _middle(values: Float64[np.ndarray, " draws"]) -> Interval:
    """The central 95 %; nearest, since between a number and an infinite one nothing can be interpolated."""
    known = values[~np.isnan(values)]
    if not len(known):
        return np.nan, np.nan
    low, high = np.percentile(known, [2.5, 97.5], method="nearest")
    return float(low), float(high)


def _intervals(judged: Sequence[Sequence[Judged]]) -> tuple[Interval, Interval]:
    """The intervals of the median position and orientation errors."""
    if not judged or not judged[0]:
        return (np.nan, np.nan), (np.nan, np.nan)
    medians = resampled_medians(_errors(judged))
    return _middle(medians[:, 0]), _middle(medians[:, 1])


def ratios(found: Sequence[Found]) -> list[Ratio]:
    """The ratios OURS / MANUAL per object, protocol and method; both are resampled alike."""
    ours_of = {(c.object, c.split, c.crops, c.method): rows for c, rows in found if c.source == "OURS"}
    result = []
    for cell, manual in found:
        ours = ours_of.get((cell.object, cell.split, cell.crops, cell.method))
        if cell.source != "MANUAL" or ours is None or not _alike(ours, manual):
            continue
        errors = [_errors(rows) for rows in (ours, manual)]
        drawn = [resampled_medians(each) for each in errors]
        medians = [np.median(each.reshape(-1, 2), axis=0) for each in errors]
        for column, figure in enumerate(("position", "orientation")):
            with np.errstate(invalid="ignore"):  # both infinite: no ratio
                value = float(medians[0][column] / medians[1][column])
                low, high = _middle(drawn[0][:, column] / drawn[1][:, column])
            key = {"split": cell.split, "crops": cell.crops, "method": cell.method}
            result.append(Ratio(cell.object, **key, figure=figure, value=value, low=low, high=high))
    return result


def _alike(ours: Sequence[Sequence[Judged]], manual: Sequence[Sequence[Judged]]) -> bool:
    """Whether both have the same number of seeds, each with the same number of instances, and some."""
    sizes = [[len(rows) for rows in judged] for judged in (ours, manual)]
    return sizes[0] == sizes[1] and len(set(sizes[0])) == 1 and sizes[0][0] > 0


def counts(cells: Sequence[Cell], name: str, split: str) -> bool:
    """Whether MANUAL has learned the object well enough to compare: a PCK of `LEAST_PCK`, crops given."""
    wanted = (name, "MANUAL", split, "given")
    return any(
        (cell.object, cell.source, cell.split, cell.crops) == wanted and cell.score.pck >= LEAST_PCK
        for cell in cells
    )
