"""Labels that are too uncertain to be exported: which frames they keep out, and how that is said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from rpl_data.label.certainty import expected_error_px
from rpl_data.types import FrameLabel
from rpl_data.wording import counted

Keep = Callable[[FrameLabel], bool]
"""Whether a frame is exported."""


class QualityTally:
    """Counts of the labels that are left out for their quality.

    Attributes:
        labels, low: number of labels, and of those below the least quality, per object.
        frames, frames_left_out: number of frames, and of those with such a label.
    """

    def __init__(self) -> None:
        self.labels: Counter[str] = Counter()
        self.low: Counter[str] = Counter()
        self.frames = self.frames_left_out = 0

    def good_enough(self, least: float) -> Keep:
        """Make the test of a frame: none of its labels is below this quality.

        The whole frame is left out with such a label, since what an image shows without a label teaches a
        detector not to find it.
        """

        def keep(label: FrameLabel) -> bool:
            shown = [instance for instance in label.instances if instance.box is not None]
            low = [instance.object for instance in shown if instance.quality < least]
            self.labels.update(instance.object for instance in shown)
            self.low.update(low)
            self.frames += 1
            self.frames_left_out += bool(low)
            return not low

        return keep

    def messages(self, least: float) -> list[str]:
        """Say how many were left out; nothing when none was."""
        if not self.frames_left_out:
            return []
        objects = ", ".join(f"{name} {count} of {self.labels[name]}" for name, count in self.low.items())
        return [
            f"{self.frames_left_out} of {counted(self.frames, 'frame')} are left out of the export: they "
            f"hold labels of a quality below {least:g}, an expected error of more than "
            f"{expected_error_px(least):.0f} px ({objects}); `export: {{min_quality: 0}}` keeps them"
        ]
