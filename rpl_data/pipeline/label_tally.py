"""What the labels of a recording amount to, counted while they are written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from rpl_data.json_arrays import Json
from rpl_data.label.mask_check import MaskCheck
from rpl_data.pipeline.given_masks import ObjectMasks
from rpl_data.pipeline.ledger import Advance
from rpl_data.types import FrameLabel, InstanceLabel, Scene
from rpl_data.wording import counted


@dataclass
class LabelTally:
    """Counts of the labels of one recording.

    Attributes:
        names: of the objects that are labelled in it.
        alone: those with one instance there: which of several a given mask is of is not known.
        given: masks that another program made of it; None where there are none.
        instances: labels per object.
        moved_px: by how much single labels were corrected in their frames, per object.
        check: how the labels agree with the given masks.
    """

    scene: Scene
    names: Sequence[str]
    alone: Collection[str]
    given: ObjectMasks | None
    instances: Counter[str] = field(default_factory=Counter)
    moved_px: dict[str, list[float]] = field(default_factory=dict)
    check: MaskCheck = field(default_factory=MaskCheck)

    def counting(self, labels: Iterable[FrameLabel], total: int, advance: Advance) -> Iterator[FrameLabel]:
        """Pass labels on, and count them.

        Args:
            total: how many there will be.
        """
        for done, label in enumerate(labels, start=1):
            advance(done, total)
            for instance in label.instances:
                self._add(label.frame, instance)
            yield label

    def _add(self, frame: int, instance: InstanceLabel) -> None:
        self.instances[instance.object] += 1
        if instance.corrected_px is not None:
            self.moved_px.setdefault(instance.object, []).append(instance.corrected_px)
        if self.given is not None and instance.object in self.given.keys and instance.object in self.alone:
            mask = self.given.mask(instance.object, frame, self.scene)
            self.check.add(instance.object, frame, instance.mask, mask)

    def lines(self, video: str, *, path: str) -> list[str]:
        """What is to be said of the given masks and of the corrections.

        Args:
            path: what labels keep to that are not corrected, in words.
        """
        given = self.given
        notes = [] if given is None else [f"scene {video}: {line}" for line in given.notes]
        notes += [
            f"scene {video}: it shows several {name}, so given masks neither check them nor vote on "
            "their shape: which instance a mask is of is not known"
            for name in self.names
            if given is not None and name in given.keys and name not in self.alone
        ]
        corrected = [
            corrected_line(video, item, moved_px, self.instances[item], path)
            for item, moved_px in sorted(self.moved_px.items())
        ]
        return [*notes, *self.check.lines(video), *corrected]

    def details(self, *, posed: int) -> Json:
        """The numbers, for the ledger.

        Args:
            posed: how many frames have a pose.
        """
        return {
            "instances": {item: self.instances[item] for item in self.names},
            "posed": posed,
            "corrected": {item: len(found) for item, found in self.moved_px.items()},
            **({} if self.given is None else {"given_masks": self.check.details()}),
        }


def corrected_line(video: str, item: str, moved_px: Sequence[float], labels: int, path: str) -> str:
    """Says how many labels of an object were corrected in their frames, and by how much."""
    by = f"{np.median(moved_px):.1f} px"
    if len(moved_px) > 1:
        by += f" (median), {max(moved_px):.1f} px at most"
    others = f"; the other labels keep to {path}" if len(moved_px) < labels else ""
    return (
        f"scene {video}: {item} is corrected in {len(moved_px)} of {counted(labels, 'frame')} by what is "
        f"printed on it, by {by}{others}"
    )
