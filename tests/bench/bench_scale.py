"""A build of many frames: wall time, CPU and memory by executor, and what a kill costs.

A short recording is made long: its frames are linked, back and forth, into scenes of any length, so that
10,000 frames of real size take no space. The same build then runs in one process, in two, and on a Dask
scheduler with two workers; and again, while a worker, the scheduler or the building process is killed. All
must make the same bytes.

Run: PYTHONPATH=. python tests/bench/bench_scale.py [--frames 600] [--scenes 4] [--only serial ...]
Where no recording is given, a twin of four scenes is rendered (some minutes). `--grow frames` (or scenes)
builds a second recording with twice as many, and prints how the cost of each stage grows.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from rows import record, shared

RPL = [sys.executable, "-m", "rpl_data.cli"]
LOOK_EVERY_S = 0.25
NO_LABELS = {"stages.json", "build.lock", "recipe.yaml", "index.html"}
"""Files with seconds or addresses in them, which no two builds share."""


# The recording ------------------------------------------------------------------------------------


def back_and_forth(count: int, length: int) -> Iterator[int]:
    """Numbers of frames: 0, 1, ... count - 1, count - 2, ... 1, 0, 1, ..., so that no view jumps."""
    period = max(1, 2 * (count - 1))
    for number in range(length):
        step = number % period
        yield step if step < count else period - step


def lengthen(scene: Path, to: Path, length: int) -> None:
    """A scene of this many frames, linked from those of a short one."""
    pairs = [line.split() for line in (scene / "associations.txt").read_text().splitlines() if line[0] != "#"]
    poses = [line.split() for line in (scene / "camera.poses").read_text().splitlines() if line[0] != "#"]
    between_s = (float(pairs[-1][0]) - float(pairs[0][0])) / max(1, len(pairs) - 1)
    for name in ("rgb", "depth"):
        (to / name).mkdir(parents=True)
    lists: tuple[list[str], list[str]] = ([], [])
    for number, source in enumerate(back_and_forth(len(pairs), length)):
        time_s, names = f"{number * between_s:.6f}", []
        for old in (pairs[source][1], pairs[source][3]):
            name = f"{old.split('/')[0]}/{number:06d}{Path(old).suffix}"
            os.link(scene / old, to / name)
            names.append(name)
        lists[0].append(f"{time_s} {names[0]} {time_s} {names[1]}")
        lists[1].append(" ".join([time_s, *poses[source][1:]]))
    for name, lines in zip(("associations.txt", "camera.poses"), lists, strict=True):
        (to / name).write_text("\n".join(lines) + "\n")


def long_recording(short: Path, folder: Path, *, frames: int, scenes: int) -> Path:
    """Scenes with this many frames in all, each linked from a scene of a short recording; and a recipe."""
    names = sorted(path.parent.name for path in short.glob("*/associations.txt"))
    made = {}
    for number in range(scenes):
        made[f"{number:04d}"] = names[number % len(names)]
    for name, source in made.items():
        lengthen(short / source, folder / "recording" / name, frames // scenes)
    shutil.copy(short / "camera.txt", folder / "recording/camera.txt")
    with (short / "clicks.csv").open() as file:
        clicks = list(csv.DictReader(file))
    lines = [
        ",".join([c["object"], c["keypoint"], name, c["frame"], c["u_px"], c["v_px"]])
        for name, source in made.items()
        for c in clicks
        if c["scene"] == source
    ]
    (folder / "clicks.csv").write_text("\n".join(["object,keypoint,scene,frame,u_px,v_px", *lines]) + "\n")
    shown = {line.split(",")[0] for line in lines}
    keypoints = {
        name: ", ".join(dict.fromkeys(f"'{c['keypoint']}'" for c in clicks if c["object"] == name))
        for name in sorted(shown)
    }
    recipe = "name: long\nscenes: [{path: recording, metres_per_unit: 0.001}]\nlabel: {rate: all}\n"
    recipe += "split: {test_scenes: 1}\nexport: {images: link}\nobjects:\n"
    recipe += "".join(
        f"  - {{name: {name}, keypoints: [{names}], clicks: clicks.csv}}\n"
        for name, names in keypoints.items()
    )
    (folder / "recipe.yaml").write_text(recipe)
    return folder / "recipe.yaml"


def short_twin(folder: Path) -> Path:
    """Four scenes of 24 frames, 640 x 480."""
    from rpl_data.twin.spec import TwinSpec
    from rpl_data.twin.write import write_twin

    if not (folder / "camera.txt").exists():
        spec = TwinSpec(objects=("carton", "kettle"), scenes=4, seconds=8.0, keep_hz=3.0, seed=31)
        write_twin(folder, spec, workers=2)
    return folder


# Processes ----------------------------------------------------------------------------------------


@dataclass
class Cost:
    """What a build cost: seconds, CPU seconds of all its processes, and the most memory at once."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    status: int


