"""The append-only log of clicks and its CSV."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rpl_data.clicks.log import click_event, keypoints_event, replay
from rpl_data.clicks.table import clicks_from_csv, clicks_to_csv
from rpl_data.types import Click, DataError

NAMES = ("corner", "edge", "knob")
A = Click("cube", 0, "00", 3, 10.5, 20.25)
A_MOVED = Click("cube", 0, "00", 3, 11.0, 21.0)
B = Click("cube", 2, "01", 7, -0.5, 479.25)
UNDO, REDO = {"op": "undo"}, {"op": "redo"}
DELETE_A = {"op": "delete", "keypoint": 0, "scene": "00", "frame": 3}
a, a_moved, b = map(click_event, (A, A_MOVED, B))


@pytest.mark.parametrize(
    ("events", "clicks"),
    [
        ([], ()),
        ([a, b], (A, B)),
        ([a, b, a_moved], (A_MOVED, B)),
        ([a, a_moved | {"op": "move"}], (A_MOVED,)),
        ([a, b, DELETE_A], (B,)),
        ([DELETE_A, b], (B,)),
        ([a, b, UNDO], (A,)),
        ([a, a_moved, UNDO], (A,)),
        ([a, b, DELETE_A, UNDO], (A, B)),
        ([a, b, UNDO, UNDO, REDO], (A,)),
        ([a, b, UNDO, UNDO, REDO, REDO], (A, B)),
        ([a, UNDO, b, REDO], (B,)),  # a new click ends what can be redone
        ([UNDO, REDO, a, UNDO, UNDO, REDO], (A,)),
    ],
)
def test_replay(events: list[dict[str, object]], clicks: tuple[Click, ...]) -> None:
    assert replay("cube", events).clicks == clicks


def test_keypoints_are_named_by_an_event() -> None:
    assert replay("cube", [keypoints_event(NAMES), a]).keypoints == NAMES
    assert replay("cube", [keypoints_event(["x"]), keypoints_event(NAMES), UNDO]).keypoints == ("x",)


def test_an_unknown_event_is_named() -> None:
    with pytest.raises(DataError, match=r"clicks of cube, event 1: unknown op 'klick'"):
        replay("cube", [a, {"op": "klick"}])


@pytest.mark.parametrize(
    ("names", "click", "why"),
    [
        (["a", ["b"], "c"], {}, "is not a text"),
        (["a", "b"], {"keypoint": 2}, "click on keypoint 2, but only 2 are named"),
        (["a", "b"], {"keypoint": "1"}, "is not a whole number"),
        (["a", "b"], {"frame": [0]}, "is not a whole number"),
        (["a", "b"], {"u_px": float("nan")}, "is not a finite number"),
    ],
)
def test_a_damaged_log_is_refused(names: list[object], click: dict[str, object], why: str) -> None:
    good = {"op": "click", "keypoint": 1, "scene": "00", "frame": 0, "u_px": 1.0, "v_px": 2.0}
    with pytest.raises(DataError, match=why):
        replay("cup", [{"op": "keypoints", "names": names}, good | click])


def test_csv_round_trip() -> None:
    text = clicks_to_csv([A, B], NAMES)
    assert text.splitlines()[1] == "cube,corner,00,3,10.5000,20.2500"
    assert clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES) == [A, B]


def test_csv_takes_numbers_and_only_its_object() -> None:
    text = "object,keypoint,scene,frame,u_px,v_px\ncup,0,00,1,1,1\ncube,2,01,7,-0.5,479.25\n"
    assert clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES) == [B]


def test_csv_of_a_table_program_with_decimal_commas() -> None:
    text = "\ufeffobject;keypoint;scene;frame;u_px;v_px\ncube;2;01;7;-0,5;479,25\n"
    assert clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES) == [B]


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\nobject;keypoint;scene;frame;u_px;v_px\ncube;2;01;7;-0,5;479,250\n",
        "object\tkeypoint\tscene\tframe\tu_px\tv_px\ncube\t2\t01\t7\t-0,5\t479,25\n",
        "Object, Keypoint, Scene, Frame, u_px, v_px\ncube, 2, 01, 7, -0.5, 479.25\n",
    ],
)
def test_csv_as_other_table_programs_write_it(text: str) -> None:
    assert clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES) == [B]


def test_keypoints_called_by_numbers_are_matched_by_name_only() -> None:
    text = HEADER + "cube,3,00,1,1,1\n"
    (click,) = clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=("3", "2", "1"))
    assert click.keypoint == 0
    with pytest.raises(DataError, match="cube has no keypoint '0'; it has 3, 2, 1"):
        clicks_from_csv(
            HEADER + "cube,0,00,1,1,1\n", source="c.csv", object_name="cube", keypoints=("3", "2", "1")
        )


HEADER = "object,keypoint,scene,frame,u_px,v_px\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "c.csv: column object, keypoint, scene, frame, u_px, v_px is missing"),
        (
            "object,keypoint,scene,frame,u_px\n",
            "c.csv: column v_px is missing; the first line must be object,",
        ),
        (HEADER, "c.csv has no click for object 'cube'; it has clicks for nothing"),
        (HEADER + "cup,0,00,1,1,1\n", r"it has clicks for \['cup'\]"),
        (HEADER + "cube,3,00,1,1,1\n", "c.csv line 2: cube has no keypoint '3'; it has corner, edge, knob"),
        (HEADER + "cube,0,00,1.5,1,1\n", "c.csv line 2: frame must be a whole number"),
        (HEADER + "cube,0,00,1,x,1\n", "c.csv line 2: frame must be a whole number and u_px, v_px numbers"),
        (HEADER + "cube,0,00,1,57,3017,41,25\n", "c.csv line 2: expected 6 values, found more; numbers have"),
        (HEADER + 'cube,0,00,1,"57,3017",41\n', "c.csv line 2: frame must be a whole number and u_px, v_px"),
        (HEADER + "cube,0,00,1,1\n", "c.csv line 2: expected 6 values, found fewer"),
        (HEADER + "cube,0,00,1,nan,1\n", "c.csv line 2: u_px and v_px must be finite, got nan"),
    ],
)
def test_a_broken_csv_is_refused(text: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES)


def test_csv_tells_instances_apart() -> None:
    other = replace(A, scene="00/2", u_px=40.0)
    text = clicks_to_csv([A, other], NAMES)
    assert text.splitlines()[1:] == [
        "cube,corner,00,3,10.5000,20.2500,",
        "cube,corner,00,3,40.0000,20.2500,2",
    ]
    assert clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES) == [A, other]
    without = text.replace(",instance", "").replace(",2\n", "\n").replace(",\n", "\n")
    with pytest.raises(DataError, match="two instances of the object apart in a column `instance`"):
        clicks_from_csv(without, source="c.csv", object_name="cube", keypoints=NAMES)


@pytest.mark.parametrize(
    ("scene", "instance"), [("00/2", ""), ("00", "a/b"), ("00", "../.."), ("00", "@3"), ("00", "2@3")]
)
def test_csv_with_names_that_leave_their_scene_is_refused(scene: str, instance: str) -> None:
    text = f"object,keypoint,scene,frame,u_px,v_px,instance\ncube,0,{scene},1,1,1,{instance}\n"
    with pytest.raises(DataError, match="c.csv line 2: .* cannot be the name of"):
        clicks_from_csv(text, source="c.csv", object_name="cube", keypoints=NAMES)


def test_instances_are_marked_skipped_and_taken_back_apart() -> None:
    other = click_event(replace(A, scene="00/2"))
    state = replay("cube", [a, other, {"op": "skip", "keypoint": 1, "scene": "00/2"}, DELETE_A])
    assert [click.scene for click in state.clicks] == ["00/2"] and state.skipped == {(1, "00/2")}
