"""The next step: contradictions first, then what nothing checks; done when neither is left."""

from dataclasses import replace

import numpy as np

from rpl_data.annotate.advice import next_step
from rpl_data.annotate.live import Live
from rpl_data.clicks.log import Annotation
from rpl_data.types import Click, KeypointModel, NextClick, Solution, Statement

POINTS = np.eye(4, 3)
SCENES = ("00", "01", "02")
CLICKS = [Click("it", k, scene, 3, 10.0 * k, 5.0) for scene in SCENES for k in range(4)]


def solution_of(*statements, helpful=(), points=POINTS):
    return Solution(
        KeypointModel("it", tuple("abcde"[: len(points)]), points),
        np.tile(1e-6 * np.eye(3), (len(points), 1, 1)),
        {scene: np.eye(4) for scene in SCENES},
        statements=statements,
        next_clicks=helpful,
    )


def advised(*statements, clicks=CLICKS, skipped=(), helpful=(), points=POINTS, judged=()):
    solution = solution_of(*statements, helpful=helpful, points=points)
    names = tuple("abcde"[: len(points)])
    annotation = Annotation("it", names, clicks=tuple(clicks), skipped=frozenset(skipped))
    return next_step(annotation, Live(solution), SCENES, judged=judged)


def test_done_when_nothing_contradicts_and_everything_is_checked():
    assert advised().action == "label"


def test_a_keypoint_without_a_position_is_not_called_checked():
    marked = [c for c in CLICKS if c.keypoint != 3]
    said = advised(
        clicks=marked,
        skipped=[(3, s) for s in SCENES],
        points=np.vstack([POINTS[:3], np.full((1, 3), np.nan)]),
    )
    assert "every keypoint is checked but 3 d, which will have no label" in said.text


def test_a_distance_that_no_other_side_tells_is_not_called_checked():
    annotation = Annotation("it", tuple("abcd"), clicks=tuple(CLICKS))
    said = next_step(annotation, Live(replace(solution_of(), one_side=(1, 3))), SCENES).text
    assert "every keypoint is checked, the distance of 1 b, 3 d by the depth camera alone" in said


def test_a_wrong_click_is_shown_where_it_is():
    step = advised(Statement("wrong place", (CLICKS[5],), "keypoint b is 40 px off"))
    assert (step.scene, step.frame, step.keypoint) == ("01", 3, 1)
    assert step.text.startswith("keypoint b is 40 px off; if it is right, mark it in another sharp frame")


def test_clicks_that_disagree_want_a_third_scene():
    clicks = [c for c in CLICKS if (c.scene, c.keypoint) != ("02", 1)]
    said = Statement("disagree", (CLICKS[1], CLICKS[5]), "keypoint b: its clicks disagree")
    step = advised(said, clicks=clicks)
    assert (step.scene, step.frame, step.keypoint) == ("02", None, 1)
    skipped = advised(said, clicks=clicks, skipped={(1, "02")})
    assert (skipped.scene, skipped.frame) == ("00", 3)  # no third scene shows it: look at the first
    alone = Statement("disagree", (CLICKS[1], replace(CLICKS[1], frame=7)), "its clicks disagree")
    again = advised(alone, clicks=clicks, skipped={(1, "02"), (1, "01")})
    assert (again.scene, again.frame) == ("00", None)  # the page leads to a frame where it is not marked


def test_clicks_repeated_as_asked_lead_to_the_build_and_then_to_the_doubt_that_stays():
    """Each further click there was another frame of a path that strays: the page asked for them for ever."""
    skipped = {(1, "01"), (1, "02")}
    apart = ", and nothing tells which is wrong; mark it in one more frame"
    clicks, steps = [c for c in CLICKS if c.keypoint != 1 or c.scene == "00"], []
    for frame in range(10, 20):
        mine = [c for c in clicks if c.keypoint == 1]
        said = Statement(
            "disagree", tuple(mine), f"keypoint b: its clicks in scene 00 disagree by 14 px{apart}"
        )
        steps.append(advised(said, clicks=clicks, skipped=skipped))
        if steps[-1].action:
            break
        assert (steps[-1].scene, steps[-1].keypoint) == ("00", 1)
        clicks.append(replace(CLICKS[1], frame=frame))
    assert len(steps) == 4 and steps[-1].action == "label"
    assert "disagree by 14 px" in steps[-1].text and "whether the camera's path strays" in steps[-1].text
    built = advised(said, clicks=clicks, skipped=skipped, judged={"00"})
    assert built.action == "label" and "labels will be rough: keypoint b" in built.text
    assert "disagree by 14 px" in built.doubt and "off by as much" in built.doubt
    assert advised(clicks=clicks, skipped=skipped, judged={"00"}).doubt == ""  # corrected: nothing disagrees


