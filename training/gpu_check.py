"""Check the training programs on this machine's GPU: `python -m training.gpu_check --help`."""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from .runs.options import Learning, Machine, MaskNetwork, Network, Precision

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn

FALLEN = 0.5
"""The last epochs' loss must be below this share of the first epoch's."""

HEATMAP_TOLERANCE = 1e-5
"""Largest difference between a heatmap drawn on the device and on the CPU."""

LITTLE = Network(stacks=1, features=32, levels=3, input_px=64, heatmap_px=16)
LITTLE_MASKS = MaskNetwork("resnet18", 64, stages=3, channels=32, hidden=64, proposals=64, rois=32)


def gpu_check(
    coco: Path = Path("workspaces/demo/export/coco"),
    object: str = "carton",  # noqa: A002 (the recipe's and the CLI's word for it)
    epochs: int = 150,
    steps: int = 30,
    little: bool = False,
) -> None:
    """Run the paper's presets on the GPU and print what was measured; status 1 when a check fails.

    Heatmaps drawn on the device against those of the CPU; training steps per second and memory of the
    hourglass and of Mask R-CNN, with and without mixed precision, channels_last and torch.compile; and a
    training on the demo whose loss must fall, followed by its poses (a small Table II). Takes less than eight
    minutes on one GPU. `--little true` runs the same checks with tiny networks on the CPU.

    Args:
        coco: folder that `rpl export` wrote.
        object: the object to train on.
        epochs: passes over the training images.
        steps: timed steps per row.
        little: tiny networks on the CPU, to see that the checks themselves work.
    """
    import torch

    from rpl_data.types import DataError

    if not little and not torch.cuda.is_available():
        raise DataError("there is no CUDA GPU here; run it where there is one, or with --little true")
    device = torch.device("cpu" if little else "cuda")
    print(f"torch {torch.__version__} on {torch.cuda.get_device_name() if not little else 'the CPU'}")
    difference = heatmap_difference(device)
    print(f"heatmaps: device and CPU differ by at most {difference:.1e}")
    print_speeds(device, steps, little=little)
    first, last = train_on_export(coco, object, epochs, little=little)
    print(f"loss of {object}: {first:.5f} in the first epoch, {last:.5f} in the last")
    if difference > HEATMAP_TOLERANCE:
        raise DataError(f"heatmaps differ by {difference:.1e}, expected at most {HEATMAP_TOLERANCE:.0e}")
    if not last < FALLEN * first:
        raise DataError(f"the loss fell from {first:.5f} to {last:.5f} only; expected {FALLEN:.0%} or less")


def heatmap_difference(device: torch.device) -> float:
    """Largest difference between heatmaps drawn on a device and on the CPU, positions outside included."""
    import torch

    from rpl_data.torch.heatmaps import draw_heatmaps

    positions = 80 * torch.rand(64, 11, 2, generator=torch.Generator().manual_seed(0)) - 8
    positions[::7, 0] = torch.nan
    here = draw_heatmaps(positions, size_px=64)
    there = draw_heatmaps(positions.to(device), size_px=64).cpu()
    return float((here - there).abs().max())


@dataclass(frozen=True)
class Job:
    """Something to take training steps on.

    Attributes:
        name: of the network.
        network: its parameters are trained.
        loss: gives the loss of one batch.
        batch: images in it.
    """

    name: str
    network: nn.Module
    loss: Callable[[], Tensor]
    batch: int


def print_speeds(device: torch.device, steps: int, *, little: bool) -> None:
    """Print steps per second, images per second and memory, one row per network and way to run it."""
    ways: list[tuple[Precision, bool, bool]] = [
        ("32-true", False, False),
        ("16-mixed", False, False),
        ("bf16-mixed", False, False),
        ("bf16-mixed", True, False),
        ("bf16-mixed", True, True),
    ]
    if little:
        ways = [("32-true", False, False), ("bf16-mixed", True, False)]
    print(f"{'network':10s} {'precision':10s} channels_last compile  steps/s images/s    MiB")
    for precision, channels_last, compiled in ways:
        job = hourglass(device, little=little, channels_last=channels_last, compiled=compiled)
        rate, memory_mib = measured(job, device, precision, steps)
        print(
            f"{job.name:10s} {precision:10s} {channels_last!s:13s} {compiled!s:7s} {rate:8.2f} "
            f"{rate * job.batch:8.1f} {memory_mib:6.0f}"
        )
    for precision in dict.fromkeys(way[0] for way in ways):
        job = mask_rcnn(device, little=little)
        rate, memory_mib = measured(job, device, precision, steps)
        print(
            f"{job.name:10s} {precision:10s} {'False':13s} {'False':7s} {rate:8.2f} "
            f"{rate * job.batch:8.1f} {memory_mib:6.0f}"
        )


