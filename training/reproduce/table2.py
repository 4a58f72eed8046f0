"""Table II: poses of networks trained on our labels and on true labels, side by side."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError
from training.options import DetectorNetwork, Learning, Machine, Network

if TYPE_CHECKING:
    from training.pose_evaluation import Judged, PoseScore, TrueObject

Source = Literal["OURS", "MANUAL"]
EXPORTS: dict[Source, str] = {"OURS": "coco", "MANUAL": "coco_truth"}
PROTOCOLS = {"val": "given", "test": "detected"}
"""The paper's: frames beside those trained on, the label's crop. The strict one: scenes never trained on."""

LEAST_PCK = 0.8
"""Of MANUAL on val: below, the networks have not learned enough for a comparison of their labels."""


@dataclass(frozen=True)
class Cell:
    """An object, label source, protocol and PnP method."""

    object: str
    source: str
    split: str
    method: str
    score: PoseScore


@dataclass(frozen=True)
class Ratio:
    """OURS by MANUAL of a median, with the central 95 % of resampled instances."""

    object: str
    split: str
    method: str
    figure: str
    value: float
    low: float
    high: float


def table2(
    workspace: Path,
    objects: list[str],
    out: Path = Path("runs/table2"),
    network: Network = Network(),  # noqa: B008 (frozen)
    learning: Learning = Learning(),  # noqa: B008
    augment: Augmentation = Augmentation(),  # noqa: B008
    detector: DetectorNetwork = DetectorNetwork(),  # noqa: B008
    detector_learning: Learning = Learning(),  # noqa: B008
    machine: Machine = Machine(),  # noqa: B008
    validate_every: int = 1,
    seed: int = 0,
) -> None:
    """Errors of poses by networks trained on our labels and on true ones (the paper's Table II).

    A hourglass an object and a detector a label source, the same frames, steps and seed for both sources.
    Every training can be cut off: run again and it goes on; table2.json and table2.html are written anew
    after each hourglass. Preset: --config training/configs/table2_cpu.yaml.

    Args:
        workspace: a built workspace whose truth is known.
        objects: their names; the paper has three.
        out: folder for checkpoints, figures, table2.json and table2.html.
        network: the hourglass.
        learning: of the hourglass.
        augment: of the hourglass's crops; the detector's are not turned.
        detector: which, and how large.
        detector_learning: of the detector.
        machine: device, precision, processes.
        validate_every: epochs.
        seed: of everything drawn at random.
    """
    from training.reproduce.table2_page import write_page
    from training.runs import trained_epochs
    from training.train_detector import train_detector
    from training.train_keypoints import train_keypoints

    exports = _exports(workspace)
    upright = replace(augment, rotation_deg=0.0)
    for source, export in exports.items():  # first, so that every hourglass is judged by both protocols
        run = out / source / "detector"
        if trained_epochs(run / "last.ckpt") < detector_learning.epochs:
            with _measured(run):
                train_detector(
                    export, run, detector, detector_learning, upright, machine,
                    validate_every=validate_every, seed=seed, resume=True,
                )  # fmt: skip
    for name in objects:
        for source, export in exports.items():
            run = out / source / name
            if trained_epochs(run / "last.ckpt") < learning.epochs:
                with _measured(run):
                    train_keypoints(
                        export, name, run, network, learning, augment, machine,
                        validate_every=validate_every, seed=seed, resume=True,
                    )  # fmt: skip
                write_page(out, workspace, objects)
    print(write_page(out, workspace, objects))


def measure(out: Path, workspace: Path, objects: list[str]) -> Iterator[tuple[Cell, list[Judged]]]:
    """A cell an object, source, protocol and method of the networks there are.

    Judged instances are kept in <out>/<source>/<object>/judged, so that only new checkpoints are run.
    """
    from training.pose_evaluation import score, true_objects

    truth = true_objects(_exports(workspace)["MANUAL"] / "train.json")
    for source in EXPORTS:
        for name in objects:
            for split in PROTOCOLS:
                judged = _judged(out, workspace, source, name, split, truth)
                for method in sorted({each.method for each in judged}):
                    rows = [each for each in judged if each.method == method]
                    yield Cell(name, source, split, method, score(rows, truth[name])), rows


def _judged(
    out: Path, workspace: Path, source: Source, name: str, split: str, truth: dict[str, TrueObject]
) -> list[Judged]:
    """Instances of a split, judged by the last checkpoints; none while a checkpoint is missing."""
    from training.pose_evaluation import evaluate, load_judged, save_judged
    from training.pose_pipeline import load_pipeline

    crops: Any = PROTOCOLS[split]
    needed = [out / source / name / "last.ckpt"]
    needed += [out / source / "detector" / "last.ckpt"] if crops == "detected" else []
    if not all(path.exists() for path in needed):
        return []
    kept = out / source / name / f"judged_{split}.json"
    if kept.exists() and kept.stat().st_mtime > max(path.stat().st_mtime for path in needed):
        return load_judged(kept)
    pipeline = load_pipeline(needed[:1], needed[1] if crops == "detected" else None)
    coco_json = _exports(workspace)["MANUAL"] / f"{split}.json"
    judged = list(evaluate(pipeline, coco_json, crops=crops, methods=["epnp", "consensus"], truth=truth))
    save_judged(kept, judged)
    return judged


def ratios(found: list[tuple[Cell, list[Judged]]], *, draws: int = 2000) -> list[Ratio]:
    """OURS by MANUAL for every object, protocol and method; instances are resampled in pairs."""
    import numpy as np

    from training.pose_evaluation import errors_table

    by_key = {(c.source, c.object, c.split, c.method): rows for c, rows in found}
    result = []
    for (source, *rest), manual in by_key.items():
        ours = by_key.get(("OURS", *rest))
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
            result.append(Ratio(*rest, figure, value, float(low), float(high)))
    return result


def counts(found: list[tuple[Cell, list[Judged]]], name: str) -> bool:
    """MANUAL has learned enough of the object for a comparison: PCK of `LEAST_PCK` on val."""
    keys = ("MANUAL", "val")
    return any(
        (cell.source, cell.split) == keys and cell.object == name and cell.score.pck >= LEAST_PCK
        for cell, _ in found
    )


def _exports(workspace: Path) -> dict[Source, Path]:
    """Folders of the two label sources; the true one is exported when it is not there yet."""
    from rpl_data.build import context_of
    from rpl_data.pipeline.products import export_truth
    from rpl_data.workspace import Workspace

    place = Workspace(workspace)
    folders = {source: place.export(name) for source, name in EXPORTS.items()}
    if not folders["OURS"].exists():
        raise DataError(f"{workspace} has no export/coco; run `rpl build` with `export: [coco]`")
    if not folders["MANUAL"].exists():
        export_truth(context_of(place))
    return folders


class _measured:
    """Adds the CPU and wall seconds of its block to <run>/seconds.json, over all resumptions."""

    def __init__(self, run: Path) -> None:
        self._path = run / "seconds.json"

    def __enter__(self) -> None:
        self._cpu_s, self._wall_s = time.process_time(), time.perf_counter()

    def __exit__(self, *_: object) -> None:
        from rpl_data.files import read_json, write_json

        before = read_json(self._path) if self._path.exists() else {"cpu_s": 0.0, "wall_s": 0.0}
        cpu_s, wall_s = time.process_time() - self._cpu_s, time.perf_counter() - self._wall_s
        write_json(self._path, {"cpu_s": before["cpu_s"] + cpu_s, "wall_s": before["wall_s"] + wall_s})
