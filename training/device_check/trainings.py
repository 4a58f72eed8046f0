"""Short trainings on an export: the loss falls, poses come out, and an interrupted one ends the same."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from rpl_data.torch.keypoints import KeypointDataset
from rpl_data.types import DataError

from ..evaluate_pose import evaluate_pose
from ..runs.options import KeypointArchitecture, Learning, Machine, Network, UseDepth
from ..train_keypoints import train_keypoints
from .record import Record
from .speeds import LITTLE

LEAST_EPOCHS = 4
"""Fewer cannot show that a loss falls."""

FALLEN = 0.5
"""The last epoch's loss must be below this share of the first epoch's."""


@dataclass(frozen=True)
class Place:
    """What is trained on, and where.

    Attributes:
        coco: folder of the export.
        object: its object.
        metres_per_unit: of depth images whose unit the export does not say.
        little: tiny networks on the CPU.
    """

    coco: Path
    object: str
    metres_per_unit: float | None
    little: bool

    @property
    def machine(self) -> Machine:
        """A GPU with workers beside it, or the CPU."""
        return Machine("cpu") if self.little else Machine("gpu", workers=4)


def train_and_judge(record: Record, place: Place, name: KeypointArchitecture, epochs: int) -> None:
    """Train a network, note its losses, and its poses without and with depth."""
    network, learning = _lesson(name, epochs, little=place.little)
    started = time.perf_counter()
    with TemporaryDirectory() as scratch:
        run = Path(scratch) / "run"
        last = train_keypoints(
            place.coco,
            place.object,
            run,
            network,
            learning,
            machine=place.machine,
            validate_every=max(1, epochs // 4),
        )
        seconds = time.perf_counter() - started
        losses = epoch_losses(run)
        poses = {split: _poses(place, last, split, Path(scratch)) for split in ("val", "test")}
    print(
        f"loss of {place.object} ({name}): {losses[0]:.5f} in the first epoch, {losses[-1]:.5f} in the last"
    )
    row = {"network": name, "epochs": epochs, "seconds": seconds, "first": losses[0], "last": losses[-1]}
    record.add("trainings", {**row, "ema": learning.ema, "poses": poses})


def epochs_in(place: Place, seconds: float, rate: float | None, most: int) -> int:
    """How many epochs there is time for, by the training steps per second; loading takes some of it too."""
    if rate is None:
        return min(most, LEAST_EPOCHS)
    instances = len(KeypointDataset(place.coco, split="train", object=place.object))
    steps = max(1, instances // Learning().batch)
    return min(most, max(LEAST_EPOCHS, int(0.6 * seconds * rate / steps)))


def refuse_loss_that_stays(record: Record) -> None:
    """Fail the check where a loss did not fall.

    Raises:
        DataError: a loss did not fall.
    """
    for row in record.content.get("trainings", []):
        if not row["last"] < FALLEN * row["first"]:
            raise DataError(
                f"the loss of {row['network']} fell from {row['first']:.5f} to {row['last']:.5f} only; "
                f"expected {FALLEN:.0%} or less"
            )


def resume_and_compare(record: Record, place: Place) -> None:
    """Train two epochs in one go and with a pause between them; say whether the weights are the same."""
    _, learning = _lesson("hourglass", 2, little=place.little)
    options: Mapping[str, Any] = {
        "network": LITTLE,
        "learning": replace(learning, ema=0.9),
        "machine": replace(place.machine, deterministic=True),
        "validate_every": 0,
    }
    with TemporaryDirectory() as scratch:
        runs = Path(scratch) / "straight", Path(scratch) / "paused"
        train_keypoints(place.coco, place.object, runs[0], **options)
        train_keypoints(place.coco, place.object, runs[1], **options, until=1)
        train_keypoints(place.coco, place.object, runs[1], **options, resume=True)
        torch.use_deterministic_algorithms(False)  # what is timed later runs as usual
        one, other = (torch.load(run / "last.ckpt", weights_only=True)["state_dict"] for run in runs)
    off = max(float((one[key].double() - other[key].double()).abs().max()) for key in one)
    print(
        f"weights of a resumed training differ from an uninterrupted one's by at most {off:.1e}", flush=True
    )
    record.note(resumed_differs_by=off)


def refuse_another_end(record: Record) -> None:
    """Fail the check where a resumed training ended with other weights.

    Raises:
        DataError: the weights differ.
    """
    if record.content.get("resumed_differs_by", 0.0) > 0:
        off = record.content["resumed_differs_by"]
        raise DataError(f"a resumed training ended with weights that differ by {off:.1e}; expected none")


def _lesson(name: KeypointArchitecture, epochs: int, *, little: bool) -> tuple[Network, Learning]:
    """The paper's preset for its hourglass; a shorter cycle with averaged weights for the others."""
    network = replace(LITTLE if little else Network(), architecture=name)
    if little:
        if name != "hourglass":  # a ResNet is large for a CPU, so it sees less
            network = replace(network, input_px=32, heatmap_px=8)
        return network, Learning(epochs, 8, "adam", 2e-3, ema=0.0 if name == "hourglass" else 0.9)
    if name == "hourglass":
        return network, Learning(epochs)
    return network, Learning(epochs, 16, "adamw", 1e-3, "one_cycle", channels_last=True, ema=0.99)


def _poses(place: Place, checkpoint: Path, split: str, scratch: Path) -> dict[str, Any]:
    """Median errors and PCK of a split's poses, crops given, without and with depth."""
    if not (place.coco / f"{split}.json").exists():
        return {}
    found = {}
    ways: dict[str, UseDepth] = {"without depth": False, "with depth": "auto"}
    for way, depth in ways.items():
        print(f"poses in {split}, crops given, {way}:")
        evaluate_pose(
            place.coco,
            [checkpoint],
            split=split,
            crops="given",
            depth=depth,
            metres_per_unit=place.metres_per_unit,
            out=scratch,
        )
        figures = json.loads((scratch / f"{split}_poses.json").read_text(encoding="utf-8"))["figures"]
        found[way] = figures
    return found


def epoch_losses(run: Path) -> list[float]:
    """The training loss of each epoch, from the CSV log of a run."""
    (log,) = run.rglob("metrics.csv")
    with log.open(encoding="utf-8") as file:
        rows = [row["train_loss"] for row in csv.DictReader(file)]
    return [float(row) for row in rows if row]
