"""What is compared with what: keypoints are matched by name, instances of an object by where they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from rpl_data.types import FrameLabel, InstanceLabel, KeypointModel
from rpl_data.types.keypoint_names import rows_by_name

FAR_PX = 1e6
"""Farther apart than any two things in an image."""


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


def matched_instances(
    labels: Sequence[InstanceLabel], truth: Sequence[InstanceLabel]
) -> list[tuple[InstanceLabel, InstanceLabel]]:
    """Pairs of a label and its truth in one frame: as many as there can be, their keypoints near together.

    What instances are called says nothing: the truth may number them otherwise.
    """
    if len(labels) == 1 and len(truth) == 1:
        return [(labels[0], truth[0])]
    apart_px = np.array([[_apart_px(one, true) for true in truth] for one in labels])
    rows, columns = linear_sum_assignment(apart_px.reshape(len(labels), len(truth)))
    return [(labels[row], truth[column]) for row, column in zip(rows, columns, strict=True)]


def _apart_px(label: InstanceLabel, truth: InstanceLabel) -> float:
    """Mean distance of the keypoints, wherever they project; far where none does."""
    distance_px = np.linalg.norm(label.keypoints_px - truth.keypoints_px, axis=1)
    finite = distance_px[np.isfinite(distance_px)]
    return float(finite.mean()) if len(finite) else FAR_PX


def _reordered(instance: InstanceLabel, rows: Sequence[int]) -> InstanceLabel:
    order = list(rows)
    return replace(
        instance,
        keypoints_px=instance.keypoints_px[order],
        visibility=instance.visibility[order],
        sigma_px=instance.sigma_px[order],
    )
