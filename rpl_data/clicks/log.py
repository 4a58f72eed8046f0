"""The append-only log of what a person did to an object's keypoints; replaying it gives the state.

Each line of `clicks.jsonl` is one event:

- `click` sets (and `move` moves) the click on a keypoint in a frame, `delete` removes it;
- `skip` says that a keypoint is not visible in a scene, `unskip` or a click takes that back;
- `keypoints` names the keypoints; if the list became shorter, clicks on the keypoints that were cut off are
  dropped;
- `order` reorders the keypoints or drops some; clicks stay with their keypoint;
- `model` gives the keypoints known positions (`points` null: they are computed from the clicks again);
- `grasp` marks where and in which direction to grasp, `crop` cuts the dense model to a box;
- `batch` holds several events that are undone as one;
- `undo` takes back the latest of the other events, `redo` restores it.

Events may carry keys that the replay ignores (`id`, `time_s`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from rpl_data.json_arrays import each, text, whole
from rpl_data.json_arrays import number as finite
from rpl_data.types import Click, DataError

Event = dict[str, Any]
Corner = tuple[float, float, float]
OPS = ("click", "move", "delete", "skip", "unskip", "keypoints", "order", "model", "grasp", "crop", "batch")


@dataclass(frozen=True)
class GraspClicks:
    """Two clicks in one frame: the grasp point, and a point that the grasp's x axis points to."""

    scene: str
    frame: int
    u_px: float
    v_px: float
    toward_u_px: float
    toward_v_px: float


@dataclass(frozen=True)
class Annotation:
    """The state of an object's log: its keypoints, with at most one click per keypoint and frame.

    Attributes:
        skipped: pairs (keypoint, scene) that a person declared not visible.
        known_points: given positions of the keypoints, in any frame, metres; None for a keypoint without
            one. None as a whole: the positions are computed from the clicks.
        crop_m: lowest and highest corner of the box that the dense model is cut to, in the object frame.
    """

    object: str
    keypoints: tuple[str, ...]
    clicks: tuple[Click, ...]
    skipped: frozenset[tuple[int, str]] = frozenset()
    known_points: tuple[Corner | None, ...] | None = None
    grasp: GraspClicks | None = None
    crop_m: tuple[Corner, Corner] | None = None


def replay(object_name: str, events: Iterable[Event]) -> Annotation:
    """Replay the events and return the state after the last one.

    Raises:
        DataError: an event that cannot be understood, with its number.
    """
    state = _State(object_name)
    for event in effective(object_name, events)[0]:
        try:
            state.apply(event)
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise DataError(
                f"clicks of {object_name}: cannot understand {event}: {error!r}; delete the line"
            ) from error
    _refuse_unknown_keypoints(state)
    return Annotation(
        object_name,
        state.keypoints,
        tuple(state.marks.values()),
        frozenset(state.skipped),
        state.known_points,
        state.grasp,
        state.crop_m,
    )


def effective(object_name: str, events: Iterable[Event]) -> tuple[list[Event], list[Event]]:
    """Split the events into those in force after undo and redo, and those that redo would restore, next last.

    Raises:
        DataError: an unknown event, with its number.
    """
    done: list[Event] = []
    undone: list[Event] = []
    for number, event in enumerate(events):
        op = event.get("op")
        if op == "undo" and done:
            undone.append(done.pop())
        elif op == "redo" and undone:
            done.append(undone.pop())
        elif op in OPS:
            done.append(event)
            undone.clear()
        elif op not in ("undo", "redo"):
            raise DataError(
                f"clicks of {object_name}, event {number}: unknown op {op!r}; expected "
                f"{', '.join(OPS)}, undo or redo"
            )
    return done, undone


@dataclass
class _State:
    """The state of the log after the events replayed so far."""

    object: str
    keypoints: tuple[str, ...] = ()
    marks: dict[tuple[int, str, int], Click] = field(default_factory=dict)
    skipped: set[tuple[int, str]] = field(default_factory=set)
    known_points: tuple[Corner | None, ...] | None = None
    grasp: GraspClicks | None = None
    crop_m: tuple[Corner, Corner] | None = None

    def apply(self, event: Event) -> None:
        match event["op"]:
            case "batch":
                for inner in event["events"]:
                    self.apply(inner)
            case "click" | "move":
                key = (whole(event["keypoint"]), text(event["scene"]), whole(event["frame"]))
                self.marks[key] = Click(self.object, *key, finite(event["u_px"]), finite(event["v_px"]))
                self.skipped.discard(key[:2])
            case "delete":
                self.marks.pop((event["keypoint"], event["scene"], event["frame"]), None)
            case "skip":
                self.skipped.add((event["keypoint"], event["scene"]))
            case "unskip":
                self.skipped.discard((event["keypoint"], event["scene"]))
            case "keypoints":
                names = each(text)(event["names"])
                self._renumber({k: k for k in range(len(names))}, names)
            case "order":
                order = [int(k) for k in event["order"]]
                names = tuple(self.keypoints[k] for k in order)
                self._renumber({old: new for new, old in enumerate(order)}, names)
            case "model":
                self.known_points = _corners(event["points"])
            case "grasp":
                values = {name: event[name] for name in GraspClicks.__dataclass_fields__}
                self.grasp = None if event["scene"] is None else GraspClicks(**values)
            case "crop":
                low_high = _corners([event["low_m"], event["high_m"]]) if event["low_m"] else None
                self.crop_m = low_high  # type: ignore[assignment]
            case op:
                raise DataError(f"clicks of {self.object}: unknown op {op!r} in a batch")

    def _renumber(self, new_of: dict[int, int], names: tuple[str, ...]) -> None:
        """Renumber the keypoints, and drop the clicks, skips and positions of those left out."""
        kept = [c for c in self.marks.values() if c.keypoint in new_of]
        moved = [Click(c.object, new_of[c.keypoint], c.scene, c.frame, c.u_px, c.v_px) for c in kept]
        self.marks = {(c.keypoint, c.scene, c.frame): c for c in moved}
        self.skipped = {(new_of[k], scene) for k, scene in self.skipped if k in new_of}
        if self.known_points is not None:
            old_of = {new: old for old, new in new_of.items()}
            known = dict(enumerate(self.known_points))
            self.known_points = tuple(known.get(old_of[new]) for new in range(len(names)))
        self.keypoints = names


def _refuse_unknown_keypoints(state: _State) -> None:
    """DataError where a click is on a keypoint that the log does not name."""
    named = len(state.keypoints)
    for keypoint, scene, frame in state.marks:
        if named and not 0 <= keypoint < named:
            raise DataError(
                f"clicks of {state.object}: scene {scene}, frame {frame} has a click on keypoint {keypoint}, "
                f"but only {named} are named; restore the line of the names, or delete that of the click"
            )


def _corners(points: Sequence[Sequence[float] | None] | None) -> tuple[Corner | None, ...] | None:
    if points is None:
        return None
    return tuple(None if p is None else (float(p[0]), float(p[1]), float(p[2])) for p in points)


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
    """The events that bring the log to exactly these keypoints and clicks; empty when it already has them.

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
