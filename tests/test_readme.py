"""The README's `bash` blocks run; `console` blocks, there and in docs/, parse; what they name is there."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rpl_data.cli.main import COMMANDS
from training.commands import PROGRAMS
from training.commands import program_of as function_of
from training.reproduce.__main__ import COMMANDS as EXPERIMENTS
from training.reproduce.table2.experiment import table2
from training.runs.presets import with_preset_files

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
PAGES = "\n".join(path.read_text() for path in sorted(ROOT.glob("docs/*.md")))


def commands(language: str, text: str = README) -> list[str]:
    """The lines of all blocks of that language, without comments."""
    blocks = re.findall(rf"^ *```{language}\n(.*?)^ *```", text, re.M | re.S)
    lines = [line.split("#")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


@pytest.mark.parametrize("line", commands("bash"))
def test_bash_blocks_run(line: str) -> None:
    words = shlex.split(line)
    if words[0] == "make":  # `make test` would run itself; that the target is there is all that can be said
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.M)
        return
    installed = str(Path(sys.executable).parent / "rpl")
    line = line.replace(".venv/bin/rpl", shlex.quote(installed))
    subprocess.run(["bash", "-euo", "pipefail", "-c", line], cwd=ROOT, check=True, capture_output=True)


@pytest.mark.parametrize("line", dict.fromkeys(commands("console", README + "\n" + PAGES)))
def test_console_blocks_parse(line: str) -> None:
    from jsonargparse import auto_parser

    from rpl_data.command_line import as_spelt, parser_of

    words = shlex.split(line)
    if words[0] == "pip":
        assert words[1] == "install"
        return
    assert words[0] == "rpl"
    program, arguments = program_of(words[1:])
    if isinstance(program, dict):
        parser = parser_of(program, program="rpl", description="", presets=[table2])
    else:
        parser = auto_parser(program)
    parser.exit_on_error = False
    parsed = parser.parse_args(as_spelt(parser, with_preset_files(arguments)))
    assert not isinstance(program, dict) or parsed.subcommand in program


def program_of(words: list[str]) -> tuple[Any, list[str]]:
    """What `rpl` hands its arguments to: a function, or functions by their names; and the arguments."""
    if words[0] == "reproduce":
        return EXPERIMENTS, words[1:]
    if words[0] in PROGRAMS:
        return function_of(PROGRAMS[words[0]][words[1]]), words[2:]
    return COMMANDS, words


def test_there_are_blocks_of_both_kinds() -> None:
    assert {"make demo", "make test"} <= set(commands("bash"))
    assert len(commands("console")) >= 4


def test_links_lead_somewhere() -> None:
    named = re.findall(r"\]\((?!https:)([^)#]+)\)", README) + re.findall(
        r"`((?:datasets|docs)/[^`]+)`", README
    )
    assert named
    assert all((ROOT / name).exists() for name in [*named, "LICENSE", "CHANGELOG.md"])


def test_the_package_describes_itself_without_links_into_the_checkout() -> None:
    packaged = runpy.run_path(str(ROOT / "setup.py"))["packaged"](README)
    assert re.findall(r"\]\((?!https:|#)", packaged) == [] and "`docs/recording.md`" in packaged
    pages = set(re.findall(r"docs/\w+\.md", README))
    assert pages == set(re.findall(r"docs/\w+\.md", packaged)), "and names every page"
