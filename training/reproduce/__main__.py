"""Wiring of `python -m training.reproduce`. What is heavy is imported inside the commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from rpl_data.types import DataError
from training.reproduce.ablation.experiment import ablation
from training.reproduce.curves.experiment import curves
from training.reproduce.segmentation.experiment import segmentation
from training.reproduce.table1.experiment import table1
from training.reproduce.table2.experiment import table2

HELP = "The paper's experiments: numbers beside the paper's, as JSON and as a page."
COMMANDS: dict[str, Any] = {
    "table1": table1,
    "table2": table2,
    "segmentation": segmentation,
    "curves": curves,
    "ablation": ablation,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; 0 when all is well, 1 with one line on stderr when the user can mend it."""
    from rpl_data.command_line import run

    try:
        run(COMMANDS, arguments, program="python -m training.reproduce", description=HELP, presets=[table2])
    except DataError as error:
        print(f"reproduce: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
