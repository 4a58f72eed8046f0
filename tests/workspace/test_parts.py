"""Clicks of instances and of moved objects, in recordings that are cut or not."""

from __future__ import annotations

import pytest

from rpl_data.types import Click
from rpl_data.types.instances import frame_of, instance_of, placed_as, scene_of
from rpl_data.workspace.parts import Parts

PARTS = Parts({"cut": ((0, 4), (5, 9))}, frozenset({"moved"}))


@pytest.mark.parametrize(
    ("in_video", "in_scene"),
    [
        ("whole", "whole"),
        ("whole/2", "whole/2"),
        ("cut", "cut.2"),
        ("cut/2", "cut.2/2"),
        ("moved", "moved/@7"),
        ("moved/2", "moved/2@7"),
    ],
)
def test_a_click_is_in_its_part_and_comes_back(in_video: str, in_scene: str) -> None:
    click = Click("cube", 0, in_video, 7, 1.0, 2.0)
    found = PARTS.click_in_scene(click)
    assert found.scene == in_scene and PARTS.click_in_scene(found) == found
    assert PARTS.click_in_video(found) == click and PARTS.video_of(in_scene) == scene_of(in_video)
    event = {"op": "click", "keypoint": 0, "scene": in_video, "frame": 7}
    assert PARTS.event_in_scene(event)["scene"] == in_scene
    assert PARTS.event_in_video(PARTS.event_in_scene(event)) == event


def test_a_place_is_taken_apart() -> None:
    assert placed_as("00") == "00" and placed_as("00", "2") == "00/2"
    assert (scene_of("00/2@7"), instance_of("00/2@7"), frame_of("00/2@7")) == ("00", "2@7", 7)
    assert (scene_of("00"), instance_of("00"), frame_of("00")) == ("00", "", None)
