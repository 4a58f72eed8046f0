"""What `python -m training.<program>` does: options from the command line, mistakes in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from rpl_data.types import DataError


def main(program: Callable[..., object], arguments: Sequence[str] | None = None) -> int:
    """Run a program; 1 with one line on stderr when the user can mend it."""
    from jsonargparse import auto_cli

    try:
        auto_cli(
            program,
            args=None if arguments is None else list(arguments),
            prog=f"python -m training.{program.__name__}",
        )
    except DataError as error:
        print(f"{program.__name__}: {error}", file=sys.stderr)
        return 1
    return 0