class Watch:
    """Adds up CPU time from now on, and memory, of processes and their children, as long as they live."""

    def __init__(self, roots: Sequence[int]) -> None:
        self._roots, self._cpu_s, self.peak_mb, self._ended = (
            roots,
            dict[int, float](),
            0.0,
            threading.Event(),
        )
        self._look()
        self._before_s = sum(self._cpu_s.values())  # workers that have served another build
        self._thread = threading.Thread(target=self._look_on, daemon=True)
        self._thread.start()

    def _look_on(self) -> None:
        while not self._ended.wait(LOOK_EVERY_S):
            self._look()

    def _look(self) -> None:
        total = 0.0
        for process in self._processes():
            try:
                times = process.cpu_times()
                self._cpu_s[process.pid] = times.user + times.system
                total += process.memory_full_info().pss / 2**20
            except psutil.Error:
                continue
        self.peak_mb = max(self.peak_mb, total)

    def _processes(self) -> Iterator[psutil.Process]:
        for root in self._roots:
            try:
                process = psutil.Process(root)
                yield from (process, *process.children(recursive=True))
            except psutil.Error:
                continue

    def close(self) -> float:
        """CPU seconds since this began to watch."""
        self._ended.set()
        self._thread.join()
        return sum(self._cpu_s.values()) - self._before_s


def steps_done(workspace: Path) -> int:
    """How many steps the ledger knows."""
    try:
        return len(json.loads((workspace / "stages.json").read_text()))
    except (OSError, ValueError):
        return 0


def run(
    recipe: Path,
    workspace: Path,
    options: Sequence[str],
    beside: Sequence[int] = (),
    disturb: Callable[[subprocess.Popen[bytes]], None] | None = None,
) -> Cost:
    """Build in a process of its own; `disturb` is called with it once it runs."""
    log = (workspace.parent / f"{workspace.name}.log").open("ab")
    started = time.perf_counter()
    command = [*RPL, "build", str(recipe), "--workspace", str(workspace), *options]
    process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
    watch = Watch([process.pid, *beside])
    if disturb is not None:
        disturb(process)
    status = process.wait()
    return Cost(time.perf_counter() - started, watch.close(), watch.peak_mb, status)


@contextmanager
def scheduler(port: int, workers: int) -> Iterator[tuple[str, Any, Any]]:
    """A Dask scheduler and its workers, as a person starts them; their processes."""
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "dask"]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    main = subprocess.Popen([*dask, "scheduler", "--port", str(port), "--no-dashboard"], **quiet)
    options = ["--nworkers", str(workers), "--nthreads", "1", "--no-dashboard"]
    time.sleep(3)
    nanny = subprocess.Popen([*dask, "worker", address, *options], **quiet)
    time.sleep(4)
    try:
        yield address, main, nanny
    finally:
        for process in (nanny, main):
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def after_steps(workspace: Path, count: int, then: Callable[[], None]) -> Callable[[Any], None]:
    """Do something a moment after so many steps are done."""

    def disturb(process: subprocess.Popen[bytes]) -> None:
        while steps_done(workspace) < count and process.poll() is None:
            time.sleep(0.05)
        time.sleep(0.7)
        then()

    return disturb


def kill_children(pid: int) -> None:
    """SIGKILL to one process below this one that computes: the one with most CPU time."""
    children = psutil.Process(pid).children(recursive=True)
    busiest = max(children, key=lambda child: child.cpu_times().user)
    os.kill(busiest.pid, signal.SIGKILL)


# Bytes --------------------------------------------------------------------------------------------


