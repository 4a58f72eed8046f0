"""What is drawn lies where the label says."""

from __future__ import annotations

import numpy as np
from pycocotools import mask as coco_mask

from rpl_data.overlay import draw_overlay, instance_number, keypoint_color, tint_of
from rpl_data.types import FrameLabel, InstanceLabel, KeypointModel, Rle, SquareBox

GRAY = np.full((60, 80, 3), 100, dtype=np.uint8)
MODEL = KeypointModel("cup", ("rim", "foot", "handle"), np.zeros((3, 3)))


def label(visibility: tuple[int, int, int] = (2, 1, 0)) -> FrameLabel:
    mask = np.zeros((60, 80), dtype=np.uint8, order="F")
    mask[20:40, 30:50] = 1
    encoded = coco_mask.encode(mask)
    rle = Rle(size=[60, 80], counts=encoded["counts"].decode())
    pixels = np.array([[15.0, 10.0], [15.0, 50.0], [70.0, 50.0]])
    box = (30.0, 20.0, 50.0, 40.0)
    cup = InstanceLabel(
        "cup",
        np.eye(4),
        pixels,
        np.array(visibility),
        np.ones(3),
        SquareBox(40.0, 30.0, 30.0),
        box,
        box,
        rle,
        rle,
        1.0,
        False,
        1.0,
    )
    return FrameLabel("s", 0, 0.0, (cup,))


def test_the_picture_itself_is_left_alone() -> None:
    before = GRAY.copy()
    drawn = draw_overlay(GRAY, label(), {"cup": MODEL})
    assert drawn.shape == GRAY.shape and drawn.dtype == np.uint8
    np.testing.assert_array_equal(GRAY, before)
    assert (drawn != GRAY).any()


def test_a_frame_without_objects_is_the_picture() -> None:
    np.testing.assert_array_equal(draw_overlay(GRAY, FrameLabel("s", 0, 0.0), {}), GRAY)


def test_seen_is_filled_hidden_is_hollow_and_unlabelled_is_absent() -> None:
    drawn = draw_overlay(GRAY, label(), {"cup": MODEL})
    assert tuple(drawn[10, 15]) == keypoint_color(0, 3)
    assert tuple(drawn[50, 15]) == (100, 100, 100)  # the middle of the ring
    assert (drawn[46:55, 11:20] != 100).any()
    assert (drawn[46:55, 66:75] == 100).all()


def test_the_mask_is_tinted_inside_only() -> None:
    drawn = draw_overlay(GRAY, label((0, 0, 0)), {"cup": MODEL})
    assert (drawn[22:38, 32:48] != 100).any(axis=2).all()
    assert tuple(drawn[5, 5]) == (100, 100, 100)


def test_a_view_moves_keypoints_with_the_pixels() -> None:
    """A magnified part: pixel (15, 10) is the centre of the block that it became."""
    drawn = draw_overlay(GRAY, label(), {"cup": MODEL}, view=(10.0, 5.0, 50.0, 35.0), width_px=160)
    assert drawn.shape == (120, 160, 3)
    u, v = (15 + 0.5 - 10) * 4 - 0.5, (10 + 0.5 - 5) * 4 - 0.5
    ys, xs = np.nonzero((drawn == keypoint_color(0, 3)).all(axis=2))
    filled = (abs(xs - u) < 6) & (abs(ys - v) < 6)
    np.testing.assert_allclose([xs[filled].mean(), ys[filled].mean()], [u, v], atol=0.75)


def test_keypoint_colors_differ() -> None:
    for count in (1, 3, 6, 8, 9, 12):
        assert len({keypoint_color(k, count) for k in range(count)}) == count


def test_instances_of_an_object_differ_in_colour() -> None:
    assert [instance_number(name) for name in ("", "2", "3")] == [0, 1, 2] and instance_number("bottom") > 0
    for objects in range(1, 8):
        assert len({tint_of(0, number, objects=objects) for number in range(3)}) == 3
    assert tint_of(1, 0, objects=2) != tint_of(0, 1, objects=2), "nor is the second one like another object"
