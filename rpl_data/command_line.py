"""Functions with docstrings -> a command line: one command per function, its docstring as its help."""

from __future__ import annotations

import inspect
import json
import re
import sys
from argparse import SUPPRESS, Action, RawDescriptionHelpFormatter
from collections.abc import Callable, Collection, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Literal, NoReturn, get_args, get_origin

from jsonargparse import ArgumentParser

from rpl_data.version import installed_version

Command = Callable[..., Any]
Commands = Mapping[str, Any]
"""A function by the name of its command; or more commands, with what they are for as `_help`.

A text instead stands for a command that another parser reads: it is only listed, with that text.
"""


class Help(RawDescriptionHelpFormatter):
    """Help as it is written, with the default of an option behind its text."""

    def _get_help_string(self, action: Action) -> str:
        text = re.sub(r"%(?!\()", "%%", (action.help or "").rstrip("."))  # argparse would fill in each %
        quiet = action.default in (None, SUPPRESS, []) or action.default is False
        shown = action.option_strings and not quiet
        return f"{text} (default: {action.default})" if shown else text


class Parser(ArgumentParser):
    """A parser that says a mistake in one line, with what was probably meant."""

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Print one line and exit with status 2."""
        parser = getattr(ex, "subcommand_parser", None) or self
        said = one_line(message, [name for action in parser._actions for name in action.option_strings])
        program = parser.prog.replace(" [options]", "")
        if found := re.search(r"are required: ([\w.]+)[.]", message):  # the parser above says it
            program = f"{program} {found[1].replace('.', ' ')}"
        see = " See" if said.endswith("?") else "; see"
        print(f"{program}: {said}{see} `{program} --help`", file=sys.stderr)
        sys.exit(2)


def one_line(message: str, options: Sequence[str]) -> str:
    """What the parser has to say of a mistake, in one line; the nearest name for one that is not known.

    Args:
        message: of argparse or jsonargparse.
        options: those that there are.
    """
    if found := re.search(r"argument COMMAND: invalid choice: '(.*)' \(choose from (.*)\)", message):
        known = re.findall(r"'([^']+)'", found[2])
        meant = _meant(found[1], known, alike=0.7)
        return f"there is no command {found[1]!r}{meant or f'; there are {found[2]}'}"
    if found := re.match(r"unrecognized arguments: (.*)", message):
        given = [word.split("=")[0] for word in found[1].split() if word.startswith("--")]
        if not given:
            return f"too many arguments: {found[1]}"
        return ", ".join(f"there is no option {name}{_meant(name, options)}" for name in given)
    if "subcommand" in message:
        return "a command is missing"
    if found := re.match(r'Parser key "([\w.]+)":.*(?:<class |Literal\[).*valu?e: (.*)', message, re.DOTALL):
        return f"--{found[1]}: expected {_expected(message.split('Given')[0])}, found {found[2]!r}"
    if message.startswith("the following arguments are required: "):
        name = re.sub(r"[^ ]*[.]", "", message.split(": ")[1])
        return f"--{name[:-1]} is missing" if name.endswith("_") else f"{name} is missing"
    return " ".join(re.sub(r'Parser key "([\w.]+)":', r"--\1:", message).split())


def _expected(types: str) -> str:
    """What an option takes, in words, of what jsonargparse says of its type."""
    kinds = [kind for kind in dict.fromkeys(re.findall(r"<class '(\w+)'>", types)) if kind in VALUES]
    words = re.findall(r"'([^']+)'", "".join(re.findall(r"Literal\[(.*?)\]", types)))
    if not kinds and not words and re.search(r"<class '(list|tuple)'>", types):
        return "a list in brackets, '[one, another]'"
    return " or ".join(dict.fromkeys([*kinds, *words])) or "another form"


VALUES = ("int", "float", "bool", "str")
"""Types that a person can write on a command line."""


def _meant(name: str, known: Sequence[str], *, alike: float = 0.6) -> str:
    """The known name most like another one; an option may have been named without its group."""
    near = get_close_matches(name, known, 1, alike)
    if not near:
        by_end = {option.split(".")[-1]: option for option in known if "." in option}
        near = [by_end[end] for end in get_close_matches(name.lstrip("-").split(".")[-1], by_end, 1, 0.7)]
    return f"; did you mean {near[0]}?" if near else ""


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
    parser = Parser(prog=program, description=description, formatter_class=Help)
    parser.add_argument("--version", action="version", version=f"{program} {installed_version()}")
    _add_commands(parser, commands, presets)
    return parser


def run_one(
    function: Command, arguments: Sequence[str] | None, *, program: str, presets: Collection[Command] = ()
) -> Any:
    """Call the function with the options of the command line; `run` for a program with a single command."""
    parser = Parser(prog=program, description=help_of(function), formatter_class=Help)
    _add_options(parser, function, presets)
    return _called(function, _parsed(parser, arguments))


def _parsed(parser: ArgumentParser, arguments: Sequence[str] | None) -> Any:
    given = sys.argv[1:] if arguments is None else list(arguments)
    return parser.instantiate(parser.parse_args(as_spelt(parser, given)))


def as_spelt(parser: ArgumentParser, arguments: Sequence[str]) -> list[str]:
    """Arguments as the parser knows them.

    `--again` alone, of an option that is true or false, stands for `--again true`; `--min-quality` for
    `--min_quality`. Names keep their zeros: `--scenes '[00, 05]'` and `--scenes 00`.
    """
    told: list[str] = []
    for number, word in enumerate(arguments):
        below = next((action.choices for action in parser._actions if action.dest == "subcommand"), None)
        if isinstance(below, Mapping) and word in below:
            parser = below[word]
        known = parser._option_string_actions
        name, is_one, value = word.partition("=")
        underscored = "--" + name[2:].replace("-", "_")
        if name.startswith("--") and name not in known and underscored in known:
            name, word = underscored, underscored + is_one + value
        if is_one and _takes_names(known.get(name)):
            word = f"{name}={_names_in(value)}"
        elif told and _takes_names(known.get(told[-1])):
            word = _names_in(word)
        told.append(word)
        following = arguments[number + 1] if number + 1 < len(arguments) else ""
        action = known.get(word)
        if (values := _switch_values(action)) and following.lower() not in values:
            told.append("true")
    return told


def _switch_values(action: Action | None) -> tuple[str, ...]:
    """What may follow an option that is true or false, or either of them or a word; empty for any other."""
    if getattr(action, "metavar", None) == SWITCH:
        return SWITCHED
    kinds = get_args(getattr(action, "_typehint", None))
    if bool not in kinds or not all(kind is bool or get_origin(kind) is Literal for kind in kinds):
        return ()
    return (*SWITCHED, *(word for kind in kinds for word in get_args(kind)))


def _takes_names(action: Action | None) -> bool:
    """Whether an option takes a list of names."""
    hint = getattr(action, "_typehint", None)
    return tuple[str, ...] in (hint, *get_args(hint))


def _names_in(value: str) -> str:
    """A list of names as JSON, in which YAML takes none of them for a number; any other value as it is."""
    if re.fullmatch(r"\[[^\[\]{}]*\]", value):
        names = [name.strip() for name in value[1:-1].split(",") if name.strip()]
    elif re.fullmatch(r"0\d+|[^\d\W][\w.-]*", value) and value.lower() not in ("null", "none"):
        names = [value]
    else:
        return value
    return f"[{', '.join(name if name[0] in QUOTES else json.dumps(name) for name in names)}]"


QUOTES = ("'", '"')

SWITCH = "{true,false}"
"""How jsonargparse shows what an option takes that is true or false."""
SWITCHED = ("true", "false", "yes", "no")
"""Values that may follow such an option."""


def _called(function: Command, values: Any) -> Any:
    return function(**{name: values[name] for name in inspect.signature(function).parameters})


def _add_commands(parser: ArgumentParser, commands: Commands, presets: Collection[Command]) -> None:
    chosen = parser.add_subcommands(title="commands", metavar="COMMAND", required=True)
    for name, command in commands.items():
        if name == "_help":
            continue
        group, listed = isinstance(command, Mapping), isinstance(command, str)
        text = command["_help"] if group else command if listed else help_of(command)
        below = Parser(description=text, formatter_class=Help)
        chosen.add_subcommand(name, below, help=text.split("\n")[0])
        if group:  # only after its parent knows it, or the parser loses its levels
            _add_commands(below, command, presets)
        elif not listed:
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
