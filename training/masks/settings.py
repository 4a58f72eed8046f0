"""The options of a Mask R-CNN training, as configs/masks_*.yaml hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError

from ..runs.old_names import with_new_names
from ..runs.options import Learning, Machine, MaskNetwork

SCORE_THRESHOLD = 0.5
"""Least score of an object that counts as found, and is drawn."""

LEARNING = Learning(
    epochs=40,
    batch=2,
    optimizer="sgd",
    rate=1e-3,
    warmup_steps=500,
    cooldown=0.25,
    weight_decay=1e-4,
    clip=5.0,
)
AUGMENT = Augmentation(shift=0.0, rotation_deg=10.0)
MACHINE = Machine(workers=2)

_LEARNING_NAMES = ["epochs", "batch", "optimizer", "rate", "weight_decay", "warmup_steps", "cooldown", "clip"]
OLD_NAMES = {
    "settings.model": "network",
    "settings.augmentation": "augment",
    **{f"settings.{name}": f"learning.{name}" for name in _LEARNING_NAMES},
    **{f"settings.{name}": f"machine.{name}" for name in ("workers", "precision", "accelerator")},
    **{f"settings.{name}": name for name in ("weights", "head_epochs", "seed")},
    "data": "coco",
    "threads": "machine.threads",
}
"""The names of version 0.1, and what has taken their place."""


@dataclass(frozen=True)
class MaskSettings:
    """A Mask R-CNN training without its data and its folder. The defaults are the paper's.

    Attributes:
        network: the network.
        learning: how long and how fast it is trained.
        augment: how far training crops may stray.
        machine: the hardware.
        weights: `scratch`, `imagenet`, or the path of trained weights.
        head_epochs: how many epochs, from the first one, the ResNet is frozen.
        validate_every: epochs from one validation to the next.
        seed: of everything that is drawn at random.
    """

    network: MaskNetwork = MaskNetwork()
    learning: Learning = LEARNING
    augment: Augmentation = AUGMENT
    machine: Machine = MACHINE
    weights: str = "imagenet"
    head_epochs: int = 20
    validate_every: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        if not 0 <= self.head_epochs <= self.learning.epochs:
            raise DataError("head_epochs must be from 0 to learning.epochs")


def load_settings(path: Path) -> MaskSettings:
    """The settings of a YAML file such as configs/masks_cpu.yaml.

    Raises:
        DataError: the file is missing, or holds something else.
    """
    from jsonargparse import ArgumentError, ArgumentParser

    if not path.is_file():
        raise DataError(f"{path} does not exist; expected settings such as those of `--preset masks_cpu`")
    parser = ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(MaskSettings, "settings")
    try:
        values = with_new_names(path, OLD_NAMES)
        parsed = parser.parse_object({"settings": values})
        settings: MaskSettings = parser.instantiate(parsed).settings
    except (ArgumentError, TypeError, KeyError) as error:
        raise DataError(f"{path}: {error}") from error
    return settings


def comparable(settings: MaskSettings) -> dict[str, Any]:
    """What must not change when an experiment goes on; how long and on what hardware it runs may."""
    free: Sequence[str] = ("machine", "validate_every")
    kept = {key: value for key, value in asdict(settings).items() if key not in free}
    kept["learning"] = {key: value for key, value in kept["learning"].items() if key != "epochs"}
    return kept
