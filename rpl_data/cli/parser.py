"""Functions with docstrings -> a command line: one command per function, its docstring as its help."""

from __future__ import annotations

import inspect
from argparse import SUPPRESS, Action, RawDescriptionHelpFormatter
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

from jsonargparse import ArgumentParser

Commands = Mapping[str, Any]
"""A function by the name of its command; or more commands, with what they are for as `_help`."""


class Help(RawDescriptionHelpFormatter):
    """Help as it is written, with the default of an option behind its text."""

    def _get_help_string(self, action: Action) -> str:
        text = (action.help or "").rstrip(".")
        shown = action.option_strings and action.default not in (None, SUPPRESS, False)
        return f"{text} (default: {action.default})" if shown else text


def run(commands: Commands, arguments: Sequence[str] | None, *, program: str, description: str) -> Any:
    """Parse the command line and call the function it names.

    Args:
        arguments: those of the process when None.
        program: how the program is called.
        description: what it is for; heads its help.
    """
    parser = ArgumentParser(prog=program, description=description, formatter_class=Help)
    parser.add_argument("--version", action="version", version=f"{program} {version('rpl-data')}")
    _add_commands(parser, commands)
    chosen = parser.parse_args(None if arguments is None else list(arguments))
    values = parser.instantiate(chosen)
    function: Any = commands
    while isinstance(function, Mapping):
        name = values["subcommand"]
        function, values = function[name], values[name]
    return function(**{name: values[name] for name in inspect.signature(function).parameters})


def _add_commands(parser: ArgumentParser, commands: Commands) -> None:
    chosen = parser.add_subcommands(title="commands", metavar="COMMAND", required=True)
    for name, command in commands.items():
        if name == "_help":
            continue
        group = isinstance(command, Mapping)
        text = command["_help"] if group else help_of(command)
        below = ArgumentParser(description=text, formatter_class=Help)
        chosen.add_subcommand(name, below, help=text.split("\n")[0])
        if group:  # only after its parent knows it, or the parser loses its levels
            _add_commands(below, command)
        else:
            below.add_function_arguments(command, as_group=False, as_positional=True, fail_untyped=True)


def help_of(function: Callable[..., object]) -> str:
    """The docstring of a function without the sections that describe its arguments."""
    return (inspect.getdoc(function) or "").split("\n\nArgs:")[0].rstrip()
