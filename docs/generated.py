"""Pages of the site that are made of the code: commands with their options, exports with their layouts."""

from __future__ import annotations

import inspect
import re
import textwrap
from argparse import SUPPRESS, Action
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

HEAD = """# Commands

Every command of `rpl` with every option. `rpl COMMAND --help` prints the same in a terminal. What stands in
capital letters is to be filled in; arguments without dashes are given in the order shown.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Called by mkdocs: add the pages that are made here."""
    files.append(File.generated(config, "commands.md", content=commands_page()))
    files.append(File.generated(config, "dialects.md", content=dialects_page()))
    return files


def commands_page() -> str:
    """The page of all commands, as Markdown."""
    return HEAD + "".join(section(words, parser) for words, parser in parsers())


def dialects_page() -> str:
    """The page of all export formats: what the modules that write them say of themselves."""
    from rpl_data.pipeline.stages.export import EXPORTS

    modules = {name: import_module(f"rpl_data.export.{name}") for name in EXPORTS}
    sections = [
        f"\n## {name}\n\n{with_blocks(inspect.getdoc(module) or '')}\n" for name, module in modules.items()
    ]
    return "# Formats, file by file\n" + "".join(sections)


def with_blocks(text: str) -> str:
    """A docstring as Markdown: what is indented after `::` becomes a block of code."""

    def block(found: re.Match[str]) -> str:
        return f"```\n{textwrap.dedent(found[1]).strip()}\n```\n\n"

    return re.sub(r"^::\n\n((?:^(?: {4}.*)?\n)+)", block, text, flags=re.M)


def parsers() -> Iterator[tuple[str, Any]]:
    """The name of every command and its parser, in the order of `rpl --help`."""
    from rpl_data.cli.completion import whole_parser
    from rpl_data.cli.main import COMMANDS

    yield from leaves(*whole_parser(COMMANDS))


def leaves(commands: Mapping[str, Any], parser: Any, above: str = "rpl") -> Iterator[tuple[str, Any]]:
    """The commands below a parser that have no commands below them."""
    choices = next(action for action in parser._actions if action.dest == "subcommand").choices
    for name, command in commands.items():
        if isinstance(command, Mapping):
            yield from leaves(command, choices[name], f"{above} {name}")
        elif name != "_help":
            yield f"{above} {name}", choices[name]


def section(words: str, parser: Any) -> str:
    """A command: what it does, and a table of its options."""
    options = [action for action in parser._actions if is_shown(action)]
    rows = "".join(f"| {named(action)} | {described(action)} | {default(action)} |\n" for action in options)
    table = f"\n| option | what it is | when left out |\n|---|---|---|\n{rows}" if rows else ""
    return f"\n## {words}\n\n{with_code(parser.description or '')}\n{table}"


def is_shown(action: Action) -> bool:
    """Whether a person may want to know an option; each command has `--help`."""
    return action.dest != "help" and action.help != SUPPRESS and not action.dest.endswith(".help")


def named(action: Action) -> str:
    """How an option is written."""
    return f"`{action.option_strings[0]}`" if action.option_strings else f"`{action.metavar or action.dest}`"


def described(action: Action) -> str:
    """The help of an option, on one line."""
    choices = ", ".join(f"`{choice}`" for choice in action.choices or [])
    text = " ".join((action.help or "").split()).rstrip(".").replace("|", "\\|").replace("<", "&lt;")
    return f"{text}{'; ' if text and choices else ''}{choices}"


def default(action: Action) -> str:
    """What an option is when it is left out."""
    if action.required:
        return "must be given"
    quiet = action.default is None or action.default is SUPPRESS or action.default in ([], {}, False)
    return "" if quiet else f"`{action.default}`"


def with_code(text: str) -> str:
    """A docstring as Markdown: its indented blocks and its example become blocks of code."""

    def block(found: re.Match[str]) -> str:
        return f"```yaml\n{textwrap.dedent(found[1]).rstrip()}\n```\n"

    text = re.sub(r"^Example: (.*)$", r"```console\n\1\n```", text, flags=re.M)
    return re.sub(r"((?:^  +\S.*\n?(?:^\n(?=  ))?)+)", block, text, flags=re.M)
