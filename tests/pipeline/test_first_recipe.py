"""The text of a first recipe: what is certain is mended, what is not stands there as a comment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from recordings import CAMERA

from rpl_data.doctor.findings import Diagnosis, Finding
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.pipeline.first_recipe import HowStored, keypoints_from, path_from, recipe_text
from rpl_data.pipeline.recipe_file import parse_recipe
from rpl_data.pipeline.stages.import_ import _certain_faults
from rpl_data.recordings.mend import Mend
from rpl_data.types import Frame, Recording, Scene

SCENE = Scene("00", CAMERA, 0.001, ())


def examined(name: str, *findings: Finding) -> tuple[Recording, Diagnosis]:
    return Recording(replace(SCENE, name=name), None), Diagnosis(name, (), findings)


def lag(frames: int, sure: float = 1.0) -> Finding:
    return Finding("pose lag", f"poses are {frames} late", sure, "do it", Mend(pose_lag=frames))


def test_scenes_with_other_faults_are_sources_of_their_own() -> None:
    repeats = Finding("repeated frames", "twice the same", 1.0, "do it", Mend(no_repeats=True))
    found = [examined("00", lag(2), repeats), examined("01"), examined("02", lag(2), repeats)]
    text = recipe_text("data", HowStored("tum"), found, name="n", objects=[("mug", 4)], clicks=None)
    recipe = parse_recipe(yaml.safe_load(text), source="text")
    assert [source.names for source in recipe.scenes] == [("00", "02"), ("01",)]
    assert [source.mend for source in recipe.scenes] == [Mend(pose_lag=2, no_repeats=True), Mend()]
    assert {(str(source.path), source.format) for source in recipe.scenes} == {("data", "tum")}


def test_what_is_not_sure_is_a_comment() -> None:
    text = recipe_text(
        "data", HowStored("tum"), [examined("00", lag(3, 0.5))], name="n", objects=[("m", 4)], clicks=None
    )
    assert parse_recipe(yaml.safe_load(text), source="text").scenes[0].mend == Mend()
    assert "# scene 00: poses are 3 late; do it" in text


def test_a_mend_that_is_right_at_one_distance_only_keeps_its_remark() -> None:
    beside = Finding("registration", "depth lies beside colour", 1.0, "record again", Mend(depth_zoom=0.9))
    text = recipe_text(
        "data", HowStored("frames"), [examined("00", beside)], name="n", objects=[("m", 4)], clicks=None
    )
    assert parse_recipe(yaml.safe_load(text), source="text").scenes[0].mend == Mend(depth_zoom=0.9)
    assert "# scene 00: depth lies beside colour; record again" in text


@pytest.mark.parametrize(("seconds", "rate"), [(0.8, "all"), (30.0, 3.0)])
def test_a_short_recording_is_labelled_whole(seconds: float, rate: float | str) -> None:
    frames = tuple(Frame(k, k / 30, Path("a"), None) for k in range(round(30 * seconds)))
    found = [(replace(each, scene=replace(SCENE, frames=frames)), said) for each, said in [examined("00")]]
    text = recipe_text("data", HowStored("tum"), found, name="n", objects=[("m", 4)], clicks=None)
    assert parse_recipe(yaml.safe_load(text), source="text").label.rate == rate


def test_a_line_break_in_a_name_does_not_end_its_comment() -> None:
    unread = Finding("blur", "rgb/1\nobjects: [] cannot be read", 0.5, "do it")
    text = recipe_text(
        "data", HowStored("tum"), [examined("00", unread)], name="n", objects=[("m", 4)], clicks=None
    )
    assert parse_recipe(yaml.safe_load(text), source="text").objects[0].name == "m"
    assert "# scene 00: rgb/1 objects: [] cannot be read; do it" in text


def test_what_was_told_stands_in_the_recipe() -> None:
    told = HowStored("ros", (600.0, 601.0, 320.0, 240.0), Topics(color="/a/b", poses="/tf"))
    text = recipe_text("x.mcap", told, [examined("00")], name="n", objects=[("m", 4)], clicks=None)
    source = parse_recipe(yaml.safe_load(text), source="text").scenes[0]
    assert (source.format, source.camera, source.topics) == (told.format, told.camera, told.topics)


def test_paths_start_at_the_recipe(tmp_path: Path) -> None:
    assert path_from(tmp_path / "my.yaml", tmp_path / "rec") == "rec"
    assert path_from(tmp_path / "my.yaml", tmp_path) == "."
    assert path_from(tmp_path / "sub" / "my.yaml", tmp_path / "rec") == str(tmp_path / "rec")


def test_keypoints_as_they_are_told() -> None:
    assert keypoints_from(" 7 ", where="") == 7
    assert keypoints_from("[handle, rim,lid]", where="") == ("handle", "rim", "lid")


def test_what_cannot_be_labelled_is_said_before_anybody_clicks() -> None:
    beside = Recording(replace(SCENE, registered=False), None)
    (line,) = _certain_faults(beside)
    assert line.startswith("WARNING: depth is not registered to colour") and "`registered: true`" in line
    assert _certain_faults(Recording(SCENE, None)) == []
