"""The entry point of the programs: options from the command line, mistakes in one line."""

from __future__ import annotations

import inspect
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from rpl_data.types import DataError
from rpl_data.wording import counted

from .old_names import arguments_with_new_names
from .presets import with_preset_files

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

PROGRAMS = __name__.removesuffix(".runs.program")
"""The package of the programs: `training` in a checkout, `rpl_data.training` where it is installed."""

EXTRA = "pip install 'rpl-data[training]'"
"""How to get what only the programs need."""


def main(
    program: Callable[..., object],
    arguments: Sequence[str] | None = None,
    *,
    old_names: Mapping[str, str] = {},  # noqa: B006 (never changed)
    presets: bool = False,
    called: str | None = None,
) -> int:
    """Run a program; the exit status comes back, 1 with one line on stderr when the user can mend it.

    Args:
        program: its signature and docstring are the options and the help.
        arguments: those of the command line when left out.
        old_names: new names of options by the old ones that are still understood.
        presets: whether options may also come from a YAML file, by `--config`.
        called: how the person called it; as a module when left out.
    """
    from rpl_data.command_line import run_one

    name = called or program.__name__
    given = sys.argv[1:] if arguments is None else arguments

    def work() -> None:
        told = with_preset_files(given) if presets else given
        run_one(
            program,
            arguments_with_new_names(told, old_names),
            program=called or f"python -m {PROGRAMS}.{name}",
            presets=[program] if presets else (),
        )

    return said(work, name=name, resumes="resume" in inspect.signature(program).parameters)


def said(work: Callable[[], object], *, name: str, resumes: bool = False) -> int:
    """Do the work and say in one line what the user can mend; the exit status comes back.

    Args:
        work: what is done.
        name: of the program; begins the line.
        resumes: whether the program goes on with an earlier run by `--resume true`.
    """
    try:
        work()
    except DataError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        if error.name != "pytorch_lightning":
            raise
        print(f"{name}: PyTorch Lightning is not installed; {EXTRA}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        again = ", with --resume true where an epoch was finished" if resumes else ""
        print(f"{name}: interrupted; give the same command again{again}", file=sys.stderr)
        return INTERRUPTED
    return 0


def use_threads(threads: int | None) -> None:
    """Let torch use so many processor threads; None leaves the number to torch.

    Raises:
        DataError: it is less than 1.
    """
    import torch

    if threads is not None and threads < 1:
        raise DataError(f"--threads is {threads}; give 1 or more")

    if threads is not None:
        torch.set_num_threads(threads)


def reasons(why: Iterable[str]) -> str:
    """Reasons with how often each was given, the most frequent first: "too few keypoints (18), ..."."""
    return ", ".join(f"{each} ({count})" for each, count in Counter(why).most_common())


def say_left_out(unreadable: Mapping[str, int]) -> None:
    """One line per reason why images were left out."""
    for message, count in sorted(unreadable.items()):
        print(f"left out {counted(count, 'time')}: {message}")
