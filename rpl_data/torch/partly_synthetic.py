"""Recorded crops of which a share is rendered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from rpl_data.synthesize.body import SAME_MODEL_M
from rpl_data.torch.keypoint_sample import KeypointSample
from rpl_data.torch.keypoints import KeypointDataset
from rpl_data.torch.splits import scenes_of
from rpl_data.torch.synthetic import SyntheticKeypoints
from rpl_data.types import DataError


class PartlySynthetic(Dataset[KeypointSample]):
    """Recorded crops of which a share, drawn anew in every epoch, is rendered instead.

    It is as long as the recorded ones, so that epochs have the steps they had.
    """

    def __init__(self, recorded: Any, synthetic: SyntheticKeypoints, share: float) -> None:
        """Join them.

        Args:
            recorded: a `KeypointDataset`.
            share: 0 to 1.

        Raises:
            DataError: the share is out of range, or the keypoints are not the same.
        """
        if not 0 <= share <= 1:
            raise DataError(f"the share of rendered crops is {share}; expected 0 to 1")
        if recorded.model.keypoints != synthetic.model.keypoints:
            raise DataError(
                f"{synthetic.model.name} was rendered with other keypoints than it is labelled with; run "
                "`rpl synthesize` again"
            )
        self._recorded, self._synthetic, self._share = recorded, synthetic, share
        self.model, self.augment = recorded.model, recorded.augment

    def __len__(self) -> int:
        """Number of recorded crops."""
        return len(self._recorded)

    def __getitem__(self, row: int) -> KeypointSample:
        """A recorded crop, or a rendered one."""
        if float(torch.rand(())) >= self._share:
            sample: KeypointSample = self._recorded[row]
            return sample
        return self._synthetic[row % len(self._synthetic)]


def partly_synthetic(
    recorded: KeypointDataset, folder: str | Path, share: float, *, canonical: bool = False
) -> PartlySynthetic:
    """Replace a share of recorded crops by crops that are rendered with the same sizes and augmentation.

    Occluders, and backgrounds from a folder, are for the recorded ones alone.

    Args:
        folder: what `rpl synthesize` wrote.
        canonical: as the recorded crops were opened.

    Raises:
        DataError: the views were rendered from a scene that is in the test split by now, or with keypoints
            elsewhere on the object, and as of `SyntheticKeypoints` and `PartlySynthetic`.
    """
    augment = recorded.augment
    if augment is not None:
        augment = replace(augment, occluders=0.0, backgrounds=None)
    synthetic = SyntheticKeypoints(
        folder,
        object=recorded.model.name,
        length=len(recorded),
        input_px=recorded.input_px,
        heatmap_px=recorded.heatmap_px,
        sigma_px=recorded.sigma_px,
        augment=augment,
        canonical=canonical,
    )
    tested = scenes_of(recorded.folder, ["test"]).intersection(synthetic.scenes)
    if tested:
        raise DataError(
            f"{folder} was rendered from scene {', '.join(sorted(tested))}, which {recorded.folder} has "
            "in its test split; run `rpl synthesize` again"
        )
    both = PartlySynthetic(recorded, synthetic, share)
    ours, theirs = recorded.model.points_object, synthetic.model.points_object
    if not np.allclose(ours, theirs, rtol=0, atol=SAME_MODEL_M, equal_nan=True):
        raise DataError(
            f"{folder} was rendered with the keypoints of {recorded.model.name} at other places than "
            f"{recorded.folder} has them: run `rpl synthesize` again after an export with other clicks; "
            "for true labels (coco_truth) there are no rendered views"
        )
    return both