def digest(workspace: Path) -> str:
    """Stands for all that a build made, but what says how long it took."""
    lines = []
    for path in sorted(workspace.rglob("*")):
        if path.is_file() and path.name not in NO_LABELS and "cache" not in path.parts:
            content = path.read_bytes().replace(str(workspace).encode(), b"WS")
            lines.append(f"{path.relative_to(workspace)} {hashlib.sha256(content).hexdigest()}")
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


COUNTED = """
import json, sys, time
from pathlib import Path
from rpl_data import build
cost, began = {}, {}
def tell(progress):
    name = f"{progress.stage}/{progress.item}"
    if progress.state == "runs":
        began.setdefault(name, time.process_time())
    elif progress.state == "ran":
        row = cost.setdefault(progress.stage, {"cpu_s": 0.0, "frames": 0, "steps": 0})
        row["cpu_s"] += time.process_time() - began[name]
        row["frames"] += progress.outcome.frames
        row["steps"] += 1
if __name__ == "__main__":
    build(sys.argv[1], sys.argv[2], workers=1, tell=tell)
    Path(sys.argv[2]).with_suffix(".cost.json").write_text(json.dumps(cost))
"""
"""A build in one process that adds up the CPU seconds of each stage, whatever else the machine does."""


def unit_costs(recipe: Path, workspace: Path) -> dict[str, dict[str, float]]:
    """CPU seconds, frames and steps by stage, of a build in one process."""
    command = [sys.executable, "-c", COUNTED, str(recipe), str(workspace)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, dict[str, float]] = json.loads(workspace.with_suffix(".cost.json").read_text())
    return found


def print_growth(small: dict[str, dict[str, float]], large: dict[str, dict[str, float]]) -> None:
    """By stage: CPU seconds of both, and the exponent of the doubling."""
    for stage, row in small.items():
        one, two = row["cpu_s"], large[stage]["cpu_s"]
        exponent = f"{math.log2(two / one):6.2f}" if one > 0.2 else "     - (too short to tell)"
        print(f"{stage:10s} {one:8.2f} s  {two:8.2f} s  {exponent}", flush=True)


def sizes(workspace: Path) -> dict[str, float]:
    """Megabytes of what a build made, by folder."""
    groups = {
        "scene.json": "scenes/*/scene.json", "poses": "scenes/*/*.txt", "surfaces": "scenes/*/surface.ply",
        "depth cache": "scenes/*/cache/**/*", "labels": "labels/*", "objects": "objects/*/*",
        "export (without images)": "export/coco/*.json", "report": "report/*", "ledger": "stages.json",
    }  # fmt: skip
    return {
        name: sum(path.stat().st_size for path in workspace.glob(pattern) if path.is_file()) / 1e6
        for name, pattern in groups.items()
    }


# Runs ---------------------------------------------------------------------------------------------


