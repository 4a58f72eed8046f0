"""Frames that are left out of exports for their labels' quality."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scenes import BOX, CAN, instance

from rpl_data.label.certainty import expected_error_px, quality
from rpl_data.pipeline.good_enough import QualityTally
from rpl_data.types import FrameLabel


def frame(number: int, **qualities: float) -> FrameLabel:
    models = {"box": BOX, "can": CAN}
    instances = [replace(instance(models[name], 0.0), quality=value) for name, value in qualities.items()]
    return FrameLabel("00", number, number / 30, tuple(instances))


def test_frames_with_a_bad_label_are_left_out_and_counted() -> None:
    tally = QualityTally()
    keep = tally.good_enough(0.25)
    frames = [frame(0, box=0.8, can=0.2), frame(1, box=0.25), frame(2, can=0.1), frame(3)]
    assert [label.frame for label in frames if keep(label)] == [1, 3]
    (line,) = tally.messages(0.25)
    assert line.startswith("2 of 4 frames are left out of the export")
    assert "more than 15 px (can 2 of 2)" in line


def test_what_cannot_be_seen_keeps_no_frame_out() -> None:
    tally = QualityTally()
    hidden = replace(instance(BOX, 0.0, visible=False), quality=0.0)
    assert tally.good_enough(0.25)(FrameLabel("00", 0, 0.0, (hidden,)))
    assert tally.messages(0.25) == []


@pytest.mark.parametrize("error_px", [0.5, 5.0, 15.0])
def test_the_expected_error_can_be_read_from_a_quality(error_px: float) -> None:
    assert expected_error_px(quality(np.full(4, error_px / 1.25))) == pytest.approx(error_px)
    assert expected_error_px(0.0) == np.inf
