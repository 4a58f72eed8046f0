"""Wiring of `python -m training.reproduce`. What is heavy is imported inside the commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from ..runs.presets import with_preset_files
from ..runs.program import PROGRAMS, said
from .ablation.experiment import ablation
from .all_experiments import reproduce_all
from .curves.experiment import curves
from .segmentation.experiment import segmentation
from .table1.experiment import table1
from .table2.experiment import table2

HELP = "The paper's experiments: numbers beside the paper's, as JSON and as a page."
COMMANDS: dict[str, Any] = {
    "table1": table1,
    "table2": table2,
    "segmentation": segmentation,
    "curves": curves,
    "ablation": ablation,
    "all": reproduce_all,
}


def main(arguments: Sequence[str] | None = None, *, called: str | None = None) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it.

    Args:
        arguments: those of the command line when left out.
        called: how the person called it; as a module when left out.
    """
    from rpl_data.command_line import run

    given = sys.argv[1:] if arguments is None else arguments

    def work() -> None:
        told = with_preset_files(given)
        program = called or f"python -m {PROGRAMS}.reproduce"
        run(COMMANDS, told, program=program, description=HELP, presets=[table2])

    return said(work, name=called or "reproduce")


if __name__ == "__main__":
    sys.exit(main())
