"""All commands in one parser, and the script by which a shell completes their names and options."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from jsonargparse import ArgumentParser

from rpl_data.cli.programs import PROGRAMS, commands_module
from rpl_data.command_line import parser_of


def completion_script(commands: Mapping[str, Any], shell: str) -> str:
    """The script for a shell, `bash` or `zsh`."""
    import shtab

    parser = whole_parser(commands)[1]
    _offer_choices(parser)
    script: str = shtab.complete(parser, shell)
    return script


def _offer_choices(parser: ArgumentParser) -> None:
    """Give options whose type names their values these as choices, in all commands."""
    for action in parser._actions:
        if isinstance(action.choices, Mapping):
            for command in action.choices.values():
                _offer_choices(command)
        elif action.choices is None and (values := _fixed_values(getattr(action, "_typehint", None))):
            action.choices = values


def _fixed_values(hint: Any) -> list[str]:
    """The values of `Literal[...]`, also where it is one of several types."""
    if get_origin(hint) is Literal:
        return [str(value) for value in get_args(hint)]
    union = get_origin(hint) in (Union, UnionType)
    return [value for part in get_args(hint) for value in _fixed_values(part)] if union else []


def whole_parser(commands: Mapping[str, Any]) -> tuple[dict[str, Any], ArgumentParser]:
    """The commands together with those of the training programs, and one parser of them all."""
    training = import_module(commands_module())
    groups = {group: {"_help": PROGRAMS[group], **training.functions_of(group)} for group in PROGRAMS}
    every = {**commands, **groups}
    return every, parser_of(every, program="rpl", description="", presets=training.presets())
