"""The DataModule in somebody's own Lightning training: resumed, it goes on with the images of its epoch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytorch_lightning as lightning
import torch
from labelled_scenes import exported

from rpl_data.torch import Augmentation, KeypointDataModule


class Seen(lightning.LightningModule):
    """Learns nothing; remembers what it was shown, by epoch."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))
        self.batches: list[tuple[int, float]] = []

    def training_step(self, batch: Any, _: int) -> torch.Tensor:
        self.batches.append((self.current_epoch, float(batch[0]["image"].sum())))
        return self.weight.sum()

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), 0.1)


def _seen(coco: Path, epochs: int, *, after: Path | None = None, save: Path | None = None) -> list[Any]:
    data = KeypointDataModule(
        coco, object="box", input_px=32, heatmap_px=8, batch=2, augment=Augmentation(), workers=1
    )
    quiet = dict.fromkeys(
        ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False
    )
    trainer = lightning.Trainer(max_epochs=epochs, accelerator="cpu", **quiet)
    module = Seen()
    trainer.fit(module, data, ckpt_path=after, weights_only=True)
    if save is not None:
        trainer.save_checkpoint(save)
    return module.batches


def test_a_resumed_training_sees_what_an_uninterrupted_one_sees(tmp_path: Path) -> None:
    coco, checkpoint = exported(tmp_path), tmp_path / "two.ckpt"
    straight = _seen(coco, 3)
    _seen(coco, 2, save=checkpoint)
    last = [batch for batch in straight if batch[0] == 2]
    assert _seen(coco, 3, after=checkpoint) == last and len(last) == 3
