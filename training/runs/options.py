"""What the training programs can be told, as their YAML files say it; no torch, so that help is quick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Crops = Literal["given", "detected"]
"""The labels' boxes, or the detector's."""

Architecture = Literal["small_fcos", "fcos", "ssdlite"]


@dataclass(frozen=True)
class Network:
    """The network and what goes in and out; the defaults are the paper's.

    Attributes:
        stacks, features, levels: of `StackedHourglass`.
        input_px, heatmap_px: sides; the heatmap is a quarter of the input.
        sigma_px: of the targets' Gaussians, heatmap pixels.
        loss: `squares` as the paper, or `entropy`.
    """

    stacks: int = 2
    features: int = 256
    levels: int = 4
    input_px: int = 256
    heatmap_px: int = 64
    sigma_px: float = 1.0
    loss: Literal["squares", "entropy"] = "squares"


@dataclass(frozen=True)
class DetectorNetwork:
    """The detector and what goes in.

    Attributes:
        architecture: `small_fcos` is FCOS with one map of stride 8 behind an hourglass, for CPUs; `fcos`
            has a ResNet-50 with a feature pyramid; `ssdlite` is SSDLite320 with MobileNetV3.
        width_px: of the images.
        features: channels of `small_fcos`, a multiple of 32.
    """

    architecture: Architecture = "small_fcos"
    width_px: int = 192
    features: int = 64


@dataclass(frozen=True)
class Learning:
    """How it is trained; the defaults are the paper's.

    Attributes:
        epochs: passes over the training images.
        batch: images a step.
        optimizer: `rmsprop` as the paper, or `adam`.
        rate: the learning rate; of `one_cycle` its highest.
        schedule: `constant`, or `one_cycle` (Smith and Topin 2018): up for a third, then down to nothing.
        channels_last: memory layout; faster on CPUs.
    """

    epochs: int = 60
    batch: int = 16
    optimizer: Literal["rmsprop", "adam"] = "rmsprop"
    rate: float = 2.5e-4
    schedule: Literal["constant", "one_cycle"] = "constant"
    channels_last: bool = False


@dataclass(frozen=True)
class Machine:
    """What a training runs on.

    Attributes:
        accelerator: `auto` takes a GPU when there is one.
        devices: GPUs, or processes on the CPU; more than one is trained by DDP.
        precision: `bf16-mixed` and `16-mixed` are for GPUs; most CPUs are slower with them.
        workers: processes that load images; 0 suits cached pixels.
        threads: of torch; None leaves it to torch.
    """

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    devices: int = 1
    precision: Literal["32-true", "16-mixed", "bf16-mixed"] = "32-true"
    workers: int = 0
    threads: int | None = None
