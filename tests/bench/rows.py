"""Rows of a run of the benchmarks: each a figure beside its named baseline; kept as JSON, printed, compared.

A benchmark calls `record` for every figure. Its rows go to the file that RPL_BENCH_ROWS names, a JSON object
per line; without it they are only returned. Then

    python tests/bench/rows.py table ROWS KEPT.json     prints all rows and keeps them with machine and commit
    python tests/bench/rows.py compare A.json B.json    says what became slower or faster from A to B
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

PACKAGES = ("numpy", "scipy", "opencv-python-headless", "open3d", "torch", "numba", "orjson")
USUAL_SPREAD = 0.15
"""Of a time that was measured once, as a share of it."""


def shared(whole: int, *, least: int = 1) -> int:
    """Of so many repetitions the share that RPL_BENCH_SHARE names, all without it."""
    return max(min(whole, least), round(whole * float(os.environ.get("RPL_BENCH_SHARE", "1"))))


@dataclass(frozen=True)
class Row:
    """A figure.

    Attributes:
        bench: the program that measured it.
        work: what was done; with `bench` it names the row in every run.
        value, unit: the figure, the median where it was measured several times.
        baseline: what it is compared with in the same run, in words; none where it stands alone.
        ratio: how many times better than the baseline it is.
        asked: the ratio that is aimed at; the value where there is no baseline.
        more_is_better: of the value; so a rate, not a time.
        spread: half the range between the quartiles of the repetitions, as a share of the median.
    """

    bench: str
    work: str
    value: float
    unit: str
    baseline: str | None = None
    baseline_value: float | None = None
    ratio: float | None = None
    asked: float | None = None
    more_is_better: bool = False
    spread: float = USUAL_SPREAD


def record(
    bench: str,
    work: str,
    values: float | Sequence[float],
    unit: str,
    *,
    baseline: tuple[str, float] | None = None,
    asked: float | None = None,
    more_is_better: bool = False,
) -> Row:
    """Record a figure, measured once or several times; its baseline is a name and a figure in that unit."""
    all_values = np.atleast_1d(np.asarray(values, dtype=float))
    value = float(np.median(all_values))
    spread = USUAL_SPREAD
    if len(all_values) > 2 and value:
        low, high = np.percentile(all_values, [25, 75])
        spread = float((high - low) / 2 / abs(value))
    ratio = None
    if baseline is not None:
        ratio = value / baseline[1] if more_is_better else baseline[1] / value
    name, other = baseline or (None, None)
    row = Row(bench, work, value, unit, name, other, ratio, asked, more_is_better, spread)
    if "RPL_BENCH_ROWS" in os.environ:
        with Path(os.environ["RPL_BENCH_ROWS"]).open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(row)) + "\n")
    return row


def run_described() -> dict[str, Any]:
    """The machine, the versions and the commit of this run."""
    git = ["git", "-C", str(Path(__file__).parent)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True).stdout.strip()
    changed = subprocess.run([*git, "status", "--porcelain"], capture_output=True, text=True).stdout.strip()
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text().splitlines() if cpus.exists() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    return {
        "commit": commit + (" with changes" if changed else ""),
        "machine": model or platform.processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[1],
        "share": float(os.environ.get("RPL_BENCH_SHARE", "1")),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
    }


def printed(rows: Sequence[Row]) -> str:
    """The table of all rows."""
    lines = ["| bench | work | figure | baseline | ratio | asked |", "|---|---|---|---|---|---|"]
    for row in rows:
        beside = "" if row.baseline is None else f"{row.baseline}: {row.baseline_value:.4g}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        asked = "" if row.asked is None else f"{row.asked:g}"
        figure = f"{row.value:.4g} {row.unit}"
        lines.append(f"| {row.bench} | {row.work} | {figure} | {beside} | {ratio} | {asked} |")
    return "\n".join(lines)


def compared(before: Sequence[Row], after: Sequence[Row]) -> list[str]:
    """A line per row that changed by more than the spread of both runs, and per row that one of them lacks.

    Where a row has a baseline, ratios are compared: so the speed of the machine cancels.
    """
    old, new = ({(row.bench, row.work): row for row in rows} for rows in (before, after))
    lines = []
    for key in old.keys() & new.keys():
        a, b = old[key], new[key]
        if a.ratio is not None and b.ratio is not None:
            gain, said = _over(b.ratio, a.ratio), f"ratio {a.ratio:.2f} -> {b.ratio:.2f}"
        else:
            gain = _over(b.value, a.value) if b.more_is_better else _over(a.value, b.value)
            said = f"{a.value:.4g} -> {b.value:.4g} {b.unit}"
        if abs(np.log(gain)) > np.log1p(a.spread + b.spread):
            word = "better" if gain > 1 else "worse"
            lines.append(f"{word} by {max(gain, 1 / gain):.2f}x: {key[0]}: {key[1]}: {said}")
    lines += [f"only in the first: {bench}: {work}" for bench, work in old.keys() - new.keys()]
    lines += [f"only in the second: {bench}: {work}" for bench, work in new.keys() - old.keys()]
    return sorted(lines, reverse=True)


def _over(one: float, other: float) -> float:
    """A quotient; a figure of 0, such as of no false alarm, counts as almost 0."""
    return max(one, 1e-3) / max(other, 1e-3)


def read_rows(kept: Path) -> list[Row]:
    """The rows of a run that was kept."""
    return [Row(**row) for row in json.loads(kept.read_text(encoding="utf-8"))["rows"]]


def table(rows_file: Path, kept: Path) -> None:
    """Print all rows of a run, and keep them with machine and commit."""
    lines = rows_file.read_text(encoding="utf-8").splitlines() if rows_file.exists() else []
    rows = [Row(**json.loads(line)) for line in lines]
    print(printed(rows))
    content = {"run": run_described(), "rows": [asdict(row) for row in rows]}
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(f"kept in {kept}")


def main(command: str, first: str, second: str) -> None:
    """Print a table or a comparison."""
    if command == "table":
        table(Path(first), Path(second))
    elif command == "compare":
        for name in (first, second):
            run = json.loads(Path(name).read_text(encoding="utf-8"))["run"]
            where = f"{run['cores']} cores of {run['machine']}, load {run['load']:.1f}"
            print(f"{name}: {run['commit'][:10]}, {where}")
        print("\n".join(compared(read_rows(Path(first)), read_rows(Path(second)))) or "nothing changed")
    else:
        sys.exit(f"{command}: expected table or compare")


if __name__ == "__main__":
    main(*sys.argv[1:4])
