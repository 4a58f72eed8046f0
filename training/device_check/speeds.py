"""Training steps per second and memory: per network, precision, memory layout, with and without compiling."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from rpl_data.types import DataError

from ..keypoints.hourglass import mean_squares
from ..keypoints.networks import network_of
from ..masks.mask_rcnn import build_model
from ..runs.options import Learning, MaskNetwork, Network, Precision
from .record import Record

LITTLE = Network(stacks=1, features=32, levels=3, input_px=64, heatmap_px=16)
LITTLE_MASKS = MaskNetwork("resnet18", 64, stages=3, channels=32, hidden=64, proposals=64, rois=32)

MASK_RCNN = "Mask R-CNN"

USUAL_S, COMPILING_S = 15.0, 60.0
"""What a row may take, so that the check ends in time: a usual one, and one that compiles."""


@dataclass(frozen=True)
class Way:
    """One row: what is trained and how.

    Attributes:
        network: an architecture of the keypoint network, or `Mask R-CNN`.
        precision, channels_last, compiled: how.
    """

    network: Any
    precision: Precision
    channels_last: bool = False
    compiled: bool = False

    def __str__(self) -> str:
        """`resnet50, bf16-mixed, channels_last, compiled`."""
        how = ["channels_last"] * self.channels_last + ["compiled"] * self.compiled
        return ", ".join([self.network, self.precision, *how])


WAYS = [
    Way("hourglass", "bf16-mixed"),
    Way(MASK_RCNN, "32-true"),
    Way(MASK_RCNN, "bf16-mixed"),
    Way("resnet50", "bf16-mixed"),
    Way("hourglass", "16-mixed"),
    Way("hourglass", "bf16-mixed", channels_last=True),
    Way("resnet50", "bf16-mixed", channels_last=True),
    Way("resnet18", "bf16-mixed", channels_last=True),
    Way("convnext_tiny", "bf16-mixed", channels_last=True),
    Way(MASK_RCNN, "16-mixed"),
    Way("hourglass", "bf16-mixed", compiled=True),
    Way("resnet50", "bf16-mixed", channels_last=True, compiled=True),
]
"""Those that compile are last, since they take longest."""

LITTLE_WAYS = [
    Way("hourglass", "32-true"),
    Way("resnet18", "bf16-mixed", channels_last=True),
    Way(MASK_RCNN, "32-true"),
]


@dataclass(frozen=True)
class Job:
    """Something to take training steps on: the network, what gives the loss of a batch, images in it."""

    network: nn.Module
    loss: Callable[[], Tensor]
    batch: int


def print_heading() -> None:
    """Print the heading of the rows."""
    print(f"{'network':14s} {'precision':10s} channels_last compile  steps/s images/s    MiB", flush=True)


def measure_speeds(record: Record, device: torch.device, steps: int, *, little: bool) -> None:
    """Measure and print a row per way, as long as there is time.

    Raises:
        DataError: no row could be measured.
    """
    print_heading()
    for way in LITTLE_WAYS if little else WAYS:
        if record.has_time(str(way), COMPILING_S if way.compiled else USUAL_S):
            measure(record, way, device, steps, little=little)
    rows = record.content.get("speeds", [])
    if rows and all("failed" in row for row in rows):
        raise DataError(f"no training step could be taken: {rows[0]['failed']}")


def measure(record: Record, way: Way, device: torch.device, steps: int, *, little: bool) -> float | None:
    """Measure and print a row; training steps per second, None where none could be taken."""
    start = f"{way.network:14s} {way.precision:10s}"
    try:
        job = _job(way, device, little=little)
        rate, memory_mib = _measured(job, device, way.precision, steps)
    except RuntimeError as error:  # no compiler, or too little memory: the other rows are still of use
        print(f"{start} failed: {str(error).splitlines()[0]}", flush=True)
        record.add("speeds", {**asdict(way), "failed": str(error)[:500]})
        return None
    how = f"{way.channels_last!s:13s} {way.compiled!s:7s}"
    print(f"{start} {how} {rate:8.2f} {rate * job.batch:8.1f} {memory_mib:6.0f}", flush=True)
    record.add("speeds", {**asdict(way), "steps_per_s": rate, "batch": job.batch, "mib": memory_mib})
    return rate


def _job(way: Way, device: torch.device, *, little: bool) -> Job:
    if way.network == MASK_RCNN:
        return _mask_rcnn(device, little=little)
    return _keypoints(way, device, little=little)


def _keypoints(way: Way, device: torch.device, *, little: bool) -> Job:
    """A keypoint network of the paper's size on a batch of random crops of an object with 11 keypoints."""
    options, batch, keypoints = (LITTLE, 2, 11) if little else (Network(), Learning().batch, 11)
    options = Network(**asdict(options) | {"architecture": way.network})
    network = network_of(keypoints, options).to(device).train()
    images = torch.rand(batch, 3, options.input_px, options.input_px, device=device)
    if way.channels_last:
        network = network.to(memory_format=torch.channels_last)
        images = images.contiguous(memory_format=torch.channels_last)
    if way.compiled:
        network.compile()
    targets = torch.rand(batch, keypoints, options.heatmap_px, options.heatmap_px, device=device)
    weights = torch.ones(batch, keypoints, device=device)

    def loss() -> Tensor:
        losses = [mean_squares(output.float(), targets, weights) for output in network(images)]
        return torch.stack(losses).mean()

    return Job(network, loss, batch)


def _mask_rcnn(device: torch.device, *, little: bool) -> Job:
    """The paper's Mask R-CNN, from random weights, on random images with one square object each."""
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

    return Job(network, loss, batch)


def _measured(job: Job, device: torch.device, precision: Precision, steps: int) -> tuple[float, float]:
    """Training steps per second and the most memory they took, in MiB (0 on the CPU)."""
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
