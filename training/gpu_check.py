"""Check the training programs on this machine's GPU: `python -m training.gpu_check --help`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    from .device_check.record import Record
    from .device_check.trainings import Place

HEATMAP_TOLERANCE = 1e-5
"""Largest difference between a heatmap drawn on the device and on the CPU."""

TRAINING_SHARE = 0.3
"""Share of the time for the training of the paper's hourglass; that of the ResNet takes a third of it."""


def gpu_check(
    coco: Path = Path("workspaces/demo/export/coco"),
    object: str = "carton",  # noqa: A002 (the recipe's and the CLI's word for it)
    epochs: int = 150,
    steps: int = 30,
    minutes: float = 8.0,
    metres_per_unit: float | None = None,
    out: Path = Path("runs/gpu_check.json"),
    little: bool = False,
) -> None:
    """Run the training programs on the GPU and print what was measured; status 1 when a check fails.

    Heatmaps drawn on the device against those of the CPU; training steps per second and memory of the
    keypoint networks and of Mask R-CNN, with and without mixed precision, channels_last and torch.compile;
    trainings on the demo, of the paper's hourglass and of a ResNet with averaged weights, whose loss must
    fall, followed by their poses without and with depth (a small Table II); and a training that is resumed,
    whose weights must be those of one that is not. `--little true` runs the same checks with tiny networks on
    the CPU.

    Args:
        coco: folder that `rpl export` wrote.
        object: the object to train on.
        epochs: most passes over the training images, 4 or more; fewer where there is no time for them.
        steps: timed steps per row.
        minutes: how long all of it may take; what there is no time for is left out and named.
        metres_per_unit: of the depth images, for an export that does not say it.
        out: JSON file of everything that is measured, written after every row.
        little: tiny networks on the CPU, to see that the checks themselves work.
    """
    import torch

    from rpl_data.types import DataError

    if not little and not torch.cuda.is_available():
        raise DataError("there is no CUDA GPU here; run it where there is one, or with --little true")

    from .device_check.record import Record
    from .device_check.speeds import measure_speeds
    from .device_check.trainings import (
        LEAST_EPOCHS,
        Place,
        refuse_another_end,
        refuse_loss_that_stays,
        resume_and_compare,
    )

    if epochs < LEAST_EPOCHS or steps < 1:
        raise DataError(
            f"--epochs is {epochs}, --steps {steps}; expected at least {LEAST_EPOCHS}, since fewer cannot "
            "show that a loss falls, and 1"
        )
    device, record = torch.device("cpu" if little else "cuda"), Record(out, minutes)
    place = Place(coco, object, metres_per_unit, little)
    describe(record, little=little)
    difference = heatmap_difference(device)
    print(f"heatmaps: device and CPU differ by at most {difference:.1e}", flush=True)
    record.note(heatmaps_differ_by=difference)
    resume_and_compare(record, place)
    train_in_time(record, place, epochs, device, steps)
    measure_speeds(record, device, steps, little=little)
    print(f"{out}: everything that was measured, in {minutes - record.left_s() / 60:.1f} min")
    if difference > HEATMAP_TOLERANCE:
        raise DataError(f"heatmaps differ by {difference:.1e}, expected at most {HEATMAP_TOLERANCE:.0e}")
    refuse_loss_that_stays(record)
    refuse_another_end(record)


def describe(record: Record, *, little: bool) -> None:
    """Print and note what this runs on."""
    import platform
    from importlib.metadata import version

    import torch
    import torchvision

    name = "the CPU" if little else torch.cuda.get_device_name()
    print(f"torch {torch.__version__} on {name}", flush=True)
    record.note(
        device=name,
        python=platform.python_version(),
        torch=torch.__version__,
        torchvision=torchvision.__version__,
        lightning=version("pytorch-lightning"),
    )


def train_in_time(record: Record, place: Place, most: int, device: torch.device, steps: int) -> None:
    """Train the hourglass, then a ResNet, for as many epochs as their share of the time allows."""
    from .device_check.speeds import Way, measure, print_heading
    from .device_check.trainings import epochs_in, train_and_judge

    hourglass, resnet = Way("hourglass", "32-true"), Way("resnet18", "32-true", channels_last=True)
    for way, share in ((hourglass, TRAINING_SHARE), (resnet, TRAINING_SHARE / 3)):
        print_heading()
        rate = measure(record, way, device, steps, little=place.little)
        epochs = epochs_in(place, share * 60 * record.minutes, rate, most)
        train_and_judge(record, place, way.network, epochs)


def heatmap_difference(device: torch.device) -> float:
    """Largest difference between heatmaps drawn on a device and on the CPU, positions outside included."""
    import torch

    from rpl_data.torch.heatmaps import draw_heatmaps

    positions = 80 * torch.rand(64, 11, 2, generator=torch.Generator().manual_seed(0)) - 8
    positions[::7, 0] = torch.nan
    here = draw_heatmaps(positions, size_px=64)
    there = draw_heatmaps(positions.to(device), size_px=64).cpu()
    return float((here - there).abs().max())


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(gpu_check))
