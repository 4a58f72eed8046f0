"""Option names of version 0.1: they are still understood, with a hint at the new ones."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from rpl_data.types import DataError


def with_new_names(path: Path, names: Mapping[str, str]) -> dict[str, Any]:
    """The options of a YAML file by their new names; a hint is printed where old ones were found.

    Args:
        path: the file.
        names: new names by old ones, both dotted: {"settings.rate": "learning.rate"}.

    Raises:
        DataError: the file is missing, or holds no options.
    """
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise DataError(f"cannot read the options in {path}: {error}") from error
    if not isinstance(values, dict):
        raise DataError(f"{path} holds no options; expected lines such as `learning: {{epochs: 20}}`")
    renamed, replaced = _renamed(values, names)
    if replaced:
        hints = ", ".join(f"{old} is now {new}" for old, new in replaced.items())
        print(f"hint: {path} has names of version 0.1: {hints}", file=sys.stderr)
    return renamed


def arguments_with_new_names(arguments: Sequence[str], names: Mapping[str, str]) -> list[str]:
    """Command line arguments with new names, and the files after --config as text where names changed.

    Raises:
        DataError: a file after --config is missing, or holds no options.
    """
    translated: list[str] = []
    for argument in arguments:
        flag, equals, value = argument.partition("=")
        if flag == "--config" and equals:
            translated.append(f"--config={_config(value, names)}")
        elif translated and translated[-1] == "--config":
            translated.append(_config(argument, names))
        elif flag.startswith("--") and (new := _new_name(flag[2:], names)):
            print(f"hint: {flag} is now --{new}", file=sys.stderr)
            translated.append(f"--{new}{equals}{value}")
        else:
            translated.append(argument)
    return translated


def _config(value: str, names: Mapping[str, str]) -> str:
    """What to give --config: the text of the file where it exists, so that no name in it is an old one."""
    if not names or not Path(value).is_file():
        return value  # the parser reports what is missing
    return yaml.safe_dump(with_new_names(Path(value), names), default_flow_style=True, width=sys.maxsize)


def _renamed(
    values: Mapping[str, Any], names: Mapping[str, str], prefix: str = ""
) -> tuple[dict[str, Any], dict[str, str]]:
    """Nested options by their new names, and the old names that were found with their new ones."""
    renamed: dict[str, Any] = {}
    replaced: dict[str, str] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        if name in names:
            replaced[name] = names[name]
            _put(renamed, names[name], value)
        elif isinstance(value, Mapping) and any(old.startswith(f"{name}.") for old in names):
            deeper, more = _renamed(value, names, f"{name}.")
            replaced |= more
            for each, inner in _leaves(deeper):
                _put(renamed, each, inner)
        else:
            _put(renamed, name, value)
    return renamed, replaced


def _leaves(values: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Nested options as dotted names and values."""
    found: list[tuple[str, Any]] = []
    for key, value in values.items():
        inner = _leaves(value) if isinstance(value, Mapping) else []
        found += [(f"{key}.{name}", each) for name, each in inner] or [(str(key), value)]
    return found


def _put(values: dict[str, Any], name: str, value: Any) -> None:
    """Set an option by its dotted name; a group joins what is there."""
    *groups, last = name.split(".")
    for group in groups:
        values = values.setdefault(group, {})
    if isinstance(value, Mapping) and isinstance(values.get(last), dict):
        values[last] |= value
    else:
        values[last] = dict(value) if isinstance(value, Mapping) else value


def _new_name(name: str, names: Mapping[str, str]) -> str | None:
    """The new name of an option, also where its group was renamed; None where it is not an old one."""
    for old, new in names.items():
        if name == old or name.startswith(f"{old}."):
            return new + name[len(old) :]
    return None
