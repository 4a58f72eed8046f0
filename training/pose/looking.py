"""Trained networks as `rpl propose` asks them: from an image to poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rpl_data.geometry import Transform
from rpl_data.pose.estimate import PoseFailure
from rpl_data.types import ColorImage, DepthImage, Intrinsics, KeypointModel

from .pipeline import load_pipeline

Look = Callable[[ColorImage, Intrinsics, DepthImage | None], Mapping[str, Transform]]


def load_look(keypoints: Sequence[Path], detector: Path) -> tuple[dict[str, KeypointModel], Look]:
    """The models that networks were trained with, by object, and a function from an image to poses.

    Args:
        keypoints: checkpoints of `rpl train keypoints`, one per object.
        detector: checkpoint of `rpl train detector`.

    Raises:
        DataError: a checkpoint is of another program, or the detector does not know one of the objects.
    """
    pipeline = load_pipeline(keypoints, detector)

    def look(image: ColorImage, intrinsics: Intrinsics, depth: DepthImage | None) -> dict[str, Transform]:
        found = {seen.object: pipeline.pose(seen, intrinsics, depth=depth) for seen in pipeline.see(image)}
        return {
            name: pose.camera_from_object for name, pose in found.items() if not isinstance(pose, PoseFailure)
        }

    return {name: network.model for name, network in pipeline.networks.items()}, look
