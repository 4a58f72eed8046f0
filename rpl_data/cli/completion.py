"""All commands in one parser, and the script by which a shell completes their names and options."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from jsonargparse import ArgumentParser

from rpl_data.cli.programs import PROGRAMS, commands_module
from rpl_data.command_line import parser_of


def completion_script(commands: Mapping[str, Any], shell: str) -> str:
    """The script for a shell, `bash` or `zsh`."""
    import shtab

    script: str = shtab.complete(whole_parser(commands)[1], shell)
    return script


def whole_parser(commands: Mapping[str, Any]) -> tuple[dict[str, Any], ArgumentParser]:
    """The commands together with those of the training programs, and one parser of them all."""
    training = import_module(commands_module())
    groups = {group: {"_help": PROGRAMS[group], **training.functions_of(group)} for group in PROGRAMS}
    every = {**commands, **groups}
    return every, parser_of(every, program="rpl", description="", presets=training.presets())
