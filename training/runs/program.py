"""The entry point of `python -m training.<program>`: options from the command line, mistakes in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

from rpl_data.types import DataError
from rpl_data.wording import counted
from training.runs.old_names import arguments_with_new_names

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def main(
    program: Callable[..., object],
    arguments: Sequence[str] | None = None,
    *,
    old_names: Mapping[str, str] = {},  # noqa: B006 (never changed)
    presets: bool = False,
) -> int:
    """Run a program; the exit status comes back, 1 with one line on stderr when the user can mend it.

    Args:
        program: its signature and docstring are the options and the help.
        arguments: those of the command line when left out.
        old_names: new names of options by the old ones that are still understood.
        presets: whether options may also come from a YAML file, by `--config`.
    """
    from rpl_data.command_line import run_one

    try:
        given = sys.argv[1:] if arguments is None else arguments
        run_one(
            program,
            arguments_with_new_names(given, old_names),
            program=f"python -m training.{program.__name__}",
            presets=[program] if presets else (),
        )
    except DataError as error:
        print(f"{program.__name__}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{program.__name__}: interrupted", file=sys.stderr)
        return INTERRUPTED
    return 0


def use_threads(threads: int | None) -> None:
    """Let torch use so many processor threads; None leaves the number to torch."""
    import torch

    if threads is not None:
        torch.set_num_threads(threads)


def say_left_out(unreadable: Mapping[str, int]) -> None:
    """One line per reason why images were left out."""
    for message, count in sorted(unreadable.items()):
        print(f"left out {counted(count, 'time')}: {message}")
