"""Run all benchmarks one after the other, each in a process of its own, and print all figures at the end.

    python tests/bench/whole.py KEPT.json [NAME ...]

NAME is that of a benchmark without `bench_` and `.py`; all where none is named. What a benchmark prints goes
to the terminal; between them stands which comes next and how long the last took. One that fails is named at
the end, and the others are run and kept all the same. `RPL_BENCH_SHARE` says which share of their repetitions
those take that have many (1 is all).
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from rows import record, table

HERE = Path(__file__).parent
PYTEST = ["-m", "pytest", "-s", "-q", "-o", "addopts=", "-o", "python_files=bench_*.py"]
"""Benchmarks that share the fixtures of the tests are tests themselves."""


def command(program: Path) -> list[str]:
    """How a benchmark is run."""
    words = PYTEST if "\ndef test_" in program.read_text(encoding="utf-8") else []
    return [sys.executable, *words, str(program)]


def chosen(names: list[str]) -> list[Path]:
    """The programs of these names, or all; exit where there is none of a name."""
    programs = {path.stem.removeprefix("bench_"): path for path in sorted(HERE.glob("bench_*.py"))}
    if unknown := set(names) - programs.keys():
        sys.exit(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(programs)}")
    return [program for name, program in programs.items() if name in names or not names]


def cpu_of_children_s() -> float:
    """CPU seconds of the benchmarks that have ended, and of all that they started and waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(kept: Path, names: list[str]) -> None:
    """Run them, print the table, and exit with 1 if one failed."""
    rows = kept.with_suffix(".rows")
    kept.parent.mkdir(parents=True, exist_ok=True)
    rows.unlink(missing_ok=True)
    os.environ |= {"RPL_BENCH_ROWS": str(rows.resolve()), "PYTHONPATH": str(HERE.parents[1])}
    failed, programs, began = [], chosen(names), time.perf_counter()
    for number, program in enumerate(programs, start=1):
        name, started, cpu_s = program.stem.removeprefix("bench_"), time.perf_counter(), cpu_of_children_s()
        print(f"\n== {number} of {len(programs)}: {name}", flush=True)
        status = subprocess.run(command(program), cwd=HERE.parents[1]).returncode
        seconds, cpu_s = time.perf_counter() - started, cpu_of_children_s() - cpu_s
        record("whole", name, cpu_s, "s CPU")
        failed += [name] if status else []
        print(
            f"== {name} {'FAILED' if status else 'done'} in {seconds:.0f} s ({cpu_s:.0f} s of CPU)",
            flush=True,
        )
    print(f"\n== all in {(time.perf_counter() - began) / 60:.0f} minutes", flush=True)
    table(rows, kept)
    rows.unlink(missing_ok=True)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; their rows may be missing")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
