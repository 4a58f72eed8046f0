"""`make attack`: damages files, fuzzes parsers and routes, kills builds and servers; a table by kind of end.

Any signal, traceback, hang, silent difference, 500 or lost click is a fault, and the exit status is then 1.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from attack import files, kills, parsers, server

FAULTS = ("traceback", "signal", "hang", "difference", "500", "lost", "litter")


def main() -> int:
    """Run the attacks that were asked for, all when none is named."""
    parser = argparse.ArgumentParser(prog="attack", description=__doc__)
    parser.add_argument("--only", nargs="*", choices=("files", "parsers", "server", "kills", "trainings"))
    parser.add_argument("--rounds", type=int, default=8, help="damages per file: 8 are over 1,000 cases")
    parser.add_argument("--inputs", type=int, default=20_000, help="damaged files per parser")
    parser.add_argument("--requests", type=int, default=3000)
    parser.add_argument("--kills", type=int, default=60)
    chosen = parser.parse_args()
    wanted = chosen.only or ("parsers", "server", "files", "kills")
    counts: Counter[str] = Counter()
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="rpl-attack-") as scratch:
        root = Path(scratch)
        if "parsers" in wanted:
            counts += parsers.attack(root, chosen.inputs, tell)
        if set(wanted) & {"server", "files", "kills", "trainings"}:
            base = built(root)
        if "server" in wanted:
            shutil.copytree(base, root / "served")
            counts += server.attack(root / "served/ws", chosen.requests, 500, tell)
        if "files" in wanted:
            counts += files.attack(base, root, chosen.rounds, tell)
        if "kills" in wanted:
            counts += kills.builds(base, root, chosen.kills, tell)
            counts += kills.servers(base, root, chosen.kills, tell)
        if set(wanted) & {"kills", "trainings"}:
            counts += kills.trainings(base, root, chosen.kills, tell)
    for name, count in sorted(counts.items()):
        print(f"{count:8d}  {name}")
    cases = sum(count for name, count in counts.items() if " MB " not in name)
    faults = sum(count for name, count in counts.items() if name.rsplit(" ", 1)[-1] in FAULTS)
    print(f"{cases} cases in {time.perf_counter() - started:.0f} s, {faults} faults")
    return 1 if faults else 0


def built(root: Path) -> Path:
    """A small recording and the workspace built from it."""
    from attack.children import command

    tiny = Path(__file__).parents[1] / "tiny.yaml"
    assert command("import", str(tiny), "--workspace", str(root / "tiny")) == 0
    return files.prepare(root / "base", root / "tiny")


def tell(line: str) -> None:
    """Say what went wrong at once: the table comes at the end."""
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