def hourglass(device: torch.device, *, little: bool, channels_last: bool, compiled: bool) -> Job:
    """The paper's hourglass on a batch of random crops of an object with 11 keypoints."""
    import torch

    from .keypoints.hourglass import StackedHourglass, mean_squares

    options, batch, keypoints = (LITTLE, 2, 11) if little else (Network(), Learning().batch, 11)
    network = StackedHourglass(
        keypoints, stacks=options.stacks, features=options.features, levels=options.levels
    ).to(device)
    images = torch.rand(batch, 3, options.input_px, options.input_px, device=device)
    if channels_last:
        network = network.to(memory_format=torch.channels_last)
        images = images.contiguous(memory_format=torch.channels_last)
    targets = torch.rand(batch, keypoints, options.heatmap_px, options.heatmap_px, device=device)
    weights = torch.ones(batch, keypoints, device=device)
    run: Any = torch.compile(network) if compiled else network

    def loss() -> Tensor:
        losses = [mean_squares(output.float(), targets, weights) for output in run(images)]
        return torch.stack(losses).mean()

    return Job("hourglass", network, loss, batch)


def mask_rcnn(device: torch.device, *, little: bool) -> Job:
    """The paper's Mask R-CNN, from random weights, on random images with one square object each."""
    import torch

    from .masks.mask_rcnn import build_model

    options, batch = replace(LITTLE_MASKS if little else MaskNetwork(), norm="batch"), 2
    network = build_model(options, 2).to(device).train()
    size = options.size_px
    images = [torch.rand(3, size, size, device=device) for _ in range(batch)]
    mask = torch.zeros(1, size, size, dtype=torch.uint8, device=device)
    mask[:, size // 4 : size // 2, size // 4 : size // 2] = 1
    box = torch.tensor([[size // 4, size // 4, size // 2, size // 2]], dtype=torch.float32, device=device)
    target = {"boxes": box, "labels": torch.ones(1, dtype=torch.int64, device=device), "masks": mask}

    def loss() -> Tensor:
        losses: dict[str, Tensor] = network(images, [target] * batch)
        return torch.stack([*losses.values()]).sum()

    return Job("Mask R-CNN", network, loss, batch)


def measured(job: Job, device: torch.device, precision: Precision, steps: int) -> tuple[float, float]:
    """Training steps per second and the most memory they took, in MiB (0 on the CPU)."""
    import torch

    kinds = {"16-mixed": torch.float16, "bf16-mixed": torch.bfloat16}
    kind = kinds.get(precision)
    scaler = torch.amp.GradScaler(device.type, enabled=precision == "16-mixed" and device.type == "cuda")
    optimizer = torch.optim.SGD(job.network.parameters(), lr=1e-6)

    def step() -> None:
        optimizer.zero_grad(set_to_none=True)
        with torch.autocast(device.type, kind or torch.bfloat16, enabled=kind is not None):
            loss = job.loss()
        scaler.scale(loss).backward()  # type: ignore[no-untyped-call]
        scaler.step(optimizer)
        scaler.update()

    on_gpu = device.type == "cuda"
    for _ in range(3):  # the first steps choose kernels and compile
        step()
    if on_gpu:
        torch.cuda.synchronize()
        torch.cuda.reset_peak_memory_stats()
    started = time.perf_counter()
    for _ in range(steps):
        step()
    if on_gpu:
        torch.cuda.synchronize()
    seconds = time.perf_counter() - started
    return steps / seconds, torch.cuda.max_memory_allocated() / 2**20 if on_gpu else 0.0


def train_on_export(coco: Path, object: str, epochs: int, *, little: bool) -> tuple[float, float]:  # noqa: A002
    """Train the hourglass with the paper's preset, print its poses; loss of the first and last epoch."""
    from .evaluate_pose import evaluate_pose
    from .train_keypoints import train_keypoints

    network = LITTLE if little else Network()
    learning = Learning(epochs, 8, "adam", 2e-3) if little else Learning(epochs)
    machine = Machine("cpu") if little else Machine("gpu", workers=4)
    with TemporaryDirectory() as scratch:
        last = train_keypoints(
            coco,
            object,
            Path(scratch),
            network,
            learning,
            machine=machine,
            validate_every=max(1, epochs // 4),
        )
        for split in ("val", "test"):
            print(f"poses in {split}, crops given:")
            evaluate_pose(coco, [last], split=split, crops="given")
        losses = epoch_losses(Path(scratch))
    return losses[0], losses[-1]


def epoch_losses(run: Path) -> list[float]:
    """The training loss of each epoch, from the CSV log of a run."""
    (log,) = run.rglob("metrics.csv")
    with log.open(encoding="utf-8") as file:
        rows = [row["train_loss"] for row in csv.DictReader(file)]
    return [float(row) for row in rows if row]


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(gpu_check))