class Runs:
    """Builds of one recording, each in a fresh workspace, compared with the first."""

    def __init__(self, folder: Path, recipe: Path, port: int) -> None:
        self.folder, self.recipe, self.port = folder, recipe, port
        self.rows: dict[str, dict[str, Any]] = {}

    def workspace(self, name: str) -> Path:
        """An empty one."""
        place = self.folder / f"ws_{name}"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        return place

    def note(self, name: str, workspace: Path, cost: Cost, **more: Any) -> None:
        """Print a row and keep it."""
        first = next(iter(self.rows.values()), None)
        made = digest(workspace) if cost.status == 0 else "-"
        same = "" if first is None else "same bytes" if made == first["digest"] else "OTHER BYTES"
        row = {**vars(cost), "digest": made, **more}
        self.rows[name] = row
        lost = (
            "" if "lost_s" not in more else f"  lost {more['lost_s']:.1f} s, {more['lost_cpu_s']:.1f} CPU s"
        )
        self._record(name, row, same)
        print(
            f"{name:22s} {cost.wall_s:7.1f} s  CPU {cost.cpu_s:7.1f} s  peak {cost.peak_mb:6.0f} MB  "
            f"status {cost.status}  {made} {same}{lost}",
            flush=True,
        )

    def _record(self, name: str, row: dict[str, Any], same: str) -> None:
        """Keep a row's figures; all builds are compared with the first."""
        kind, first = next(iter(self.rows.items()))
        for key, unit in (("wall_s", "s"), ("cpu_s", "s CPU"), ("peak_mb", "MB")):
            baseline = (kind, first[key]) if same else None
            record("scale", f"{name}: {key}", row[key], unit, baseline=baseline)
        if same:
            equal = float(same == "same bytes")
            record("scale", f"{name}: same bytes", equal, "share", asked=1.0, more_is_better=True)
        if "lost_cpu_s" in row:
            record("scale", f"{name}: lost by the kill", row["lost_cpu_s"], "s CPU")

    def serial(self) -> None:
        """One process."""
        place = self.workspace("serial")
        self.note("serial", place, run(self.recipe, place, ["--workers", "1"]))

    def processes(self) -> None:
        """Two processes."""
        place = self.workspace("processes")
        self.note("processes 2", place, run(self.recipe, place, ["--workers", "2"]))

    def dask(self) -> None:
        """Two workers of a scheduler."""
        place = self.workspace("dask")
        with scheduler(self.port, 2) as (address, main, nanny):
            self.note("dask 2", place, run(self.recipe, place, ["--dask", address], [main.pid, nanny.pid]))

    def kill_worker(self, at: int) -> None:
        """A Dask worker is killed; its nanny starts another, and the step runs again."""
        place = self.workspace("kill_worker")
        with scheduler(self.port, 2) as (address, main, nanny):
            disturb = after_steps(place, at, lambda: kill_children(nanny.pid))
            cost = run(self.recipe, place, ["--dask", address], [main.pid, nanny.pid], disturb)
        self.note("dask, worker killed", place, cost, **self._lost(cost, "dask 2"))

    def kill_scheduler(self, at: int) -> None:
        """The scheduler is killed; the build ends with a message, and is started again on a new one."""
        place = self.workspace("kill_scheduler")
        with scheduler(self.port, 2) as (address, main, nanny):
            disturb = after_steps(place, at, main.kill)
            first = run(self.recipe, place, ["--dask", address], [nanny.pid], disturb)
        assert first.status == 1, first
        with scheduler(self.port + 1, 2) as (address, main, nanny):
            second = run(self.recipe, place, ["--dask", address], [main.pid, nanny.pid])
        both = _sum(first, second)
        self.note("dask, scheduler killed", place, both, **self._lost(both, "dask 2"))

    def kill_client(self, at: int) -> None:
        """The building process is killed, and started again at once on the same workers."""
        place = self.workspace("kill_client")
        with scheduler(self.port, 2) as (address, main, nanny):
            told = [main.pid, nanny.pid]
            command = ["--dask", address]
            first = run(self.recipe, place, command, told, self._killing_client(place, at))
            second = run(self.recipe, place, command, told)
        both = _sum(first, second)
        self.note("dask, client killed", place, both, **self._lost(both, "dask 2"))

    def kill_client_processes(self, at: int) -> None:
        """The same with processes of this machine."""
        place = self.workspace("kill_local")
        first = run(self.recipe, place, ["--workers", "2"], (), self._killing_client(place, at))
        both = _sum(first, run(self.recipe, place, ["--workers", "2"]))
        self.note("processes, killed", place, both, **self._lost(both, "processes 2"))

    def _killing_client(self, place: Path, at: int) -> Callable[[Any], None]:
        return lambda process: after_steps(place, at, lambda: os.kill(process.pid, signal.SIGKILL))(process)

    def _lost(self, cost: Cost, straight: str) -> dict[str, float]:
        """What a kill cost, wall time and CPU time; nothing where the straight build was not measured."""
        if straight not in self.rows:
            return {}
        row = self.rows[straight]
        return {"lost_s": cost.wall_s - row["wall_s"], "lost_cpu_s": cost.cpu_s - row["cpu_s"]}


def doctor_cost_s(scene: Path, camera: Path, folder: Path, frames: int) -> float:
    """CPU seconds that the doctor takes for a scene of so many frames."""
    from rpl_data.doctor.examine import examine
    from rpl_data.recordings.open import open_scenes

    shutil.rmtree(folder, ignore_errors=True)
    lengthen(scene, folder / "long", frames)
    shutil.copy(camera, folder)
    (recording,) = open_scenes(folder, "rpl", metres_per_unit=0.001)
    started = time.process_time()
    examine(recording)
    return time.process_time() - started