def test_a_slip_is_shown_until_its_keypoint_was_marked_often():
    said = Statement("wrong place", (CLICKS[5],), "scene 01: keypoint b is 40 px off; move it to its place")
    again = [replace(CLICKS[5], frame=frame) for frame in (7, 9, 11)]
    assert advised(said, clicks=CLICKS + again[:2]).frame == 3
    assert advised(said, clicks=CLICKS + again).action == "label"


def test_a_scene_with_too_few_clicks_says_how_many_it_needs():
    step = advised(clicks=[c for c in CLICKS if c.scene != "02" or c.keypoint == 0])
    assert (step.scene, step.keypoint) == ("02", 1)
    asked = (
        "mark keypoint 1 b (1 of 4 keypoints clicked in this scene; it needs at least 3). Not visible here?"
    )
    assert asked in step.text


def test_a_scene_placed_without_clicks_is_not_asked_for_any():
    assert advised(clicks=[c for c in CLICKS if c.scene != "02"]).action == "label"


def test_a_badly_placed_scene_wants_a_click_and_is_never_called_placed():
    said = Statement("weak scene", (CLICKS[8],), "scene 02: its clicks fit almost as well 80 mm away")
    fifth = [Click("it", 4, scene, 3, 40.0, 5.0) for scene in ("00", "01")]
    step = advised(said, clicks=CLICKS + fifth, points=np.eye(5, 3))
    assert (step.text, step.scene, step.keypoint, step.action) == (said.text, "02", 4, None)
    assert advised(said).text.startswith("every scene is placed, but scene 02 not surely, and every keypoint")
    alone = Statement("unjudged", (CLICKS[8],), "9 clicks cannot be judged")
    settled = "every scene is placed, but scene 02 not surely, and 9 clicks cannot be judged; or, as it is: "
    assert advised(said, alone).text.startswith(settled)


def test_clicks_that_nothing_checked_are_not_called_checked():
    solution = replace(solution_of(), checked=False)
    said = next_step(Annotation("it", tuple("abcd"), clicks=tuple(CLICKS)), Live(solution), SCENES)
    assert said.action == "label" and "nothing checks the clicks" in said.text


def test_a_keypoint_that_nothing_checks_is_not_done():
    clicks = [c for c in CLICKS if c.keypoint != 3 or c.scene == "00"]
    said = Statement("unchecked", (CLICKS[3],), "nothing checks keypoint d")
    step = advised(said, clicks=clicks, skipped={(3, "01"), (3, "02")})
    assert (step.text, step.scene, step.keypoint, step.action) == ("nothing checks keypoint d", "00", 3, None)


def test_the_click_that_helps_most_is_named_with_its_gain_while_it_is_worth_it():
    helpful = (
        NextClick("01", 7, 2, 1.25, 3.5),
        NextClick("02", 7, 1, 0.6, 3.0),
        NextClick("02", 7, 0, 0.01, 3.0),
    )
    step = advised(helpful=helpful)
    assert (step.scene, step.frame, step.keypoint) == ("01", 7, 2)
    assert "keypoint 2 c here; it should lower the error by 1.2 mm on average, to 3.5 mm" in step.text
    assert advised(helpful=helpful, skipped={(2, "01")}).scene == "02"
    assert advised(helpful=helpful, skipped={(2, "01"), (1, "02")}).action == "label"
    assert advised(helpful=(NextClick("01", 7, 2, 0.7, 8.0),)).action == "label"  # a tenth of it, or less
    often = CLICKS + [Click("it", 2, "01", frame, 20.0, 5.0) for frame in (5, 6, 8)]
    assert advised(helpful=helpful[:1], clicks=often).action == "label"


def test_scenes_whose_labels_will_be_rough_are_not_called_good():
    annotation = Annotation("it", tuple("abcd"), clicks=tuple(CLICKS))
    said = next_step(annotation, Live(solution_of()), SCENES, {"01": 7.0, "02": 12.0})
    assert said.action == "label"
    assert "labels will be rough: in scene 02 they are expected to be 12 px off" in said.text
    assert "in 1 other scene less" in said.text
