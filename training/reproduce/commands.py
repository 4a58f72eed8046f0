"""The experiments by the names of their commands. What is heavy is imported inside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..runs.presets import with_preset_files
from ..runs.program import PROGRAMS, said
from .ablation.experiment import ablation
from .curves.experiment import curves
from .segmentation.experiment import segmentation
from .table1.experiment import table1
from .table2.experiment import table2

HELP = "The paper's experiments: numbers beside the paper's, as JSON and as a page."
EXPERIMENTS: dict[str, Any] = {
    "table1": table1,
    "table2": table2,
    "segmentation": segmentation,
    "curves": curves,
    "ablation": ablation,
}


def run_command(
    arguments: Sequence[str], commands: Mapping[str, Any] = EXPERIMENTS, *, called: str | None = None
) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it.

    Args:
        commands: those that there are.
        called: how the person called it; as a module when left out.
    """
    from rpl_data.command_line import run

    def work() -> None:
        told = with_preset_files(arguments)
        program = called or f"python -m {PROGRAMS}.reproduce"
        run(dict(commands), told, program=program, description=HELP, presets=[table2])

    return said(work, name=called or "reproduce")
