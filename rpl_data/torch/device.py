"""The accelerator of this machine, and what devices can do."""

from __future__ import annotations

import torch


def accelerator() -> str | None:
    """Name of the accelerator that a training would use; None where there is only the CPU."""
    if torch.cuda.is_available():
        return f"{torch.cuda.get_device_name()}, CUDA {torch.version.cuda}"
    return "Apple GPU, by MPS" if torch.backends.mps.is_available() else None


def widest_float(device: torch.device) -> torch.dtype:
    """The widest floating-point type that a device has: float64, on Apple's MPS float32."""
    return torch.float32 if device.type == "mps" else torch.float64
