"""Labels compared with masks that another program made: neither is the truth, but both seldom err alike."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from rpl_data.json_arrays import Json
from rpl_data.types import Rle
from rpl_data.wording import counted

APART = 0.5
"""IoU below which a label and a given mask do not show the same."""
NAMED = 10
"""Frames that a message lists."""


@dataclass
class MaskCheck:
    """IoU of the visible masks of the labels of one recording with given ones.

    Attributes:
        ious: by object, and by frame.
        missing: labels without a given mask, by object.
    """

    ious: dict[str, dict[int, float]] = field(default_factory=dict)
    missing: Counter[str] = field(default_factory=Counter)

    def add(self, name: str, frame: int, mask: Rle, given: Bool[np.ndarray, "height width"] | None) -> None:
        """Compare the label of an object in a frame; frames in which neither shows it say nothing."""
        from pycocotools import mask as coco_masks

        if given is None:
            self.missing[name] += 1
            return
        own = coco_masks.decode(mask) > 0
        together = int((own | given).sum())
        if together:
            self.ious.setdefault(name, {})[frame] = int((own & given).sum()) / together

    def lines(self, scene: str) -> list[str]:
        """What was found, for the user: a line per object, and one that names the frames that disagree."""
        found = []
        for name, by_frame in self.ious.items():
            median, count = float(np.median(list(by_frame.values()))), counted(len(by_frame), "frame")
            lacking = f"; {self.missing[name]} more have no given mask" if self.missing[name] else ""
            about = f"scene {scene}: {name}: IoU of labels with given masks is {median:.2f}"
            about += f" (median of {count}{lacking})"
            if median < APART:
                found.append(f"WARNING: {about}: one of them is wrong; look at both")
                continue
            found.append(about)
            apart = [frame for frame, iou in by_frame.items() if iou < APART]
            if apart:
                listed = ", ".join(map(str, apart[:NAMED])) + (", ..." if len(apart) > NAMED else "")
                found.append(
                    f"scene {scene}: {name}: given masks and labels of {counted(len(apart), 'frame')} "
                    f"disagree (IoU below {APART}), unlike those of the others: {listed}; look at them"
                )
        return found

    def details(self) -> Json:
        """The numbers, for the ledger."""
        return {
            name: {
                "iou_median": round(float(np.median(list(by_frame.values()))), 4),
                "frames": len(by_frame),
                "missing": self.missing[name],
                "apart": [frame for frame, iou in by_frame.items() if iou < APART],
            }
            for name, by_frame in self.ious.items()
        }
