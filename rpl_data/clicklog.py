"""The append-only log of what a person did to an object's keypoints; the state is its replay.

A line of `clicks.jsonl` is one event. `click` sets (or moves) the mark of a keypoint in a frame,
`delete` takes it away, `undo` and `redo` walk along the other events, `keypoints` names them.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from rpl_data.types import Click, DataError

Event = dict[str, Any]
CSV_COLUMNS = ["object", "keypoint", "scene", "frame", "u_px", "v_px"]


@dataclass(frozen=True)
class Annotation:
    """The state of an object's log: its keypoints and at most one click a keypoint and frame."""

    object: str
    keypoints: tuple[str, ...]
    clicks: tuple[Click, ...]


def replay(object_name: str, events: Iterable[Event]) -> Annotation:
    """The state after all events.

    Raises:
        DataError: an event that cannot be understood, with its number.
    """
    keypoints: tuple[str, ...] = ()
    marks: dict[tuple[int, str, int], Click] = {}
    for event in _effective(object_name, events):
        if event["op"] == "keypoints":
            keypoints = tuple(event["names"])
            continue
        key = (event["keypoint"], event["scene"], event["frame"])
        if event["op"] == "delete":
            marks.pop(key, None)
        else:
            marks[key] = Click(object_name, *key, event["u_px"], event["v_px"])
    return Annotation(object_name, keypoints, tuple(marks.values()))


def _effective(object_name: str, events: Iterable[Event]) -> list[Event]:
    """The events that undo and redo leave standing."""
    done: list[Event] = []
    undone: list[Event] = []
    for number, event in enumerate(events):
        match event.get("op"):
            case "undo":
                if done:
                    undone.append(done.pop())
            case "redo":
                if undone:
                    done.append(undone.pop())
            case "click" | "move" | "delete" | "keypoints":
                done.append(event)
                undone.clear()
            case op:
                raise DataError(
                    f"clicks of {object_name}, event {number}: unknown op {op!r}; expected click, move, "
                    "delete, undo, redo or keypoints"
                )
    return done


def click_event(click: Click) -> Event:
    """The event that sets this click."""
    return {
        "op": "click",
        "keypoint": click.keypoint,
        "scene": click.scene,
        "frame": click.frame,
        "u_px": click.u_px,
        "v_px": click.v_px,
    }


def keypoints_event(names: Sequence[str]) -> Event:
    """The event that names the keypoints, in order."""
    return {"op": "keypoints", "names": list(names)}


def events_to(annotation: Annotation, keypoints: Sequence[str], clicks: Iterable[Click]) -> list[Event]:
    """The events after which the log says exactly these keypoints and clicks; none when it does already.

    A later click on the same keypoint in the same frame replaces an earlier one.
    """
    wanted = {(click.keypoint, click.scene, click.frame): click for click in clicks}
    marks = {(click.keypoint, click.scene, click.frame): click for click in annotation.clicks}
    events = [] if annotation.keypoints == tuple(keypoints) else [keypoints_event(keypoints)]
    events += [
        {"op": "delete", "keypoint": keypoint, "scene": scene, "frame": frame}
        for keypoint, scene, frame in marks.keys() - wanted.keys()
    ]
    return events + [click_event(click) for key, click in wanted.items() if marks.get(key) != click]


def clicks_to_csv(clicks: Iterable[Click], keypoints: Sequence[str]) -> str:
    """Clicks as CSV text, keypoints by name."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for c in clicks:
        writer.writerow([c.object, keypoints[c.keypoint], c.scene, c.frame, f"{c.u_px:.4f}", f"{c.v_px:.4f}"])
    return text.getvalue()


def objects_in_csv(text: str) -> list[str]:
    """Names of the objects that CSV text has clicks for, sorted."""
    return sorted({row["object"] for row in csv.DictReader(io.StringIO(text)) if row.get("object")})


def clicks_from_csv(text: str, *, source: str, object_name: str, keypoints: Sequence[str]) -> list[Click]:
    """Clicks of one object from CSV text; a keypoint is given by name, or by number from 0.

    Raises:
        DataError: a missing column, an unknown keypoint, a number that is none or not finite, or no
            line for this object; the message names the line.
    """
    reader = csv.DictReader(io.StringIO(text))
    missing = [column for column in CSV_COLUMNS if column not in (reader.fieldnames or [])]
    if missing:
        raise DataError(
            f"{source}: column {', '.join(missing)} is missing; "
            f"the first line must be {','.join(CSV_COLUMNS)}"
        )
    numbers = {str(i): i for i in range(len(keypoints))} | {name: i for i, name in enumerate(keypoints)}
    clicks, others = [], set()
    for line, row in enumerate(reader, start=2):
        if row["object"] != object_name:
            others.add(row["object"])
            continue
        if row["keypoint"] not in numbers:
            raise DataError(
                f"{source} line {line}: {object_name} has no keypoint {row['keypoint']!r}; "
                f"it has {', '.join(keypoints)}"
            )
        try:
            u_px, v_px, frame = float(row["u_px"]), float(row["v_px"]), int(row["frame"])
        except (TypeError, ValueError) as error:
            raise DataError(
                f"{source} line {line}: frame must be a whole number and u_px, v_px numbers; {error}"
            ) from error
        if not (math.isfinite(u_px) and math.isfinite(v_px)):
            raise DataError(
                f"{source} line {line}: u_px and v_px must be finite, got {u_px}, {v_px}; delete the line"
            )
        clicks.append(Click(object_name, numbers[row["keypoint"]], row["scene"], frame, u_px, v_px))
    if not clicks:
        raise DataError(
            f"{source} has no click for object {object_name!r}; "
            f"it has clicks for {sorted(others) or 'nothing'}"
        )
    return clicks
