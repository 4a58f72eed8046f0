"""The options of the training programs, named as in their YAML files. No torch, so that help is quick."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rpl_data.types import DataError

Crops = Literal["given", "detected"]
"""Where an object's crop comes from: the box of its label, or the detector."""

UseDepth = bool | Literal["auto"]
"""Whether poses use depth; `auto` where there is some."""

Architecture = Literal["small_fcos", "fcos", "ssdlite"]
KeypointArchitecture = Literal["hourglass", "resnet18", "resnet34", "resnet50", "convnext_tiny"]
Precision = Literal["32-true", "16-mixed", "bf16-mixed"]

IMAGE_SUFFIXES = {".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"}
"""Endings of the images that are predicted on."""

SMALLEST_IMAGE_PX = 32
"""Narrowest image that the detector's feature map of stride 8 can halve twice more."""

HIGHEST_SEED = 2**32 - 1
"""NumPy takes no higher one."""


@dataclass(frozen=True)
class Network:
    """The keypoint network, its input and its output. The defaults are the paper's.

    Attributes:
        stacks: hourglasses one behind the other.
        features: channels of the hourglasses, or of the pyramid behind another architecture.
        levels: how often an hourglass halves its feature map.
        input_px: side of the square input crop, in pixels.
        heatmap_px: side of a heatmap in pixels: a quarter of the input.
        sigma_px: standard deviation of the target Gaussians, in heatmap pixels.
        loss: `squares` (the paper's) or `entropy`.
        architecture: `hourglass` is the paper's. The others are torchvision's, with a heatmap head on a
            feature pyramid: they can start from trained `weights`, and need inputs of a multiple of 32 px;
            stacks and levels do not concern them.
    """

    stacks: int = 2
    features: int = 256
    levels: int = 4
    input_px: int = 256
    heatmap_px: int = 64
    sigma_px: float = 1.0
    loss: Literal["squares", "entropy"] = "squares"
    architecture: KeypointArchitecture = "hourglass"

    def __post_init__(self) -> None:
        """Refuse what cannot be built; the sizes are judged together with the images."""
        if min(self.stacks, self.levels) < 1 or self.features < 2:
            raise DataError("network: stacks and levels must be at least 1, features at least 2")


@dataclass(frozen=True)
class DetectorNetwork:
    """The detector and its input.

    Attributes:
        architecture: `small_fcos` is FCOS with one feature map of stride 8 behind an hourglass, for CPUs;
            `fcos` has a ResNet-50 with a feature pyramid; `ssdlite` is SSDLite320 with MobileNetV3.
        width_px: width to which images are resized, in pixels.
        features: channels of `small_fcos`, a multiple of 32.
    """

    architecture: Architecture = "small_fcos"
    width_px: int = 192
    features: int = 64

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        if self.width_px < SMALLEST_IMAGE_PX:
            raise DataError(f"network.width_px must be at least {SMALLEST_IMAGE_PX}, got {self.width_px}")
        if self.architecture == "small_fcos" and (self.features < 32 or self.features % 32):
            raise DataError(f"network.features must be a multiple of 32, got {self.features}")


@dataclass(frozen=True)
class MaskNetwork:
    """All that is needed to build the Mask R-CNN again. The defaults are the paper's.

    Attributes:
        backbone: the ResNet.
        size_px: shorter side of the image as the network sees it, in pixels. Anchors are 1/16 to 1 of it.
        stages: how many of the ResNet's four stages are used. The last one's grid is too coarse for small
            images.
        channels: channels of the feature pyramid and of the mask head.
        hidden: width of the two layers of the box head.
        proposals: boxes per image that the first stage hands to the second.
        rois: how many of these boxes per image the second stage is trained on.
        detections: largest number of objects found in an image.
        norm: normalisation of the ResNet. `auto` is `frozen` with trained weights and `batch` from scratch.
    """

    backbone: Literal["resnet18", "resnet34", "resnet50", "resnet101"] = "resnet101"
    size_px: int = 512
    stages: int = 4
    channels: int = 256
    hidden: int = 1024
    proposals: int = 2000
    rois: int = 512
    detections: int = 100
    norm: Literal["auto", "batch", "group", "frozen"] = "auto"

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        if self.size_px < 64 or self.size_px % 16:
            raise DataError(f"network.size_px must be a multiple of 16 and at least 64, got {self.size_px}")
        if not 2 <= self.stages <= 4:
            raise DataError(f"network.stages must be 2, 3 or 4, got {self.stages}")
        if min(self.channels, self.hidden, self.proposals, self.rois, self.detections) < 1:
            raise DataError("network: channels, hidden, proposals, rois and detections must be at least 1")


