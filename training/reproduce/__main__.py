"""Wiring of `python -m training.reproduce`. What is heavy is imported inside the commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from .all_experiments import reproduce_all
from .commands import EXPERIMENTS, run_command

COMMANDS: dict[str, Any] = {**EXPERIMENTS, "all": reproduce_all}


def main(arguments: Sequence[str] | None = None, *, called: str | None = None) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it.

    Args:
        arguments: those of the command line when left out.
        called: how the person called it; as a module when left out.
    """
    return run_command(sys.argv[1:] if arguments is None else arguments, COMMANDS, called=called)


if __name__ == "__main__":
    sys.exit(main())
