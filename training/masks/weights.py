"""Weights of a Mask R-CNN: those that training starts from, and those in its checkpoints."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torchvision.models.detection import MaskRCNN

from rpl_data.types import DataError

from ..runs.folder import read_checkpoint, reading_checkpoint
from ..runs.options import MaskNetwork
from ..runs.weights import Start, start_from
from .mask_rcnn import build_model


def load_weights(model: MaskRCNN, config: MaskNetwork, weights: str) -> str:
    """Put trained weights into the network; a line comes back that says what came from where.

    Args:
        model: the network.
        config: its options, with the norm decided.
        weights: `scratch`; `imagenet`, which torchvision fetches; or the path of a file with a ResNet, a
            torchvision Mask R-CNN (layers that depend on its classes stay random where ours differ) or one of
            our checkpoints.

    Raises:
        DataError: nothing can be fetched, or the file does not hold this network.
    """
    start = Start(model, config.backbone, body="backbone.body.", prefix="model.")
    return f"{start_from(start, weights)}, {config.norm} norm"


@dataclass(frozen=True)
class Segmenter:
    """A trained network, its options, and the names of its labels; `names[0]` is the background."""

    model: MaskRCNN
    network: MaskNetwork
    names: tuple[str, ...]


def description(config: MaskNetwork, names: tuple[str, ...]) -> dict[str, Any]:
    """Describe a network in plain values, for its checkpoint."""
    return {"model": asdict(config), "names": list(names)}


def load_segmenter(checkpoint: Path) -> Segmenter:
    """Load the network of a checkpoint of `rpl train masks`, ready to predict."""
    content = read_checkpoint(checkpoint)
    if "masks" not in content:
        raise DataError(f"{checkpoint} is not a checkpoint of `rpl train masks`")
    with reading_checkpoint(checkpoint, "a checkpoint of `rpl train masks`"):
        config, names = MaskNetwork(**content["masks"]["model"]), tuple(content["masks"]["names"])
        model = build_model(config, len(names) - 1)
        state = content["state_dict"]
        model.load_state_dict({key.removeprefix("model."): value for key, value in state.items()})
    return Segmenter(model.eval(), config, names)
