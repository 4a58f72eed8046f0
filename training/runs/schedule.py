"""The optimizer, and the learning rate of every step as a function of the step alone.

A schedule without a memory of its own lets a resumed training take another number of epochs.
"""

from __future__ import annotations

import math

import torch
from torch import nn

from .options import Learning

RISING_SHARE = 0.3
"""Share of the steps of `one_cycle` during which the rate rises."""

FIRST_SHARE, LAST_SHARE = 1 / 25, 1 / 25e4
"""Rate of the first and of the last step of `one_cycle`, as shares of the highest one."""

MOMENTA = 0.85, 0.95
"""Momentum of `one_cycle` where the rate is highest and where it is lowest."""


def optimizer_of(network: nn.Module, learning: Learning, *, fused: bool) -> torch.optim.Optimizer:
    """The optimizer of all parameters; the frozen ones have no gradient and are left alone.

    Args:
        network: the network.
        learning: names the optimizer.
        fused: take adamw's faster implementation. With mixed precision it refuses clipped gradients.
    """
    parameters, rate, decay = network.parameters(), learning.rate, learning.weight_decay
    match learning.optimizer:
        case "adam":
            return torch.optim.Adam(parameters, lr=rate, weight_decay=decay)
        case "adamw":
            return torch.optim.AdamW(parameters, lr=rate, weight_decay=decay, fused=fused)
        case "sgd":
            return torch.optim.SGD(parameters, lr=rate, momentum=0.9, weight_decay=decay, nesterov=True)
        case "rmsprop":
            return torch.optim.RMSprop(parameters, lr=rate, weight_decay=decay)


def set_step(optimizer: torch.optim.Optimizer, learning: Learning, step: int, steps_per_epoch: int) -> float:
    """Give the optimizer the learning rate (and momentum) of a step; the rate comes back."""
    rate = learning_rate(learning, step, steps_per_epoch)
    for group in optimizer.param_groups:
        group["lr"] = rate
        if learning.schedule == "one_cycle":
            momentum = one_cycle_momentum(step, learning.epochs * steps_per_epoch)
            if "betas" in group:
                group["betas"] = (momentum, group["betas"][1])
            else:
                group["momentum"] = momentum
    return rate


def learning_rate(learning: Learning, step: int, steps_per_epoch: int) -> float:
    """The rate of a step, counted from 0 over all epochs."""
    steps = learning.epochs * steps_per_epoch
    if learning.schedule == "one_cycle":
        return learning.rate * _one_cycle(step, steps, FIRST_SHARE, 1.0, LAST_SHARE)
    rise = min(1.0, (step + 1) / learning.warmup_steps) if learning.warmup_steps else 1.0
    fall = min(1.0, (1 - step / steps) / learning.cooldown) if learning.cooldown else 1.0
    return learning.rate * rise * max(fall, 0.0)


def one_cycle_momentum(step: int, steps: int) -> float:
    """The momentum of a step of `one_cycle`: low where the rate is high."""
    low, high = MOMENTA
    return _one_cycle(step, steps, high, low, high)


def _one_cycle(step: int, steps: int, first: float, middle: float, last: float) -> float:
    """From `first` to `middle` to `last` along two halves of a cosine, as torch's OneCycleLR has it."""
    turn = RISING_SHARE * steps - 1
    if step <= turn:
        return _cosine(first, middle, step / turn if turn else 1.0)
    return _cosine(middle, last, (step - turn) / (steps - 1 - turn))


def _cosine(start: float, end: float, share: float) -> float:
    return end + (start - end) / 2 * (1 + math.cos(math.pi * share))
