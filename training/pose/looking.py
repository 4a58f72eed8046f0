"""Trained networks as `rpl propose` asks them: from an image to poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rpl_data.geometry import Transform
from rpl_data.pose.estimate import PoseFailure
from rpl_data.types import ColorImage, DataError, DepthImage, Intrinsics, KeypointModel

from .pipeline import PosePipeline, load_pipeline

Look = Callable[[ColorImage, Intrinsics, DepthImage | None], Mapping[str, Transform]]


def check_detected(pipeline: PosePipeline, source: str) -> None:
    """Refuse a detector that was not trained on all objects: it would never find the others."""
    known = [] if pipeline.detector is None else pipeline.detector.names[1:]
    unknown = sorted(set(pipeline.networks) - set(known))
    if unknown:
        raise DataError(
            f"{source}: the detector does not know {', '.join(unknown)}, which a keypoint checkpoint is of; "
            f"it knows {', '.join(known)}: leave that checkpoint out, or train a detector on all objects"
        )


def load_look(keypoints: Sequence[Path], detector: Path) -> tuple[dict[str, KeypointModel], Look]:
    """The models that networks were trained with, by object, and a function from an image to poses.

    Args:
        keypoints: checkpoints of `rpl train keypoints`, one per object.
        detector: checkpoint of `rpl train detector`.

    Raises:
        DataError: a checkpoint is of another program, or the detector does not know one of the objects.
    """
    pipeline = load_pipeline(keypoints, detector)
    check_detected(pipeline, str(detector))

    def look(image: ColorImage, intrinsics: Intrinsics, depth: DepthImage | None) -> dict[str, Transform]:
        found = {seen.object: pipeline.pose(seen, intrinsics, depth=depth) for seen in pipeline.see(image)}
        return {
            name: pose.camera_from_object for name, pose in found.items() if not isinstance(pose, PoseFailure)
        }

    return {name: network.model for name, network in pipeline.networks.items()}, look
