"""`rpl train`, `rpl evaluate`, `rpl predict`, `rpl reproduce`: the way to the programs of `training/`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

PROGRAMS = {
    "train": "Train a network on an export: keypoints, detector or masks.",
    "evaluate": "Score trained networks on a split of an export: poses or masks.",
    "predict": "Run trained networks on images: poses or masks.",
    "reproduce": "The paper's experiments: numbers beside the paper's, as JSON and as a page.",
}
"""What they are for, by the names of their commands. Each has a parser of its own, so that help is quick."""

CHECKOUT = Path(__file__).parents[2]
"""The folder that holds `rpl_data`: that of a checkout, or where packages are installed."""


def run_program(arguments: Sequence[str]) -> int:
    """Run the program that the arguments name; the exit status comes back."""
    group = arguments[0]
    status: int = import_module(commands_module()).main(group, arguments[1:], description=PROGRAMS[group])
    return status


def commands_module() -> str:
    """Name of the module that runs the programs: of this checkout, or installed with `rpl_data`."""
    if not (CHECKOUT / "pyproject.toml").is_file():
        return "rpl_data.training.commands"
    if str(CHECKOUT) not in sys.path:  # processes that are started from here get the same path
        sys.path.insert(0, str(CHECKOUT))
    return "training.commands"
