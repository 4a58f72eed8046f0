"""Check the actions of a page before they enter the log, so that the log can always be replayed."""

from __future__ import annotations

from typing import Any

from rpl_data.annotate.stores.scenes import SceneStore
from rpl_data.clicks.log import OPS, Annotation, Event
from rpl_data.types import Click, DataError
from rpl_data.untrusted.names import MOST_KEYPOINTS, checked_keypoints

MOST_EVENTS = 20_000
"""In a batch: the clicks of a file."""
LOCAL = {"click", "move", "delete", "skip", "unskip", "grasp", "crop"}
"""Actions that remain valid when another person did something of the same kind meanwhile."""


def checked(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    """Check an action and return its event, with nothing else in it.

    Raises:
        DataError: it is not an action, or names a keypoint, scene, frame or pixel that does not exist.
    """
    op = action.get("op")
    if not isinstance(op, str):
        raise DataError(f"an action has an op, one of {', '.join(OPS)}, undo or redo")
    if op in ("undo", "redo"):
        return {"op": op}
    if op not in OPS:
        raise DataError(f"unknown action {op!r}")
    try:
        return {"op": op, **_CHECKS[op](action, annotation, scenes)}
    except (KeyError, TypeError, OverflowError) as error:
        raise DataError(f"the action {op} is incomplete: {error!r}") from error


def _click(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    where = _delete(action, annotation, scenes)
    u_px, v_px = _finite(action["u_px"]), _finite(action["v_px"])
    scenes.refuse_outside(
        Click(annotation.object, where["keypoint"], where["scene"], where["frame"], u_px, v_px)
    )
    return {**where, "u_px": u_px, "v_px": v_px}


def _delete(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    return {**_skip(action, annotation, scenes), "frame": _whole(action["frame"])}


def _skip(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    keypoint, scene = _keypoint(action["keypoint"], annotation), action["scene"]
    if scene not in {click.scene for click in annotation.clicks}:  # a click may outlive its scene
        scenes.get(_text(scene))
    return {"keypoint": keypoint, "scene": scene}


def _keypoints(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    return {"names": named_keypoints(action["names"])}


def _order(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    order = [_keypoint(k, annotation) for k in _list(action["order"], MOST_KEYPOINTS)]
    if not order or len(set(order)) < len(order):
        raise DataError("an order must name at least one keypoint, and none twice")
    return {"order": order}


def _model(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    if action["points"] is None:
        return {"points": None}
    listed = _list(action["points"], MOST_KEYPOINTS)
    points = [None if p is None else [_finite(x) for x in _list(p, 3)] for p in listed]
    if any(p is not None and len(p) != 3 for p in points):
        raise DataError("a point of a model has three coordinates")
    return {"points": points, "source": _text(action.get("source", ""))[:200]}


def _grasp(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    names = ("u_px", "v_px", "toward_u_px", "toward_v_px")
    if action["scene"] is None:
        return {"scene": None, "frame": 0, **dict.fromkeys(names, 0.0)}
    values = {name: _finite(action[name]) for name in names}
    scene, frame = _text(action["scene"]), _whole(action["frame"])
    for u, v in (("u_px", "v_px"), ("toward_u_px", "toward_v_px")):
        scenes.refuse_outside(Click(annotation.object, 0, scene, frame, values[u], values[v]))
    return {"scene": scene, "frame": frame, **values}


def _crop(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    if action["low_m"] is None:
        return {"low_m": None, "high_m": None}
    low, high = ([_finite(x) for x in _list(action[name], 3)] for name in ("low_m", "high_m"))
    if len(low) != 3 or len(high) != 3 or any(a >= b for a, b in zip(low, high, strict=True)):
        raise DataError("a crop box needs three coordinates each way, the low ones below the high ones")
    return {"low_m": low, "high_m": high}


def _batch(action: dict[str, Any], annotation: Annotation, scenes: SceneStore) -> Event:
    """Check the actions one after another; a list of names applies to those after it."""
    events: list[Event] = []
    for inner in _list(action["events"], MOST_EVENTS):
        if not isinstance(inner, dict) or inner.get("op") in ("undo", "redo", "batch"):
            raise DataError("a batch cannot contain undo, redo or another batch")
        event = checked(inner, annotation, scenes)
        if event["op"] == "keypoints":
            annotation = Annotation(annotation.object, tuple(event["names"]), annotation.clicks)
        events.append(event)
    return {"events": events}


_CHECKS = {
    "click": _click,
    "move": _click,
    "delete": _delete,
    "skip": _skip,
    "unskip": _skip,
    "keypoints": _keypoints,
    "order": _order,
    "model": _model,
    "grasp": _grasp,
    "crop": _crop,
    "batch": _batch,
}


def named_keypoints(names: Any) -> list[str]:
    """Trim the names of keypoints; DataError for names that are empty, too long, too many or equal."""
    found = [_text(name).strip() for name in _list(names, MOST_KEYPOINTS)]
    return list(checked_keypoints(found, where="the list of keypoints"))


def _keypoint(value: Any, annotation: Annotation) -> int:
    number = _whole(value)
    if not 0 <= number < len(annotation.keypoints):
        raise DataError(f"{annotation.object} has no keypoint number {number}; it has fewer now")
    return number


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**53:
        raise DataError(f"{_shown(value)} is not a whole number")
    return value


def _finite(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e15:
        raise DataError(f"{_shown(value)} is not a finite number")
    return float(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise DataError(f"{_shown(value)} is not a text")
    return value


def _list(value: Any, most: int) -> list[Any]:
    if not isinstance(value, list | tuple) or len(value) > most:
        raise DataError(f"{_shown(value)} is not a list of at most {most}")
    return list(value)


def _shown(value: Any) -> str:
    """A value in a message, short whatever it is."""
    return f"{value!r:.60}" if isinstance(value, str | float | bool | None) else f"a {type(value).__name__}"
