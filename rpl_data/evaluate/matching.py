"""Bring a truth into the order of the model that is compared with it: keypoints are matched by name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from rpl_data.types import FrameLabel, InstanceLabel, KeypointModel
from rpl_data.types.keypoint_names import rows_by_name


def rows_in_truth(model: KeypointModel, truth: KeypointModel) -> list[int]:
    """Row of each of the model's keypoints in its truth; DataError where they have other names."""
    return rows_by_name(model.keypoints, truth.keypoints, what=f"object {model.name} and its truth")


def in_order_of_model(
    labels: Iterable[FrameLabel], rows: Mapping[str, Sequence[int]]
) -> Iterator[FrameLabel]:
    """True labels with the keypoints in the order of the models; `rows` as `rows_in_truth`, by object."""
    for label in labels:
        instances = (
            _reordered(one, rows[one.object]) if one.object in rows else one for one in label.instances
        )
        yield replace(label, instances=tuple(instances))


def _reordered(instance: InstanceLabel, rows: Sequence[int]) -> InstanceLabel:
    order = list(rows)
    return replace(
        instance,
        keypoints_px=instance.keypoints_px[order],
        visibility=instance.visibility[order],
        sigma_px=instance.sigma_px[order],
    )
