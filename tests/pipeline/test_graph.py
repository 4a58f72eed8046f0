"""The graph of steps: what runs when, on which executor, and what a failure leaves."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

import fsspec
import numpy as np
import pytest
from built_once import moved_copy
from distributed import LocalCluster

from rpl_data.meshes import in_order
from rpl_data.pipeline import build as module
from rpl_data.pipeline.build import build, recipe_of, stale_steps
from rpl_data.pipeline.cluster import M_MMAP_THRESHOLD, M_TRIM_THRESHOLD, Cluster, keep_freed_memory
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.exported_labels import earlier_lines
from rpl_data.pipeline.graph import Graph
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step
from rpl_data.pipeline.object_store import MANIFEST
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.processes import Processes
from rpl_data.pipeline.progress import Progress
from rpl_data.pipeline.sources import recordings_of
from rpl_data.pipeline.worker import EngineLost, Stopped
from rpl_data.types import DataError, Mesh
from rpl_data.workspace.workspace import Workspace


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask scheduler with two workers' threads in this process."""
    options = {"processes": False, "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(n_workers=2, **options) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def built(plain_build: Path, tmp_path: Path) -> Workspace:
    """A workspace of its own, up to date."""
    return Workspace(moved_copy(plain_build, tmp_path / "built") / "ws")


def a_step(stage: str, item: str, *after: str, run: Callable[[Advance], Outcome] | None = None) -> Step:
    return Step(stage, item, 1, {}, {}, after, (), run or (lambda advance: Outcome(1)))


class Told:
    """Remembers what a build told."""

    def __init__(self) -> None:
        self.lines: list[Progress] = []

    def __call__(self, progress: Progress) -> None:
        self.lines.append(progress)

    def names(self, state: str) -> list[str]:
        return [f"{line.stage}/{line.item}" for line in self.lines if line.state == state]


def test_steps_run_after_those_before_them_and_a_failure_stops_only_what_needs_it(
    scheduler: str, tmp_path: Path
) -> None:
    order = tmp_path / "order"
    order.touch()

    def noted(name: str) -> Callable[[Advance], Outcome]:
        def run(advance: Advance) -> Outcome:
            if name == "track/01":
                raise DataError("no poses")
            with order.open("a") as file:
                file.write(f"{name}\n")
            return Outcome(3, (f"{name} speaks",))

        return run

    steps = [
        a_step(stage, item, *after, run=noted(f"{stage}/{item}"))
        for stage, item, *after in [
            ("track", "00"), ("track", "01"), ("drift", "00", "track/00"), ("drift", "01", "track/01"),
            ("segment", "cup", "drift/00"), ("label", "01", "drift/01"), ("label", "00", "segment/cup"),
        ]
    ]  # fmt: skip
    ledger, told = Ledger(tmp_path / "stages.json"), Told()
    with Pool(engine=Cluster(scheduler, Workspace(tmp_path))) as pool:
        graph = Graph(ledger, pool, told, keep_going=True)
        graph.run(steps)
        assert order.read_text().split() == ["track/00", "drift/00", "segment/cup", "label/00"]
        assert ledger.entries["drift/00"].outcome == Outcome(3, ("drift/00 speaks",))
        assert graph.lost_places() == {"01"}
        assert told.names("failed") == ["track/01"]
        with pytest.raises(DataError, match="1 of the steps failed.*\n    track 01: no poses"):
            graph.refuse_failed()
        assert (tmp_path / "build.cluster").is_file()
        with pytest.raises(DataError, match="^no poses"):  # without keep_going, that is the end
            Graph(ledger, pool, told).run(steps)
    Graph(again := Ledger(ledger.path), Pool(1), told := Told()).run([s for s in steps if s.item != "01"])
    assert told.names("kept") == ["track/00", "drift/00", "segment/cup", "label/00"]
    assert again.entries == ledger.entries


def test_a_step_of_a_killed_build_ends_when_another_build_begins(scheduler: str, tmp_path: Path) -> None:
    begun = tmp_path / "begun"

    def endless(advance: Advance) -> Outcome:
        begun.touch()
        while True:
            advance(0, 1)
            time.sleep(0.02)

    place = Workspace(tmp_path)
    cluster = Cluster(scheduler, place)
    step = cluster.submit(a_step("label", "00", run=endless))
    while not begun.exists():
        time.sleep(0.02)
    with module.alone_in(place):  # whatever it does, and without the cluster
        assert isinstance(step.exception(timeout=60), Stopped)
    late = cluster.submit(a_step("label", "01", run=endless))
    assert isinstance(late.exception(timeout=60), Stopped)
    cluster.close(at_once=False)


def test_a_worker_keeps_memory_that_dask_has_it_give_back() -> None:
    def faults() -> int:
        before = getrusage(RUSAGE_SELF).ru_minflt
        for _ in range(20):
            np.ones(1 << 20)  # 8 MB
        return getrusage(RUSAGE_SELF).ru_minflt - before

    mallopt = ctypes.CDLL(None).mallopt
    mallopt(M_MMAP_THRESHOLD, 128 << 10)  # fixed, as whoever sets MALLOC_TRIM_THRESHOLD_ has it
    mallopt(M_TRIM_THRESHOLD, 64 << 10)
    earlier = []
    while (given_back := faults()) < 20:  # the arrays fit into room that earlier tests have left
        earlier.append(np.ones(1 << 20))
    keep_freed_memory()
    faults()
    assert faults() < given_back / 10, given_back


def test_dask_makes_the_same_bytes(scheduler: str, built: Workspace) -> None:
    files = [path for scene in ("00", "01") for path in (built.surface_file(scene), built.labels_file(scene))]
    made, told = {path: path.read_bytes() for path in files}, Told()
    for path in files:
        path.unlink()
    build(recipe_of(built), built, until="label", dask=scheduler, tell=told)
    assert sorted(told.names("ran")) == ["label/00", "label/01", "surface/00", "surface/01"]
    assert {path: path.read_bytes() for path in files} == made
    with pytest.raises(DataError, match="either --workers or --dask"):
        build(recipe_of(built), built, workers=2, dask=scheduler)
    with pytest.raises(DataError, match="expected tcp://HOST:PORT"):
        build(recipe_of(built), built, dask="localhost")


def test_a_scene_that_fails_is_left_out_and_the_rest_goes_on(
    built: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = module.STAGES["surface"]

    def broken(context: Context) -> list[Step]:
        def run(advance: Advance) -> Outcome:
            raise DataError("its depth is gone")

        return [Step(**{**vars(step), "run": run}) if step.item == "01" else step for step in plan(context)]

    monkeypatch.setitem(module.STAGES, "surface", broken)
    built.surface_file("01").unlink()
    recipe, labels = recipe_of(built), built.labels_file("01").read_bytes()
    with pytest.raises(DataError, match="\n    surface 01: its depth is gone"):
        build(recipe, built, until="label", workers=1, keep_going=True)
    assert built.labelled_scene_names() == ["00", "02"]
    assert built.earlier_labelled_names() == ["01"]
    assert built.earlier_labels_file("01").read_bytes() == labels
    assert set(built.load_placed("carton").scene_from_object) == {"00", "01", "02"}  # by its clicks
    ledger = Ledger(built.stages_file)
    assert "surface/01" not in ledger.entries["refine/carton"].after
    monkeypatch.setitem(module.STAGES, "surface", plan)
    assert stale_steps(recipe, built)["surface"] == [("00", True), ("01", False), ("02", True)]


def test_a_recording_that_cannot_be_read_is_left_out_and_tried_again(
    built: Workspace, tmp_path: Path
) -> None:
    recipe = recipe_of(built)
    (tmp_path / "empty").mkdir()
    both = replace(recipe, scenes=(*recipe.scenes, replace(recipe.scenes[0], path=tmp_path / "empty")))
    place = Workspace(tmp_path / "new")
    with pytest.raises(DataError, match=f"\n    import {tmp_path}/empty: "):
        build(both, place, until="clicks", keep_going=True)
    assert place.scene_names() == built.scene_names()
    assert Ledger(place.stages_file).entries.keys() == {"import", "clicks/carton"}
    assert stale_steps(both, place)["import"] == [("", False)]
    with pytest.raises(DataError, match="empty"):
        build(both, Workspace(tmp_path / "other"), until="clicks")


def test_a_recording_on_a_disk_that_is_not_mounted_loses_nothing(
    built: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe, seen = recipe_of(built), list[Context]()
    (source,) = recipe.scenes
    away = replace(source, path=tmp_path / "disk", names=("02",))
    faults: dict[str, DataError] = {}
    with pytest.raises(DataError, match="disk"):  # where none can be read, nothing is left to go on with
        recordings_of([replace(away, names=(name,)) for name in ("00", "01", "02")], faults=faults)
    assert list(faults) == [f"{tmp_path}/disk (00)", f"{tmp_path}/disk (01)"]
    torn = replace(recipe, scenes=(replace(source, names=("00", "01")), away))
    files = (built.scene_file("02"), built.trajectory_file("02"), built.labels_file("02"))
    before = [path.read_bytes() for path in files]
    for stage in ("track", "drift", "cut"):
        monkeypatch.setitem(module.STAGES, stage, lambda context: [])
    monkeypatch.setitem(module.STAGES, "solve", lambda context: seen.append(context) or [])
    with pytest.raises(DataError, match=rf"\n    import {tmp_path}/disk \(02\): "):
        build(torn, built, until="solve", keep_going=True, tell=(told := Told()))
    assert [path.read_bytes() for path in files] == before
    said = [line for one in told.lines for line in one.outcome.messages]
    assert any(line.startswith("scene 02: it was not read") for line in said)
    assert seen[0].lost == {"02"}
    module.FORGET["label"](seen[0])
    assert built.labelled_scene_names() == ["00", "01"]
    assert built.earlier_labels_file("02").read_bytes() == before[2]
    assert "scene 02" in earlier_lines(built)[0]


def test_recordings_come_from_a_store_and_exports_go_there(built: Workspace) -> None:
    store = fsspec.filesystem("memory")
    store.put(str(built.root.parent / "recording"), "/lab/recording", recursive=True)
    recipe = recipe_of(built)
    remote = replace(recipe.scenes[0], path=Path("memory://lab/recording"))  # a Path loses a slash
    told = Told()
    build(
        replace(recipe, scenes=(remote,)),
        place := Workspace(built.root.parent / "far"),
        until="import",
        tell=told,
    )
    assert place.scene_names() == built.scene_names()
    assert told.names("ran") == ["import/memory://lab/recording", "import/"]
    build(recipe_of(place), place, until="import", tell=(told := Told()))  # as the workspace keeps it
    assert told.names("ran") == []
    wrong = replace(recipe, export=replace(recipe.export, to="nowhere://lab/out"))
    build(wrong, built, until="import")  # sends nothing
    with pytest.raises(DataError, match="nowhere://lab/out cannot be reached"):
        build(wrong, built, tell=(told := Told()))
    assert not told.names("kept")  # said at the start
    sent = replace(recipe, export=replace(recipe.export, to="memory://lab/out"))
    build(sent, built, until="export", tell=(told := Told()))
    assert told.names("ran") == ["export/to"]
    own = {
        path.relative_to(built.export("coco")).as_posix()
        for path in built.export("coco").rglob("*")
        if path.is_file()
    }
    assert {path.removeprefix("/lab/out/coco/") for path in store.find("/lab/out")} == own | {MANIFEST}
    store.rm("/lab", recursive=True)


def test_a_process_that_is_killed_is_said() -> None:
    def fine(advance: Advance) -> Outcome:
        return Outcome(os.getpid())

    def killed(advance: Advance) -> Outcome:
        os.kill(os.getpid(), signal.SIGKILL)
        return Outcome()

    engine = Processes(1)
    outcome, _ = engine.submit(a_step("track", "00", run=fine)).result()
    assert outcome.frames != os.getpid()
    assert list(engine.reports()) == [("track/00", 0, 0)]
    fault = engine.submit(a_step("track", "01", run=killed)).exception()
    assert isinstance(fault, Exception)
    assert isinstance(engine.explained(fault, "track/01"), EngineLost)
    engine.close(at_once=True)


def test_a_surface_in_order_is_the_same_however_it_was_made() -> None:
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(30, 3))
    mesh = Mesh(vertices, rng.permuted(np.tile(np.arange(30), (40, 1)), axis=1)[:, :3], None)
    colors = rng.integers(0, 255, (30, 3)).astype(np.uint8)
    wanted = in_order(Mesh(mesh.vertices, mesh.triangles, colors))
    order = rng.permutation(30)
    place = np.argsort(order)
    turned = np.roll(place[mesh.triangles][rng.permutation(40)], 1, axis=1)
    found = in_order(Mesh(mesh.vertices[order], turned, colors[order]))
    for one, other in zip(vars(found).values(), vars(wanted).values(), strict=True):
        np.testing.assert_array_equal(one, other)
    corners = {tuple(map(tuple, mesh.vertices[row])) for row in mesh.triangles}
    for row in wanted.triangles:  # the same triangles, turned but not mirrored
        kept = [tuple(wanted.vertices[k]) for k in row]
        assert any(tuple(kept[k:] + kept[:k]) in corners for k in range(3))
