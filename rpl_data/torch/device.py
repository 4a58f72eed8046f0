"""The accelerator of this machine."""

from __future__ import annotations

import torch


def accelerator() -> str | None:
    """Name of the accelerator that a training would use; None where there is only the CPU."""
    if torch.cuda.is_available():
        return f"{torch.cuda.get_device_name()}, CUDA {torch.version.cuda}"
    return "Apple GPU, by MPS" if torch.backends.mps.is_available() else None
