"""Checkpoints that are written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from pytorch_lightning.plugins.io import TorchCheckpointIO

from rpl_data.files import writing

from .folder import BEST, LAST


class WholeCheckpoints(TorchCheckpointIO):
    """Writes a checkpoint beside its final place and renames it.

    Lightning's own writer goes by way of the system's temporary folder: where that is another disk, its last
    step is a copy, and a training killed during it leaves half a checkpoint and none from before.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint completely, or leave the one from before."""
        with writing(Path(path), "wb") as file:
            torch.save(checkpoint, file)


def sweep_checkpoints(out: Path) -> None:
    """Remove what trainings that were killed left half-written in the folder of their run."""
    for path in (found for name in (BEST, LAST) for found in out.glob(f".{name}.*")):
        path.unlink(missing_ok=True)
