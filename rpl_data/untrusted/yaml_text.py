"""YAML of others: every key once, and neither nested nor repeated so often that reading it never ends."""

from __future__ import annotations

from typing import Any

import yaml

from rpl_data.files import FAULTS
from rpl_data.types import DataError

LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Several times faster where PyYAML was built with libyaml; it knows no tags that run anything."""
DEEPEST = 100
"""Lists within lists; libyaml's own recursion ends the process at some ten thousand."""
MOST_REPEATED = 100_000
"""Values that aliases (`*name`) repeat; ten lines, each naming the one before ten times, stand for 10^10."""


class _OnceLoader(LOADER):  # type: ignore[misc]
    """YAML with every key once: of a key that is there twice, the first would be lost without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
        """The mapping; YAMLError naming the key that is there twice."""
        keys = [key for key, _ in node.value if isinstance(key.value, str)]
        seen: set[str] = set()
        for key in keys:
            if key.value in seen:
                raise _fault(f"key {key.value!r} is there twice", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_yaml(text: str, *, source: str) -> Any:
    """The content of a YAML text.

    Args:
        source: the file, for the error message.

    Raises:
        DataError: it is no YAML, has a key twice or a date that is none, or reading it might never end.
    """
    try:
        _refuse_endless(text)
        return yaml.load(text, _OnceLoader)
    except (yaml.YAMLError, *FAULTS) as error:
        raise DataError(f"{source} is not valid YAML: {' '.join(str(error).split())}; correct it") from error


def _refuse_endless(text: str) -> None:
    """Raise a YAMLError where lists are too deep or aliases repeat too much, before values are made."""
    sizes: dict[str | None, int] = {}
    repeated = 0
    inside: list[tuple[str | None, int]] = [(None, 0)]  # anchor and number of values of what is open
    for event in yaml.parse(text, LOADER):
        if isinstance(event, yaml.CollectionStartEvent):
            inside.append((event.anchor, 1))
            if len(inside) > DEEPEST:
                raise _fault("too deeply nested", event)
            continue
        anchor, size = None, 0
        if isinstance(event, yaml.ScalarEvent):
            anchor, size = event.anchor, 1
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor in (name for name, _ in inside):
                raise _fault("a value contains itself", event)
            size = sizes.get(event.anchor, 0)
            repeated += size
            if repeated > MOST_REPEATED:
                raise _fault("its aliases repeat too much", event)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, size = inside.pop()
        if anchor is not None:
            sizes[anchor] = size
        inside[-1] = inside[-1][0], inside[-1][1] + size


def _fault(problem: str, event: Any) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
