"""Several processes that train one network (DDP) take the steps of one process with all their images.

DDP averages the gradients of the processes. That is the gradient of one process with all images only where
batch normalisation sees all of them, and where a loss that is a mean is one over all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeGuard

import torch
from pytorch_lightning.plugins import LayerSync
from torch import Tensor, distributed, nn
from torch.nn.modules.batchnorm import _BatchNorm

from .network_module import NetworkModule

EMPTY_SIDE_PX = 512
"""Side of the images in a batch of none: networks halve it as often as they want."""


class SharedBatchNorm2d(nn.BatchNorm2d):
    """Batch normalisation by the mean and variance over the batches of all processes, on any device.

    torch's own SyncBatchNorm does the same on GPUs alone. A process may have an empty batch.
    """

    def forward(self, x: Tensor) -> Tensor:
        """Normalise `x` (batch x channels x rows x columns); all processes have to call it together."""
        if not self.training:
            return super().forward(x)
        exact = x.float()  # under autocast, squares of bfloat16 have three digits
        sums = [values.sum((0, 2, 3), dtype=torch.float64) for values in (exact, exact.square())]
        count = x.new_full((1,), x.numel() // x.shape[1], dtype=torch.float64)
        total: Tensor = _Summed.apply(torch.cat([*sums, count]))
        pixels = total[-1].clamp_min(1)
        mean, mean_square = (total[:-1] / pixels).chunk(2)
        variance = (mean_square - mean.square()).clamp_min(0)
        self._remember(mean.detach(), variance.detach(), float(total[-1].detach()))
        gain = self.weight * torch.rsqrt(variance + self.eps).float()
        shift = self.bias - mean.float() * gain
        return (exact * gain[:, None, None] + shift[:, None, None]).to(x.dtype)

    @torch.no_grad()
    def _remember(self, mean: Tensor, variance: Tensor, pixels: float) -> None:
        """Move the running statistics, as nn.BatchNorm2d does: by the unbiased variance."""
        if pixels == 0:
            return
        assert self.running_mean is not None and self.running_var is not None
        assert self.num_batches_tracked is not None and self.momentum is not None
        self.num_batches_tracked.add_(1)
        unbiased = variance * pixels / max(pixels - 1, 1)
        for running, now in ((self.running_mean, mean), (self.running_var, unbiased)):
            running.lerp_(now.to(running.dtype), self.momentum)


def nothing_read(module: NetworkModule) -> Tensor | None:
    """What the training step of a network with a backbone returns when no image of its batch could be read.

    One process alone skips the step. Among several, which all have to take it, the step teaches nothing:
    what normalises by all batches is run with a batch of no images, forwards and backwards.
    """
    if module.trainer.world_size == 1:
        return None
    nothing = torch.zeros(0, 3, EMPTY_SIDE_PX, EMPTY_SIDE_PX, device=module.device)
    maps: Mapping[str, Tensor] = module.compiled_part()(nothing)
    return torch.stack([values.sum() for values in (*maps.values(), *module.parameters())]).sum() * 0.0


def share_of_mean(count: Tensor) -> Tensor:
    """What makes a mean over `count` values of this process its part of the mean over those of all.

    With it, the average over the processes is the sum of all values over the count of all.
    """
    if not (distributed.is_available() and distributed.is_initialized()):
        return torch.ones_like(count)
    total = count.clone()
    distributed.all_reduce(total)
    return count.clamp_min(1) * distributed.get_world_size() / total.clamp_min(1)


class _Summed(torch.autograd.Function):
    """The sum over all processes; gradients flow back to each of them."""

    @staticmethod
    def forward(context: object, values: Tensor) -> Tensor:
        """The same sum in every process."""
        total = values.clone()
        distributed.all_reduce(total)
        return total

    @staticmethod
    def backward(context: object, gradient: Tensor) -> Tensor:
        """What each process adds changes the sums of all, so the gradients of all are added."""
        return _Summed.forward(context, gradient)


class SharedStatistics(LayerSync):
    """Lets the batch normalisation of a network's `compiled_part` see the batches of all processes.

    Only of that part, as it is the one that every process runs in every step.
    """

    def __init__(self, *, on_gpus: bool) -> None:
        """On GPUs torch's own layer is faster."""
        self._kind = nn.SyncBatchNorm if on_gpus else SharedBatchNorm2d

    def apply(self, model: nn.Module) -> nn.Module:
        """Replace the layers before DDP wraps the network; their parameters stay."""
        for parent, name, layer in _batch_norms(model, nn.BatchNorm2d):
            shared = self._kind(layer.num_features, layer.eps, layer.momentum)
            setattr(parent, name, _taken_over(shared, layer))
        return model

    def revert(self, model: nn.Module) -> nn.Module:
        """Put layers of one process back after the training."""
        for parent, name, layer in _batch_norms(model, self._kind):
            alone = nn.BatchNorm2d(layer.num_features, layer.eps, layer.momentum)
            setattr(parent, name, _taken_over(alone, layer))
        return model


def _batch_norms(model: nn.Module, kind: type[_BatchNorm]) -> list[tuple[nn.Module, str, _BatchNorm]]:
    """The layers of exactly this kind in the `compiled_part`, each with its parent and its name there."""
    part = model.compiled_part() if isinstance(model, NetworkModule) else model
    children = [(parent, *child) for parent in part.modules() for child in parent.named_children()]
    return [(parent, name, child) for parent, name, child in children if _is(child, kind)]


def _is(layer: nn.Module, kind: type[_BatchNorm]) -> TypeGuard[_BatchNorm]:
    """Whether a layer is of exactly this kind: the shared ones are kinds of the others."""
    return type(layer) is kind


def _taken_over(new: nn.Module, old: nn.Module) -> nn.Module:
    """`new` with the same parameters and running statistics of `old`."""
    for name, parameter in old.named_parameters(recurse=False):
        new.register_parameter(name, parameter)
    for name, buffer in old.named_buffers(recurse=False):
        new.register_buffer(name, buffer)
    return new.train(old.training)
