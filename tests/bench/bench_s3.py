"""A recording read from an S3-compatible server and an export written to it, each killed half-way.

The server is moto's, on this machine: `pip install s3fs 'moto[server]'` first, in an environment of their
own, since s3fs wants an older python-dateutil than constraints.txt has. Without them nothing is measured.

Run: PYTHONPATH=. python tests/bench/bench_s3.py RECORDING WORKSPACE
RECORDING is a folder in the format rpl, WORKSPACE a workspace with exports: those of `make demo` when left
out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rows import record

ROOT = Path(__file__).parents[2]
RPL = [sys.executable, "-m", "rpl_data.cli"]


@contextmanager
def server(port: int) -> Iterator[None]:
    """moto's server, which keeps its buckets in memory; this process and its children use it."""
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "nobody",
        "AWS_SECRET_ACCESS_KEY": "nothing",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    command = [sys.executable, "-m", "moto.server", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(5)
        yield
    finally:
        process.kill()
        process.wait()


def lines_in(folder: Path, pattern: str) -> int:
    """Entries of the logs of copies."""
    return sum(len(path.read_text().split("\n")) - 1 for path in folder.glob(pattern))


def run(arguments: Sequence[str], until: Callable[[], bool] | None = None) -> tuple[float, int, str]:
    """Run `rpl`, and kill it once `until` holds; seconds, exit status and what it said."""
    started = time.perf_counter()
    process = subprocess.Popen(
        [*RPL, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    while until is not None and process.poll() is None:
        if until():
            process.send_signal(signal.SIGKILL)
        time.sleep(0.01)
    said, _ = process.communicate()
    return time.perf_counter() - started, process.returncode, said


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of the files below a folder, by name."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files
    }


def read_through(store: Any, recording: Path, scratch: Path) -> None:
    """The recording, copied in two goes."""
    store.put(str(recording), "lab/recording", recursive=True)
    recipe, workspace = scratch / "far.yaml", scratch / "far"
    recipe.write_text(
        "name: far\nscenes: [{path: 's3://lab/recording', metres_per_unit: 0.001}]\n"
        "objects: [{name: thing, keypoints: 3}]\n"
    )
    total = len(store.find("lab/recording"))
    told = ["import", str(recipe), "--workspace", str(workspace)]
    first_s, status, said = run(told, lambda: lines_in(workspace, "copies/*/copied.jsonl") >= total // 2)
    assert status == -signal.SIGKILL, said
    known = lines_in(workspace, "copies/*/copied.jsonl")
    second_s, status, said = run(told)
    assert status == 0, said
    copied = int(next(line for line in said.splitlines() if "copied" in line).split()[0])
    same = digests(next(workspace.glob("copies/*/recording"))) == digests(recording)
    third_s, status, said = run(told)
    assert status == 0, said
    assert "copied" not in said
    _record("recording", same, known, copied, total)
    print(
        f"recording: {total} files; killed after {known} ({first_s:.1f} s), then {copied} more "
        f"({second_s:.1f} s), then none ({third_s:.1f} s); bytes {'equal' if same else 'DIFFER'}"
    )


def write_through(store: Any, workspace: Path) -> None:
    """The exports, copied in two goes."""
    told = ["export", "--workspace", str(workspace), "--to", "s3://lab/out"]
    total = sum(path.is_file() for path in (workspace / "export/coco").rglob("*"))
    first_s, status, said = run(told, lambda: lines_in(workspace, "uploads/*.jsonl") >= total // 2)
    assert status == -signal.SIGKILL, said
    known = lines_in(workspace, "uploads/*.jsonl")
    store.invalidate_cache()
    assert not store.exists("lab/out/coco/rpl-manifest.json")
    second_s, status, said = run(told)
    assert status == 0, said
    copied = int(said.rsplit("s3://lab/out/coco: ", 1)[1].split()[0])
    store.invalidate_cache()
    listed = json.loads(store.cat_file("lab/out/coco/rpl-manifest.json"))
    there = {name: hashlib.sha256(store.cat_file(f"lab/out/coco/{name}")).hexdigest() for name in listed}
    same = there == digests(workspace / "export/coco") == {name: mark[1] for name, mark in listed.items()}
    third_s, status, said = run(told)
    assert "s3://lab/out/coco: 0 files copied" in said, said
    _record("export", same, known, copied, total)
    print(
        f"export: {total} files; killed after {known} ({first_s:.1f} s), then {copied} more "
        f"({second_s:.1f} s), then none ({third_s:.1f} s); bytes {'equal' if same else 'DIFFER'}"
    )


def _record(what: str, same: bool, known: int, copied: int, total: int) -> None:
    """Keep whether all bytes are equal, and how many files were copied twice because of the kill."""
    record("s3", f"{what}: bytes equal after a kill", float(same), "share", asked=1.0, more_is_better=True)
    record("s3", f"{what}: copied twice because of a kill", known + copied - total, "files", asked=64)


def main() -> None:
    """Print a line for each direction."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    demo = ROOT / "workspaces/demo"
    parser.add_argument("recording", type=Path, nargs="?", default=demo / "recording")
    parser.add_argument("workspace", type=Path, nargs="?", default=demo)
    parser.add_argument("--port", type=int, default=15151)
    told = parser.parse_args()
    try:
        import s3fs
    except ModuleNotFoundError:
        print("s3fs is not installed here; nothing was measured")
        return
    with server(told.port), tempfile.TemporaryDirectory() as scratch:
        store = s3fs.S3FileSystem()
        store.mkdir("lab")
        read_through(store, told.recording, Path(scratch))
        write_through(store, told.workspace)


if __name__ == "__main__":
    main()
