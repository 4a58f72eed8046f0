"""Functions with docstrings -> a command line: one command per function, its docstring as its help."""

from __future__ import annotations

import inspect
import re
from argparse import SUPPRESS, Action, RawDescriptionHelpFormatter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from jsonargparse import ArgumentParser

from rpl_data.version import installed_version

Command = Callable[..., Any]
Commands = Mapping[str, Any]
"""A function by the name of its command; or more commands, with what they are for as `_help`."""


class Help(RawDescriptionHelpFormatter):
    """Help as it is written, with the default of an option behind its text."""

    def _get_help_string(self, action: Action) -> str:
        text = re.sub(r"%(?!\()", "%%", (action.help or "").rstrip("."))  # argparse would fill in each %
        quiet = action.default in (None, SUPPRESS, []) or action.default is False
        shown = action.option_strings and not quiet
        return f"{text} (default: {action.default})" if shown else text


def run(
    commands: Commands,
    arguments: Sequence[str] | None,
    *,
    program: str,
    description: str,
    presets: Collection[Command] = (),
) -> Any:
    """Parse the command line and call the function it names.

    Args:
        commands: functions by the names of their commands.
        arguments: those of the process when None.
        program: how the program is called.
        description: what it is for; heads its help.
        presets: the functions whose options may also come from a YAML file, by `--config`.
    """
    values = _parsed(
        parser_of(commands, program=program, description=description, presets=presets), arguments
    )
    function: Any = commands
    while isinstance(function, Mapping):
        name = values["subcommand"]
        function, values = function[name], values[name]
    return _called(function, values)


def parser_of(
    commands: Commands, *, program: str, description: str, presets: Collection[Command] = ()
) -> ArgumentParser:
    """The parser that `run` uses."""
    parser = ArgumentParser(prog=program, description=description, formatter_class=Help)
    parser.add_argument("--version", action="version", version=f"{program} {installed_version()}")
    _add_commands(parser, commands, presets)
    return parser


def run_one(
    function: Command, arguments: Sequence[str] | None, *, program: str, presets: Collection[Command] = ()
) -> Any:
    """Call the function with the options of the command line; `run` for a program with a single command."""
    parser = ArgumentParser(prog=program, description=help_of(function), formatter_class=Help)
    _add_options(parser, function, presets)
    return _called(function, _parsed(parser, arguments))


def _parsed(parser: ArgumentParser, arguments: Sequence[str] | None) -> Any:
    return parser.instantiate(parser.parse_args(None if arguments is None else list(arguments)))


def _called(function: Command, values: Any) -> Any:
    return function(**{name: values[name] for name in inspect.signature(function).parameters})


def _add_commands(parser: ArgumentParser, commands: Commands, presets: Collection[Command]) -> None:
    chosen = parser.add_subcommands(title="commands", metavar="COMMAND", required=True)
    for name, command in commands.items():
        if name == "_help":
            continue
        group = isinstance(command, Mapping)
        text = command["_help"] if group else help_of(command)
        below = ArgumentParser(description=text, formatter_class=Help)
        chosen.add_subcommand(name, below, help=text.split("\n")[0])
        if group:  # only after its parent knows it, or the parser loses its levels
            _add_commands(below, command, presets)
        else:
            _add_options(below, command, presets)


def _add_options(parser: ArgumentParser, function: Command, presets: Collection[Command]) -> None:
    if function in presets:
        parser.add_argument("--config", action="config", help="YAML file with options; those after it win")
    parser.add_function_arguments(function, as_group=False, as_positional=True, fail_untyped=True)
    _without_underscore(parser)


def _without_underscore(parser: ArgumentParser) -> None:
    """`from_` of a function, which Python would not let be called `from`, becomes the option `--from`."""
    for action in parser._actions:
        if action.dest.endswith("_"):
            option = f"--{action.dest[:-1]}"
            action.option_strings, action.metavar = [option], action.dest[:-1].upper()
            parser._option_string_actions[option] = action
            parser._positionals._group_actions.remove(action)  # where what must be given is listed
            parser._optionals._group_actions.append(action)


def help_of(function: Command) -> str:
    """The docstring of a function without the sections that describe its arguments."""
    return (inspect.getdoc(function) or "").split("\n\nArgs:")[0].rstrip()