def doctor(short: Path, folder: Path, runs: Runs, told: argparse.Namespace) -> None:
    """Keep how the doctor's cost grows with the frames, and what share of a build it and drift would be."""
    scene, camera = next(short.glob("*/associations.txt")).parent, short / "camera.txt"
    doctor_cost_s(scene, camera, folder / "doctor", 30)  # the first time, packages are loaded
    few, many = (doctor_cost_s(scene, camera, folder / "doctor", frames) for frames in (100, 3000))
    record("scale", "doctor, 3,000 frames", many, "s CPU", baseline=("100 frames", few), asked=1.0)
    print(f"doctor: {few:.1f} CPU s for 100 frames, {many:.1f} for 3,000")
    if "serial" in runs.rows:
        steps = json.loads((folder / "ws_serial/stages.json").read_text())
        drift_s = sum(step["seconds"] for name, step in steps.items() if name.startswith("drift"))
        both_s, build_s = drift_s + told.scenes * few, runs.rows["serial"]["cpu_s"]
        work = f"doctor and drift, {told.frames // told.scenes} frames per scene: share of a build with both"
        share = both_s / (build_s + told.scenes * few)
        record("scale", work, share, "share", asked=0.1)
        print(f"{work}: {share:.1%} ({drift_s:.1f} s drift, {told.scenes * few:.1f} s doctor)")


def _sum(one: Cost, two: Cost) -> Cost:
    wall_s, cpu_s = one.wall_s + two.wall_s, one.cpu_s + two.cpu_s
    return Cost(wall_s, cpu_s, max(one.peak_mb, two.peak_mb), two.status)


KINDS = (
    "serial", "processes", "dask", "kill_worker", "kill_scheduler", "kill_client", "kill_client_processes",
)  # fmt: skip


def main() -> None:
    """Print one row per build, the costs by stage, and write both as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--recording", type=Path, help="a short recording in the format rpl, with clicks.csv")
    parser.add_argument(
        "--frames", type=int, default=shared(600, least=96), help="frames of all scenes together"
    )
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--kill-after", type=int, default=0, help="steps done before a kill; half when 0")
    parser.add_argument("--folder", type=Path, help="where to work; a temporary folder when left out")
    parser.add_argument("--only", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument(
        "--grow", choices=["frames", "scenes"], help="what is doubled, in place of the builds"
    )
    parser.add_argument("--json", type=Path, help="file for the results")
    parser.add_argument("--port", type=int, default=18786)
    told = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = told.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        short = told.recording or short_twin(folder / "short")
        content = grown(told, short, folder) if told.grow else built(told, short, folder)
        if told.json is not None:
            told.json.write_text(json.dumps(content, indent=1) + "\n")


def built(told: argparse.Namespace, short: Path, folder: Path) -> dict[str, Any]:
    """The builds, one after the other, and what the first made."""
    shutil.rmtree(folder / "long", ignore_errors=True)
    recipe = long_recording(short, folder / "long", frames=told.frames, scenes=told.scenes)
    runs = Runs(folder, recipe, told.port)
    print(f"{told.frames} frames in {told.scenes} scenes, load {os.getloadavg()[0]:.1f}", flush=True)
    for kind in told.only:
        at = (told.kill_after or 2 + 2 * told.scenes,)
        getattr(runs, kind)(*(at if kind.startswith("kill") else ()))
    doctor(short, folder, runs, told)
    megabytes = sizes(folder / f"ws_{told.only[0]}")
    print("MB:", {name: round(size, 2) for name, size in megabytes.items()})
    return {"runs": runs.rows, "megabytes": megabytes}


def grown(told: argparse.Namespace, short: Path, folder: Path) -> dict[str, Any]:
    """Two builds in one process, the second of twice as many frames or scenes."""
    costs = []
    for times in (1, 2):
        frames, scenes = told.frames * times, told.scenes * (times if told.grow == "scenes" else 1)
        shutil.rmtree(folder / "long", ignore_errors=True)
        recipe = long_recording(short, folder / "long", frames=frames, scenes=scenes)
        place = folder / f"ws_grown_{times}"
        shutil.rmtree(place, ignore_errors=True)
        costs.append(unit_costs(recipe, place))
        print(
            f"{frames} frames in {scenes} scenes: {sum(row['cpu_s'] for row in costs[-1].values()):.1f} CPU s"
        )
        print({name: round(size, 2) for name, size in sizes(place).items()}, flush=True)
    print_growth(*costs)
    return {"small": costs[0], "large": costs[1]}


if __name__ == "__main__":
    main()
