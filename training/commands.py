"""The programs as commands of `rpl`: `rpl train`, `rpl evaluate`, `rpl predict` and `rpl reproduce`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from .masks.settings import OLD_NAMES

PROGRAMS = {
    "train": {"keypoints": "train_keypoints", "detector": "train_detector", "masks": "train_masks"},
    "evaluate": {"poses": "evaluate_pose", "masks": "evaluate_masks"},
    "predict": {"poses": "predict", "masks": "predict_masks"},
}
"""Modules by the names of their commands; the function of a program is called like its module."""


def main(group: str, arguments: Sequence[str], *, description: str) -> int:
    """Run a program; the exit status comes back.

    Args:
        group: `train`, `evaluate`, `predict` or `reproduce`.
        arguments: what follows it on the command line.
        description: what the group is for; heads its help.
    """
    from rpl_data.command_line import run

    from .runs.program import main as run_program

    if group == "reproduce":
        from .reproduce.__main__ import main as reproduce

        return reproduce(arguments, called="rpl reproduce")
    names = PROGRAMS[group]
    if not arguments or arguments[0] not in names:  # help, or a mistake
        run(functions_of(group), arguments, program=f"rpl {group}", description=description)
    command = arguments[0]
    return run_program(
        program_of(names[command]),
        arguments[1:],
        old_names=OLD_NAMES if names[command] == "train_masks" else {},
        presets=group == "train",
        called=f"rpl {group} {command}",
    )


def functions_of(group: str) -> dict[str, Callable[..., Any]]:
    """The functions of a group's programs, by the names of their commands."""
    if group == "reproduce":
        from .reproduce.__main__ import COMMANDS

        return dict(COMMANDS)
    return {command: program_of(name) for command, name in PROGRAMS[group].items()}


def presets() -> list[Callable[..., Any]]:
    """The programs whose options may also come from a YAML file, by `--config`."""
    return [*functions_of("train").values(), functions_of("reproduce")["table2"]]


def program_of(name: str) -> Callable[..., Any]:
    """The function of a program, by the name of its module."""
    function: Callable[..., Any] = getattr(import_module(f".{name}", __package__), name)
    return function
