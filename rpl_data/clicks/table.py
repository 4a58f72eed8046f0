"""Clicks as CSV text, and back."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from rpl_data.types import Click, DataError
from rpl_data.types.instances import instance_of, placed_as, scene_of
from rpl_data.types.keypoint_names import keypoint_rows
from rpl_data.untrusted.names import checked_name
from rpl_data.untrusted.numbers import plain_number

_SEPARATOR = re.compile(r"sep=.\n", re.IGNORECASE)
CSV_COLUMNS = ["object", "keypoint", "scene", "frame", "u_px", "v_px"]
INSTANCE = "instance"
"""A column that is there only where several instances of an object in a scene are told apart."""


def clicks_to_csv(clicks: Iterable[Click], keypoints: Sequence[str], *, instances: bool | None = None) -> str:
    """Clicks as CSV text, keypoints by name.

    Args:
        instances: whether there is a column for the instance; None = where a click has one.
    """
    clicks = list(clicks)
    several = has_instances(clicks) if instances is None else instances
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*CSV_COLUMNS, INSTANCE] if several else CSV_COLUMNS)
    for c in clicks:
        where = [c.object, keypoints[c.keypoint], scene_of(c.scene), c.frame]
        row = [*where, f"{c.u_px:.4f}", f"{c.v_px:.4f}"]
        writer.writerow([*row, instance_of(c.scene)] if several else row)
    return text.getvalue()


def tables_to_csv(tables: Iterable[tuple[Iterable[Click], Sequence[str]]]) -> str:
    """The clicks of several objects, each with its keypoints, as CSV text with one heading."""
    listed = [(list(clicks), keypoints) for clicks, keypoints in tables]
    several = any(has_instances(clicks) for clicks, _ in listed)
    texts = [clicks_to_csv(clicks, keypoints, instances=several) for clicks, keypoints in listed]
    return texts[0] + "".join(text.split("\n", 1)[1] for text in texts[1:])


def has_instances(clicks: Iterable[Click]) -> bool:
    """Whether a click names an instance."""
    return any(instance_of(click.scene) for click in clicks)


def objects_in_csv(text: str, *, source: str) -> list[str]:
    """Names of the objects that CSV text has clicks for, sorted; DataError as `clicks_from_csv`."""
    return sorted(keypoints_in_csv(text, source=source))


def keypoints_in_csv(text: str, *, source: str) -> dict[str, list[str]]:
    """Keypoints of each object that CSV text has clicks for, as they are called there, in that order."""
    found: dict[str, dict[str, None]] = {}
    for _, row in _rows(text, source):
        found.setdefault(row["object"], {})[row["keypoint"]] = None
    return {name: list(keypoints) for name, keypoints in found.items()}


def clicks_from_csv(text: str, *, source: str, object_name: str, keypoints: Sequence[str]) -> list[Click]:
    """Read the clicks of one object from CSV text; keypoints are given by name, or by number from 0.

    Table programs of some countries write semicolons or tabs between values and a comma in numbers, below a
    line `sep=;`; it is read too.

    Raises:
        DataError: a column is missing, a line has more or fewer values than columns, a keypoint is unknown,
            a value is not a finite number, two different clicks are on one keypoint in one frame, or no line
            is about this object; the message names the line.
    """
    numbers = keypoint_rows(keypoints)
    clicks, others = [], set()
    first_lines: dict[tuple[int, str, int], tuple[int, Click]] = {}
    for line, row in _rows(text, source):
        if row["object"] != object_name:
            others.add(row["object"])
            continue
        if row["keypoint"] not in numbers:
            raise DataError(
                f"{source} line {line}: {object_name} has no keypoint {row['keypoint']!r}; "
                f"it has {', '.join(keypoints)}"
            )
        try:
            u_px, v_px, frame = (
                plain_number(float, row["u_px"]),
                plain_number(float, row["v_px"]),
                plain_number(int, row["frame"]),
            )
        except (TypeError, ValueError) as error:
            raise DataError(
                f"{source} line {line}: frame must be a whole number and u_px, v_px numbers; {error}"
            ) from error
        if not (math.isfinite(u_px) and math.isfinite(v_px)):
            raise DataError(
                f"{source} line {line}: u_px and v_px must be finite, got {u_px}, {v_px}; delete the line"
            )
        place = _place(row, where=f"{source} line {line}")
        click = Click(object_name, numbers[row["keypoint"]], place, frame, u_px, v_px)
        before, same = first_lines.setdefault((click.keypoint, click.scene, click.frame), (line, click))
        if same != click:
            raise DataError(
                f"{source} lines {before} and {line} put keypoint {row['keypoint']} of {object_name} at two "
                f"places of frame {frame} in scene {place}; delete the wrong line, or tell two instances of "
                f"the object apart in a column `{INSTANCE}`"
            )
        clicks.append(click)
    if not clicks:
        raise DataError(
            f"{source} has no click for object {object_name!r}; "
            f"it has clicks for {sorted(others) or 'nothing'}"
        )
    return clicks


def _place(row: Mapping[str, str], *, where: str) -> str:
    """The scene and instance of a line, as `Click.scene`."""
    if "/" in row["scene"]:
        checked_name(row["scene"], "scene", where=where)
    instance = row.get(INSTANCE, "")
    if "@" in instance:  # what stands behind it is the frame of a moved object's place
        raise DataError(
            f"{where}: {instance!r:.60} cannot be the name of an instance, which holds no @; the frame has a "
            "column of its own"
        )
    return placed_as(row["scene"], checked_name(instance, "instance", where=where) if instance else "")


def _rows(text: str, source: str) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and values of each line that is not empty; DataError where a line does not fit."""
    text = text.removeprefix("\ufeff")
    said = _SEPARATOR.match(text)  # a line for table programs only
    lines = io.StringIO(text)
    if said:
        next(lines)
    first = text[said.end() if said else 0 :].partition("\n")[0]
    separator = next((mark for mark in ";\t" if mark in first), ",")
    reader = csv.DictReader(lines, delimiter=separator, skipinitialspace=True)
    try:
        if reader.fieldnames is not None:
            reader.fieldnames = [name.strip().lower() for name in reader.fieldnames]
        missing = [column for column in CSV_COLUMNS if column not in (reader.fieldnames or [])]
        if missing:
            raise DataError(
                f"{source}: column {', '.join(missing)} is missing; "
                f"the first line must be {','.join(CSV_COLUMNS)}"
            )
        for row in reader:
            line = reader.line_num + bool(said)
            more = any(value.strip() for value in row.pop(None, ()))
            if more or None in row.values():
                raise DataError(
                    f"{source} line {line}: expected {len(reader.fieldnames or ())} values, found "
                    f"{'more' if more else 'fewer'}; numbers have a decimal point, not a comma"
                )
            row = {column: value.strip() for column, value in row.items()}
            if separator != ",":
                row |= {column: row[column].replace(",", ".") for column in ("u_px", "v_px")}
            yield line, row
    except csv.Error as error:
        line = reader.line_num + bool(said)
        raise DataError(f"{source} line {line}: {error}; repair or delete the line") from error
