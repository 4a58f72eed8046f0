"""The keypoint networks by the names of their options, and the weights they can start from."""

from __future__ import annotations

from torch import nn

from rpl_data.types import DataError

from ..runs.options import Network
from ..runs.weights import Start
from .hourglass import StackedHourglass
from .pyramid import COARSEST, HeatmapPyramid


def network_of(keypoints: int, options: Network) -> nn.Module:
    """Build a network with random weights, for so many keypoints.

    Raises:
        DataError: the sizes do not go with one another.
    """
    if options.input_px != StackedHourglass.shrink * options.heatmap_px:
        raise DataError(
            f"heatmaps of {options.heatmap_px} px do not go with an input of {options.input_px} px: the "
            f"{options.architecture} makes them a quarter as wide"
        )
    if options.architecture != "hourglass":
        if options.input_px % COARSEST:
            raise DataError(
                f"an input of {options.input_px} px does not go with a {options.architecture}, which halves "
                f"it five times; choose a multiple of {COARSEST}"
            )
        return HeatmapPyramid(keypoints, options.architecture, features=options.features)
    if options.heatmap_px % 2**options.levels:
        raise DataError(
            f"an hourglass of {options.levels} levels halves heatmaps that often; "
            f"{options.heatmap_px} px is no multiple of {2**options.levels}"
        )
    sizes = {"stacks": options.stacks, "features": options.features, "levels": options.levels}
    return StackedHourglass(keypoints, **sizes)


def start_of(network: nn.Module, options: Network) -> Start:
    """What of the network can be given weights: heads stay random where other keypoints were trained."""
    if options.architecture == "hourglass":
        must = ("stem.", "hourglasses.", "necks.")
        return Start(network, "hourglass", body="", must=must, prefix="network.")
    return Start(network, options.architecture, body="body.", prefix="network.")
