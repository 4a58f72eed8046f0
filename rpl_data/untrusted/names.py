"""The one rule for names of objects, scenes and keypoints: each may become the name of a folder or a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

from rpl_data.types import DataError

MOST_CHARACTERS = 100
MOST_BYTES = 200
"""With a suffix behind it, a name still fits into the 255 bytes that file systems allow."""
MOST_KEYPOINTS = 200

Kind = Literal["object", "scene", "keypoint", "instance"]


def checked_name(name: object, kind: Kind, *, where: str = "") -> str:
    """The name, when it may be one; DataError when it could leave its folder or not be shown.

    Args:
        name: what somebody calls it.
        kind: what it names, for the message.
        where: the file and field it stands in, for the message.
    """
    if isinstance(name, str) and _is_name(name):
        return name
    at = f"{where}: " if where else ""
    raise DataError(
        f"{at}{f'{name!r:.60}'} cannot be the name of {'an' if kind[0] in 'oi' else 'a'} {kind}; choose "
        f"1 to {MOST_CHARACTERS} printable characters, no / or \\, no dot first, no blank at either end"
    )


def _is_name(name: str) -> bool:
    fits = 1 <= len(name) <= MOST_CHARACTERS and name.isprintable() and len(name.encode()) <= MOST_BYTES
    return fits and name == name.strip() and not name.startswith(".") and not set(name) & {"/", "\\"}


def checked_keypoints(names: Iterable[object], *, where: str) -> Sequence[str]:
    """Names of an object's keypoints; DataError at a bad one, one used twice, none, or too many."""
    found = [checked_name(name, "keypoint", where=where) for name in names]
    if not 1 <= len(found) <= MOST_KEYPOINTS:
        raise DataError(f"{where}: an object has 1 to {MOST_KEYPOINTS} keypoints, not {len(found)}")
    double = next((name for number, name in enumerate(found) if name in found[:number]), None)
    if double is not None:
        raise DataError(f"{where}: two keypoints are called {double!r}; choose another name for one of them")
    return found
