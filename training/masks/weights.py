"""Weights of a Mask R-CNN: those that training starts from, and those in its checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.error import URLError

from torch import Tensor, nn
from torchvision.models import get_model_weights
from torchvision.models.detection import MaskRCNN

from rpl_data.types import DataError

from ..runs.folder import read_checkpoint, reading_checkpoint
from ..runs.options import MaskNetwork
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
    if weights == "scratch":
        return f"{config.backbone} from scratch, {config.norm} norm"
    state = _fetched(config.backbone) if weights == "imagenet" else _read(Path(weights))
    resnet_only = "layer1.0.conv1.weight" in state
    target: nn.Module = model.backbone.body if resnet_only else model
    wanted = target.state_dict()
    fitting = {key: value for key, value in state.items() if _fits(wanted.get(key), value)}
    needed = {key for key in wanted if not key.endswith("num_batches_tracked")}
    body = {key for key in needed if resnet_only or key.startswith("backbone.body.")}
    if missing := sorted(body - set(fitting)):
        raise DataError(
            f"{weights} does not hold a {config.backbone}: {len(missing)} of its {len(body)} tensors are "
            f"missing or of another shape ({missing[0]}); choose the backbone the weights belong to"
        )
    target.load_state_dict(fitting, strict=False)
    left = len(needed - set(fitting))
    return f"{weights}: {len(fitting)} tensors taken, {left} stay random, {config.norm} norm"


def _fits(wanted: Tensor | None, value: Any) -> bool:
    return wanted is not None and isinstance(value, Tensor) and wanted.shape == value.shape


def _fetched(backbone: str) -> Mapping[str, Tensor]:
    try:
        state: Mapping[str, Tensor] = get_model_weights(backbone).DEFAULT.get_state_dict(check_hash=True)
    except (URLError, OSError) as error:
        raise DataError(
            f"cannot fetch torchvision's weights of {backbone}: {error}; give the path of a file as "
            "`weights`, or `scratch`"
        ) from error
    return state


def _read(path: Path) -> Mapping[str, Tensor]:
    """Read the state dict of a file. Our own checkpoints hold it one level down, with a prefix."""
    content = read_checkpoint(path)
    with reading_checkpoint(path, "weights"):
        state = content.get("state_dict", content)
        return {key.removeprefix("model."): value for key, value in state.items()}


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
