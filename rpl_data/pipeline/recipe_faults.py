"""What about a value of a recipe does not fit its type, in the words of the person who wrote it."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

TEXT = "text, in quotes if it looks like a number"
NAMES = {int: "a whole number", float: "a number", bool: "true or false", str: TEXT, Path: f"a path: {TEXT}"}


@dataclass(frozen=True)
class Misfit:
    """A value that does not fit.

    Attributes:
        where: its key, such as `scenes[0].path`.
        text: what it must be and what it is; follows the key in a sentence.
    """

    where: str
    text: str


def misfit(kind: Any, value: object, where: str) -> Misfit | None:
    """Find the first value that does not fit the type of its field; None when all do.

    Args:
        kind: the type: of the fields of recipes, so numbers, text, paths, choices, lists and dataclasses.
        value: as YAML gave it.
        where: its key.
    """
    if value is None and type(None) in typing.get_args(kind):
        return None
    kinds = _alternatives(kind)
    found = [_misfit_of_one(kind, value, where) for kind in kinds]
    if None in found:
        return None
    inside = [one for one in found if one is not None and one.text]
    if inside:  # the value has the shape of that alternative, so the fault is within it
        return inside[0]
    expected = " or ".join(_described(kind) for kind in kinds)
    must = "must hold" if all(map(dataclasses.is_dataclass, kinds)) else "must be"
    return Misfit(where, f"{must} {expected}, not {_shown(value)}")


def _alternatives(kind: Any) -> tuple[Any, ...]:
    """The members of a union, without None, which the person need not be told of; else the type itself."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return tuple(one for one in typing.get_args(kind) if one is not type(None))
    return (kind,)


def _misfit_of_one(kind: Any, value: object, where: str) -> Misfit | None:
    here = Misfit(where, "")  # another kind of value; `misfit` says what was expected
    if dataclasses.is_dataclass(kind):
        return _first(_of_fields(kind, value, where)) if isinstance(value, Mapping) else here
    if typing.get_origin(kind) is tuple:
        return _first(_of_items(kind, value, where)) if _is_list(value) else here
    if typing.get_origin(kind) is dict:
        return _first(_of_values(kind, value, where)) if isinstance(value, Mapping) else here
    if typing.get_origin(kind) is Literal:
        return None if value in typing.get_args(kind) else here
    return None if kind not in NAMES or _fits(kind, value) else here


def _first(found: Iterator[Misfit | None]) -> Misfit | None:
    return next((one for one in found if one is not None), None)


def _of_fields(kind: Any, value: Mapping[str, object], where: str) -> Iterator[Misfit | None]:
    for field in dataclasses.fields(kind):
        name = f"{where}.{field.name}" if where else field.name
        if field.name in value:
            yield misfit(typing.get_type_hints(kind)[field.name], value[field.name], name)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            yield Misfit(name, "is missing; add it")


def _of_items(kind: Any, value: Sequence[object], where: str) -> Iterator[Misfit | None]:
    items = typing.get_args(kind)
    if items[-1] is Ellipsis:
        items = (items[0],) * len(value)
    if len(items) != len(value):
        yield Misfit(f"{where}", f"must be {_described(kind)}, not {_shown(value)}")
    for number, (item, one) in enumerate(zip(items, value, strict=False)):
        yield misfit(item, one, f"{where}[{number}]")


def _of_values(kind: Any, value: Mapping[object, object], where: str) -> Iterator[Misfit | None]:
    for key, one in value.items():
        yield misfit(typing.get_args(kind)[1], one, f"{where}.{key}")


def _is_list(value: object) -> typing.TypeGuard[Sequence[object]]:
    return isinstance(value, list | tuple)


def _fits(kind: Any, value: object) -> bool:
    """Whether a plain value fits; numbers that YAML reads as text, such as 3e-3, do."""
    if kind is bool or isinstance(value, bool):
        return kind is bool and isinstance(value, bool)
    if kind in (str, Path):
        return isinstance(value, str | Path)
    try:
        return isinstance(value, int | float | str) and kind(value) == float(value)
    except ValueError:
        return False


def _described(kind: Any) -> str:
    if typing.get_origin(kind) is Literal:
        *others, last = (f"`{one}`" for one in typing.get_args(kind))
        return f"{', '.join(others)} or {last}" if others else last
    if typing.get_origin(kind) is tuple:
        items = typing.get_args(kind)
        return "a list, as [a, b]" if items[-1] is Ellipsis else f"a list of {len(items)}"
    keyed = dataclasses.is_dataclass(kind) or typing.get_origin(kind) is dict
    return "`key: value` lines" if keyed else NAMES.get(kind, str(kind))


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
