"""Convert what is known of an object's symmetry to JSON-ready dictionaries and back; no file is touched."""

from __future__ import annotations

import math
from typing import Any

from rpl_data.json_arrays import (
    Json,
    each,
    finite_or_none,
    flag,
    number,
    optional,
    rows_from_json,
    rows_to_json,
    taken,
    text,
    whole,
)
from rpl_data.symmetries import axis_from_json, axis_to_json
from rpl_data.types import FoundAxis, SymmetryRecord, Turns

ANY = "any"
"""Stands in files for an axis of full rotation."""


def symmetry_to_json(record: SymmetryRecord) -> Json:
    """Convert a record."""
    confirmed = None
    if record.confirmed is not None:
        confirmed = [_turns_to_json(one) for one in record.confirmed]
    return {
        "points_object": rows_to_json(record.points_object),
        "seen": finite_or_none(record.seen),
        "found": None if record.found is None else [_found_to_json(one) for one in record.found],
        "confirmed": confirmed,
        "by": record.by,
    }


def symmetry_from_json(data: Json) -> SymmetryRecord:
    """Convert what `symmetry_to_json` returned back."""
    return SymmetryRecord(
        points_object=taken(data, "points_object", lambda rows: rows_from_json(rows, 3)),
        found=taken(data, "found", optional(each(_found_from_json))),
        seen=taken(data, "seen", lambda seen: math.nan if seen is None else number(seen)),
        confirmed=taken(data, "confirmed", optional(each(_turns_from_json))),
        by=taken(data, "by", text),
    )


def _turns_to_json(one: Turns) -> Json:
    return axis_to_json(one.axis) | {"turns": _count_to_json(one.turns)}


def _turns_from_json(data: Json) -> Turns:
    return Turns(axis_from_json(data), taken(data, "turns", count_from_json))


def _count_to_json(turns: int | None) -> int | str:
    return ANY if turns is None else turns


def count_from_json(value: Any) -> int | None:
    """How many equal turns; None for any."""
    if value == ANY:
        return None
    if whole(value) < 1:
        raise ValueError(f"{value} turns; expected a number above 0, or {ANY!r}")
    return whole(value)


def _found_to_json(one: FoundAxis) -> Json:
    figures = {"compared": one.compared, "off_m": one.off_m, "print_off": one.print_off, "sure": one.sure}
    counts = {"turns": _count_to_json(one.turns), "shape_turns": _count_to_json(one.shape_turns)}
    found: Json = finite_or_none(axis_to_json(one.axis) | counts | figures)
    return found


def _found_from_json(data: Json) -> FoundAxis:
    print_off = taken(data, "print_off", optional(number))
    return FoundAxis(
        axis=axis_from_json(data),
        turns=taken(data, "turns", count_from_json),
        shape_turns=taken(data, "shape_turns", count_from_json),
        compared=taken(data, "compared", number),
        off_m=taken(data, "off_m", number),
        print_off=math.nan if print_off is None else print_off,
        sure=taken(data, "sure", flag),
    )
