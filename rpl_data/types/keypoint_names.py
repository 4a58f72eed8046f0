"""Keypoints are matched by name wherever two lists of them meet; a number is the name of one without any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rpl_data.types.errors import DataError


def keypoint_rows(keypoints: Sequence[str]) -> Mapping[str, int]:
    """Row of each keypoint by its name, and by its number from 0 where no name is a number itself."""
    rows = {name: row for row, name in enumerate(keypoints)}
    if any(name.isdecimal() for name in keypoints):
        return rows
    return {str(row): row for row in range(len(keypoints))} | rows


def are_numbers(keypoints: Sequence[str]) -> bool:
    """Whether the keypoints have no names, only their numbers from 0."""
    return list(keypoints) == [str(row) for row in range(len(keypoints))]


def keypoint_titles(keypoints: Sequence[str]) -> tuple[str, ...]:
    """What a person reads: `3 rim`, a keypoint's number and name; the number alone where it has no name."""
    return tuple(name if name == str(row) else f"{row} {name}" for row, name in enumerate(keypoints))


def rows_by_name(wanted: Sequence[str], there: Sequence[str], *, what: str) -> list[int]:
    """Row in `there` of each wanted keypoint; row by row where one of both lists has numbers only.

    Args:
        wanted: names in the order to bring the others into.
        there: names in their own order.
        what: whose keypoints these are, for the message.

    Raises:
        DataError: the two lists do not hold the same names.
    """
    if set(wanted) == set(there):
        return [list(there).index(name) for name in wanted]
    if len(wanted) == len(there) and (are_numbers(wanted) or are_numbers(there)):
        return list(range(len(there)))
    unknown = [name for name in wanted if name not in there]
    raise DataError(
        f"{what}: keypoints are matched by name, and {', '.join(unknown) or 'all'} of {', '.join(wanted)} "
        f"{'is' if len(unknown) == 1 else 'are'} not among {', '.join(there)}; give them the same names"
    )