@dataclass(frozen=True)
class Learning:
    """How long and how fast a network is trained. The defaults are the paper's for the hourglass.

    Attributes:
        epochs: passes over the training images.
        batch: samples per step, and per process when several train together.
        optimizer: `rmsprop` (the paper's for the hourglass), `sgd` with Nesterov momentum 0.9 (the paper's
            for Mask R-CNN), `adam` or `adamw`.
        rate: learning rate; the highest one where it changes.
        schedule: `constant`, or `one_cycle` (Smith and Topin 2018): up during the first 30 % of the steps,
            then down to nothing.
        warmup_steps: with `constant`, the steps over which the rate first rises from 0.
        cooldown: with `constant`, the share of the epochs at the end over which the rate falls to 0.
        weight_decay: strength of the pull of the weights towards 0.
        clip: largest norm of the gradient; 0 allows any.
        channels_last: memory layout of the network, faster on CPUs.
        ema: keep a moving average of the weights (EMA), of which each step leaves this share: 0.999, say,
            or 0.99 in a short training. It is what is validated and what a checkpoint gives; 0 keeps none.
        patience: end the training after so many validations in a row that were no better than the best; 0
            trains all epochs.
    """

    epochs: int = 60
    batch: int = 16
    optimizer: Literal["rmsprop", "sgd", "adam", "adamw"] = "rmsprop"
    rate: float = 2.5e-4
    schedule: Literal["constant", "one_cycle"] = "constant"
    warmup_steps: int = 0
    cooldown: float = 0.0
    weight_decay: float = 0.0
    clip: float = 0.0
    channels_last: bool = False
    ema: float = 0.0
    patience: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        if min(self.epochs, self.batch) < 1:
            raise DataError("learning.epochs and learning.batch must be at least 1")
        if not 0 < self.rate < math.inf or not 0 <= self.cooldown <= 1:  # NaN is neither above 0 nor below
            raise DataError("learning.rate must be above 0, and learning.cooldown from 0 to 1")
        amounts = self.warmup_steps, self.weight_decay, self.clip, self.patience
        if not all(0 <= amount < math.inf for amount in amounts):
            raise DataError("learning: warmup_steps, weight_decay, clip and patience must be 0 or more")
        if not 0 <= self.ema < 1:
            raise DataError(f"learning.ema must be from 0 to below 1, got {self.ema}")
        if self.schedule == "one_cycle" and (self.warmup_steps or self.cooldown):
            raise DataError(
                "learning.schedule one_cycle rises and falls by itself; leave out warmup_steps and cooldown, "
                "or choose the schedule constant"
            )


@dataclass(frozen=True)
class Machine:
    """The hardware that a training uses.

    Attributes:
        accelerator: `auto` takes a GPU when there is one.
        devices: how many GPUs, or how many processes on the CPU. More than one train together by DDP,
            with the steps of one that has all their images in its batch.
        precision: `bf16-mixed` and `16-mixed` are for GPUs; most CPUs are slower with them.
        workers: processes that load images; 0 loads them in the training process.
        threads: processor threads of torch; None leaves the number to torch.
        compile: let torch.compile make the network faster. The first step of each image size takes a minute;
            on a CPU it needs a C++ compiler.
        deterministic: only operations that give the same result every time, also on a GPU; slower. torch
            warns of those that have no such form. CPUs need no switch.
    """

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    devices: int = 1
    precision: Precision = "32-true"
    workers: int = 0
    threads: int | None = None
    compile: bool = False
    deterministic: bool = False

    def __post_init__(self) -> None:
        """Refuse what no machine has."""
        if self.devices < 1 or self.workers < 0 or (self.threads is not None and self.threads < 1):
            raise DataError("machine: devices and threads must be at least 1, workers 0 or more")


@dataclass(frozen=True)
class Run:
    """A training without its network and its data: what all three programs share.

    Attributes:
        out: folder of the checkpoints and logs.
        validate_every: epochs from one validation to the next, and after the last; 0 never validates.
        seed: of everything that is drawn at random.
        resume: go on with the run that is in `out`.
        overwrite: delete the run that is in `out` and start anew.
        until: stop after this epoch; the learning rate still follows all epochs.
    """

    out: Path
    learning: Learning
    machine: Machine
    validate_every: int = 1
    seed: int = 0
    resume: bool = False
    overwrite: bool = False
    until: int | None = None

    def __post_init__(self) -> None:
        """Refuse what contradicts itself."""
        if self.resume and self.overwrite:
            raise DataError("--resume goes on with a run and --overwrite deletes it; choose one of them")
        if min(self.seed, self.validate_every) < 0 or self.seed > HIGHEST_SEED:
            raise DataError(f"--seed and --validate_every must be 0 or more, --seed at most {HIGHEST_SEED}")
        if self.until is not None and self.until < 1:
            raise DataError("--until must be at least 1")
        if self.learning.patience and self.validate_every == 0:
            raise DataError("learning.patience counts validations; give --validate_every 1 or more")
