"""Settings of a Mask R-CNN training: what configs/masks_*.yaml hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError
from training.masks.mask_rcnn import ModelConfig


@dataclass(frozen=True)
class Settings:
    """A training run; the defaults are the paper's, as in configs/masks_paper.yaml.

    Attributes:
        weights: `scratch`, `imagenet`, or the path of trained weights.
        epochs: passes over the images, the first `head_epochs` of them with the ResNet frozen.
        batch: images a step.
        optimizer: `sgd` with momentum 0.9, or `adamw`.
        rate: learning rate; reached after `warmup_steps`, and falling linearly to 0 over the last `cooldown`
            of the epochs.
        clip: largest norm of the gradient; 0 = any.
        workers: processes that load images; 0 = none but this.
        precision: Lightning's: 32-true, bf16-mixed, 16-mixed.
        accelerator: Lightning's: auto, cpu, gpu.
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(shift=0.0, rotation_deg=10.0))
    weights: str = "imagenet"
    epochs: int = 40
    head_epochs: int = 20
    batch: int = 2
    optimizer: Literal["sgd", "adamw"] = "sgd"
    rate: float = 1e-3
    weight_decay: float = 1e-4
    warmup_steps: int = 500
    cooldown: float = 0.25
    clip: float = 5.0
    seed: int = 0
    workers: int = 2
    precision: Literal["32-true", "bf16-mixed", "16-mixed"] = "32-true"
    accelerator: Literal["auto", "cpu", "gpu"] = "auto"

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        if min(self.epochs, self.batch) < 1 or not 0 <= self.head_epochs <= self.epochs:
            raise DataError("expected epochs and batch of at least 1, and 0 <= head_epochs <= epochs")
        if not 0 <= self.cooldown <= 1 or self.rate <= 0:
            raise DataError("expected a cooldown of 0 to 1 and a rate above 0")


def load_settings(path: Path) -> Settings:
    """The settings of a YAML file such as configs/masks_cpu.yaml; DataError when it does not hold them."""
    from jsonargparse import ArgumentError, ArgumentParser

    if not path.is_file():
        raise DataError(f"{path} does not exist; expected settings such as training/configs/masks_cpu.yaml")
    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--settings", type=Settings)
    try:
        settings: Settings = parser.instantiate(parser.parse_path(path)).settings
    except (ArgumentError, TypeError, KeyError) as error:
        raise DataError(f"{path}: {error}") from error
    return settings


def learning_rate(settings: Settings, step: int, steps_an_epoch: int) -> float:
    """Of a step: rising, constant, falling."""
    rise = min(1.0, (step + 1) / settings.warmup_steps) if settings.warmup_steps else 1.0
    left = 1 - step / (settings.epochs * steps_an_epoch)
    fall = min(1.0, left / settings.cooldown) if settings.cooldown else 1.0
    return settings.rate * rise * max(fall, 0.0)


def comparable(settings: Settings) -> dict[str, Any]:
    """What must not change when a run is resumed; where and how long it runs may."""
    free = ("epochs", "workers", "accelerator")
    return {key: value for key, value in asdict(settings).items() if key not in free}
