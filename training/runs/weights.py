"""Weights that a training starts from: torchvision's, a file's, or those of an earlier training of ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import URLError

from torch import Tensor, nn
from torchvision.models import get_model_weights

from rpl_data.types import DataError

from .folder import read_checkpoint, reading_checkpoint

SCRATCH, IMAGENET = "scratch", "imagenet"
"""Values of `weights` that name no file: random weights, and those that torchvision trained on ImageNet."""


@dataclass(frozen=True)
class Start:
    """What of a network can be given weights.

    Attributes:
        network: the network.
        name: what its body is called: torchvision's name where it is one of torchvision's.
        body: where the body lies in the network: "backbone.body.", say. All of it must be in the weights; of
            the rest, what has the right shape is taken. Empty where the network has no body of torchvision's.
        must: where to find what must be in the weights; the body when empty.
        prefix: what our checkpoints put before the names of this network's tensors.
    """

    network: nn.Module
    name: str
    body: str
    must: tuple[str, ...] = ()
    prefix: str = ""


def start_from(start: Start, weights: str) -> str:
    """Put trained weights into a network; a line comes back that says what came from where.

    Args:
        start: the network.
        weights: `scratch`; `imagenet`, which torchvision fetches; or the path of a file with the body alone,
            a whole network of torchvision's, or one of our checkpoints. What depends on the number of classes
            or keypoints stays random where theirs is another one.

    Raises:
        DataError: nothing can be fetched, or the file does not hold this network.
    """
    if weights == SCRATCH:
        return f"{start.name} from scratch"
    state = _fetched(start) if weights == IMAGENET else _read(Path(weights), start.prefix)
    must = start.must or (start.body,)
    if start.body and not any(key.startswith(must) for key in state):  # the body alone
        state = {start.body + key: value for key, value in state.items()}
    wanted = start.network.state_dict()
    fitting = {key: value for key, value in state.items() if _fits(wanted.get(key), value)}
    needed = {key for key in wanted if not key.endswith("num_batches_tracked")}
    body = {key for key in needed if key.startswith(must)}
    if missing := sorted(body - set(fitting)):
        raise DataError(
            f"{weights} does not hold the network {start.name}: {len(missing)} of its {len(body)} tensors "
            f"are missing or of another shape ({missing[0]}); choose the network the weights belong to"
        )
    start.network.load_state_dict(fitting, strict=False)
    return f"{weights}: {len(fitting)} tensors taken, {len(needed - set(fitting))} stay random"


def _fits(wanted: Tensor | None, value: Any) -> bool:
    return wanted is not None and isinstance(value, Tensor) and wanted.shape == value.shape


def _fetched(start: Start) -> Mapping[str, Tensor]:
    if not start.body:
        raise DataError(
            f"there are no ImageNet weights of the network {start.name}; give the path of a checkpoint as "
            "`weights`, or `scratch`, or choose a network with a body of torchvision's"
        )
    try:
        state: Mapping[str, Tensor] = get_model_weights(start.name).DEFAULT.get_state_dict(check_hash=True)
    except (URLError, OSError, RuntimeError) as error:  # no network, a proxy's answer, a damaged file
        raise DataError(
            f"cannot fetch torchvision's weights of {start.name}: {error}; give the path of a file as "
            "`weights`, or `scratch`"
        ) from error
    return state


def _read(path: Path, prefix: str) -> Mapping[str, Tensor]:
    """Read the state dict of a file. Our own checkpoints hold it one level down, with a prefix."""
    content = read_checkpoint(path)
    with reading_checkpoint(path, "weights"):
        state = content.get("state_dict", content)
        return {key.removeprefix(prefix): value for key, value in state.items()}
