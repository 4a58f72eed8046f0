"""A build runs what is stale and nothing else, and goes on where it was cut off."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built_once import moved_copy

from rpl_data.clicks.table import clicks_from_csv
from rpl_data.geometry import Sphere
from rpl_data.meshes import joined_meshes
from rpl_data.pipeline import build as module
from rpl_data.pipeline.build import FORGET, STAGES, Progress, alone_in, build, recipe_of, stale_steps
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.label_tally import corrected_line
from rpl_data.pipeline.ledger import Entry, Ledger, Outcome, Step, stamps
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.recipe import LabelRecipe, ObjectRecipe, Recipe, RefineRecipe, SceneSource
from rpl_data.pipeline.results import quality_rows, sparse_labels, timings, worth_knowing
from rpl_data.pipeline.stages import ORDER, track
from rpl_data.reconstruct.spheres import joined_spheres
from rpl_data.twin.spec import TwinSpec
from rpl_data.types import DataError, Mesh
from rpl_data.workspace.workspace import Workspace


class Watcher:
    """Remembers the steps that ran."""

    def __init__(self) -> None:
        self.ran: list[str] = []

    def __call__(self, progress: Progress) -> None:
        if progress.state == "ran":
            self.ran.append(f"{progress.stage}/{progress.item}".rstrip("/"))


@pytest.fixture
def recording(tiny_workspace: Workspace, tmp_path: Path) -> Path:
    """A copy of the tiny recording, to be changed."""
    return Path(shutil.copytree(tiny_workspace.recording, tmp_path / "recording"))


def recipe_for(recording: Path, **changes: object) -> Recipe:
    """What a person would write for it."""
    keypoints = Workspace(recording / "truth").load_solution("carton").model.keypoints
    carton = ObjectRecipe("carton", keypoints, recording / "clicks.csv")
    base = Recipe(
        "tiny", (SceneSource(recording, metres_per_unit=0.001),), (carton,), label=LabelRecipe("all")
    )
    return Recipe(**{**{name: getattr(base, name) for name in base.__dataclass_fields__}, **changes})


@pytest.fixture
def built(plain_build: Path, tmp_path: Path) -> tuple[Recipe, Workspace]:
    """A workspace of its own, built; its recording may be changed."""
    copy = moved_copy(plain_build, tmp_path / "built")
    return recipe_for(copy / "recording"), Workspace(copy / "ws")


def test_errors_are_small(tiny_workspace: Workspace) -> None:
    rows = quality_rows(Ledger(tiny_workspace.stages_file))
    assert [row.object for row in rows] == ["carton"]
    assert rows[0].error_3d_mean_mm < 4  # half the resolution and a third of the clicks of the demo
    assert rows[0].iou_full_mean > 0.85
    assert rows[0].missed == 0


def test_everything_is_there(tiny_workspace: Workspace) -> None:
    assert tiny_workspace.report.exists()
    assert {path.name for path in tiny_workspace.export("coco").glob("*.json")} == {
        "train.json", "val.json", "test.json"
    }  # fmt: skip
    assert len(list(tiny_workspace.load_labels("00"))) == 6
    table = timings(Ledger(tiny_workspace.stages_file))
    assert list(table) == list(module.STAGES)
    for scene in ("00", "01", "02"):  # a twin brings its poses, and the images agree with them
        kept = tiny_workspace.load_trajectory(tiny_workspace.load_scene(scene)).scene_from_camera
        given = tiny_workspace.load_given(tiny_workspace.load_scene(scene))
        assert given is not None
        np.testing.assert_array_equal(kept, given.scene_from_camera)
    assert table["label"]["frames"] == 18
    assert all(row["seconds"] >= 0 for row in table.values())
    report = tiny_workspace.report.read_text()
    assert report.count("poses drift by") == 3
    assert report.count("clicks of a keypoint are") == 3


def test_second_build_runs_nothing(tiny_workspace: Workspace) -> None:
    watcher = Watcher()
    build(recipe_of(tiny_workspace), tiny_workspace, workers=1, tell=watcher)
    assert watcher.ran == []
    found = stale_steps(recipe_of(tiny_workspace), tiny_workspace)
    assert all(holds for steps in found.values() for _, holds in steps)


def test_only_what_depends_on_a_change_runs(built: tuple[Recipe, Workspace]) -> None:
    recipe, workspace = built
    recording = recipe.scenes[0].path
    watcher = Watcher()
    build(recipe_for(recording, label=LabelRecipe(6.0)), workspace, workers=1, tell=watcher)
    assert watcher.ran == ["label/00", "label/01", "label/02", "export/coco", "report"]
    assert workspace.set_labels_aside("01")
    watcher = Watcher()
    build(recipe_for(recording, label=LabelRecipe(6.0)), workspace, workers=1, tell=watcher)
    assert watcher.ran == ["label/01"]  # made again as it was: nothing after it changes
    assert not workspace.earlier_labels_file("01").exists()
    clicks = recording / "clicks.csv"
    clicks.write_text("\n".join(clicks.read_text().split("\n")[:-2]) + "\n")
    found = stale_steps(recipe, workspace)
    assert found["import"] == [("", False)]  # the file lies in the recording
    watcher = Watcher()
    build(recipe, workspace, until="solve", workers=1, tell=watcher)
    assert watcher.ran == [
        "import", "clicks/carton", "track/00", "track/01", "track/02",
        "drift/00", "drift/01", "drift/02", "cut", "solve/carton",
    ]  # fmt: skip


def test_clicks_in_frames_without_a_pose_are_left_out_and_said(recording: Path, tmp_path: Path) -> None:
    clicked = clicks_from_csv(
        (recording / "clicks.csv").read_text(), source="", object_name="carton",
        keypoints=recipe_for(recording).objects[0].keypoint_names,
    )  # fmt: skip
    frame = next(c.frame for c in clicked if c.scene == "00" and 0 < c.frame < 5)
    poses = recording / "00" / "camera.poses"
    lines = [line for line in poses.read_text().splitlines(keepends=True) if not line.startswith("#")]
    poses.write_text("".join(line for n, line in enumerate(lines) if n != frame))
    ledger = build(recipe_for(recording), Workspace(tmp_path / "workspace"), until="solve", workers=1)
    (entry,) = ledger.of_stage("solve").values()
    told = f"carton: scene 00: clicks in frames {frame} are not used, as the camera's pose is not known there"
    assert told in entry.outcome.messages
    assert entry.outcome.details["clicks"] == sum((c.scene, c.frame) != ("00", frame) for c in clicked)


def test_interrupted_build_goes_on(built: tuple[Recipe, Workspace]) -> None:
    recipe, workspace = built
    for name in workspace.labelled_scene_names():
        workspace.labels_file(name).unlink()

    def interrupt(progress: Progress) -> None:
        if progress.stage == "label" and progress.item == "01" and progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(recipe, workspace, workers=1, tell=interrupt)
    assert [path.name for path in workspace.labels_file("00").parent.iterdir()] == ["00.jsonl"]
    watcher = Watcher()
    build(recipe, workspace, until="label", workers=1, tell=watcher)
    assert watcher.ran == ["label/01", "label/02"]


def test_a_twin_is_the_same_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sources of a twin's scenes are part of what a step depends on, so their paths are absolute."""
    monkeypatch.chdir(tmp_path)
    recipe = Recipe("x", twin=TwinSpec())
    places = Workspace("ws"), Workspace(tmp_path / "ws")
    near, far = (Context(recipe, place, Pool(1)).scene_sources for place in places)
    assert near == far


def test_what_the_segmentation_says_is_worth_knowing(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "stages.json")
    for stage in ("import", "solve", "segment"):
        outcome = Outcome(messages=(f"{stage} speaks",))
        step = Step(stage, "cup", 1, {}, {}, (), (), lambda advance, outcome=outcome: outcome)
        ledger.run(step, lambda done, total: None)
    assert worth_knowing(ledger) == ["solve speaks", "segment speaks"]
    assert worth_knowing(ledger, {"import/cup", "solve/cup"}) == ["solve speaks"]


def test_corrected_frames_are_counted_in_plain_words() -> None:
    said = corrected_line("00", "cup", [0.5], 60, "the camera path")
    assert said.endswith("by 0.5 px; the other labels keep to the camera path")
    assert corrected_line("00", "cup", [1.0, 2.0], 2, "it").endswith("by 1.5 px (median), 2.0 px at most")


def test_how_many_frames_are_labelled_is_said_with_the_way_to_more() -> None:
    def entry(labelled: int, posed: int, rate_hz: float | None) -> Entry:
        outcome = Outcome(labelled, details={"posed": posed})
        return Entry("key", 1, {"rate_hz": rate_hz}, {}, {}, 1.0, outcome)

    (line,) = sparse_labels([entry(6, 148, 3.0), entry(5, 52, 3.0)])
    assert line.startswith("11 of the 200 frames with a camera pose are labelled, 3 per second")
    assert "`label: {rate: all}`" in line
    assert sparse_labels([entry(148, 148, None)]) == []


def test_removed_scene_disappears(built: tuple[Recipe, Workspace]) -> None:
    recipe, workspace = built
    recording = recipe.scenes[0].path
    clicks = recording / "clicks.csv"
    lines = clicks.read_text().splitlines(keepends=True)
    clicks.write_text("".join(line for line in lines if ",02," not in line))
    sources = (SceneSource(recording, names=("00", "01"), metres_per_unit=0.001),)
    fewer = recipe_for(recording, scenes=sources, refine=RefineRecipe(scenes=False))
    labels = workspace.labels_file("02").read_bytes()
    ledger = build(fewer, workspace, until="export", workers=1)
    assert workspace.scene_names() == workspace.labelled_scene_names() == ["00", "01"]
    assert "label/02" not in Ledger(workspace.stages_file).entries
    assert workspace.earlier_labels_file("02").read_bytes() == labels  # its recording may be gone for good
    (line,) = (one for one in ledger.entries["export/coco"].outcome.messages if "earlier build" in one)
    assert line.startswith("scene 02 is left out") and str(workspace.earlier_labels_file("02")) in line


def test_a_path_made_of_the_images_stays_while_the_poses_that_came_do(
    built: tuple[Recipe, Workspace],
) -> None:
    """`track` does not run again when recordings are only read again, as after a build that could not."""
    recipe, workspace = built
    path = workspace.trajectory_file("00")
    scene, made = workspace.load_scene("00"), workspace.trajectory_file("01").read_text()
    came = workspace.load_trajectory(scene).scene_from_camera
    path.write_text(made)
    build(recipe, workspace, until="import", again=("import",), workers=1)
    assert path.read_text() == made
    as_given = replace(recipe, reconstruct=replace(recipe.reconstruct, method="given"))
    track.forget_paths(Context(as_given, workspace, Pool(1)))
    np.testing.assert_allclose(workspace.load_trajectory(scene).scene_from_camera, came, atol=1e-12)


def test_two_scenes_of_one_name_are_refused(recording: Path, tmp_path: Path) -> None:
    sources = (SceneSource(recording), SceneSource(recording))
    with pytest.raises(DataError, match="two scenes are called 00"):
        build(recipe_for(recording, scenes=sources), Workspace(tmp_path / "workspace"), workers=1)


# Steps and the ledger -----------------------------------------------------------------------------


def a_step(path: Path, *, version: int = 1, after: tuple[str, ...] = (), stage: str = "a") -> Step:
    return Step(stage, "", version, {}, stamps(path), after, (path,), lambda advance: Outcome(3, ("said",)))


def test_step_holds_until_something_changes(tmp_path: Path) -> None:
    source, stored = tmp_path / "source", tmp_path / "stages.json"
    source.write_text("1")
    ledger = Ledger(stored)
    assert not ledger.holds(a_step(source))
    ledger.run(a_step(source), lambda done, total: None)
    again = Ledger(stored)
    assert again.holds(a_step(source))
    assert again.entries["a"].outcome == Outcome(3, ("said",))
    assert not again.holds(a_step(source, version=2))
    os.utime(source, ns=(0, 0))
    assert not again.holds(a_step(source))
    source.unlink()
    assert not again.holds(a_step(source))


def test_step_falls_with_the_one_before_it(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.write_text("1")
    ledger = Ledger(tmp_path / "stages.json")
    ledger.run(a_step(source), lambda done, total: None)
    ledger.run(a_step(source, stage="b", after=("a",)), lambda done, total: None)
    assert ledger.holds(a_step(source, stage="b", after=("a",)))
    ledger.run(a_step(source, version=2), lambda done, total: None)
    assert not ledger.holds(a_step(source, stage="b", after=("a",)))


def test_images_are_counted_and_files_stamped(tmp_path: Path) -> None:
    (tmp_path / "rgb").mkdir()
    for name in ("0.png", "1.jpg"):
        (tmp_path / "rgb" / name).write_text("")
    (tmp_path / "poses.txt").write_text("12")
    (tmp_path / "ws").mkdir()
    (tmp_path / "ws" / "own.txt").write_text("")
    found = stamps(tmp_path, but_not=tmp_path / "ws")
    assert found[str(tmp_path / "rgb")][0] == 2
    assert found[str(tmp_path / "poses.txt")][0] == 2
    assert len(found) == 2


def test_files_of_every_frame_are_summed_up_and_only_named_scenes_looked_into(tmp_path: Path) -> None:
    for scene in ("a", "b"):
        (tmp_path / "data" / scene).mkdir(parents=True)
        for number in range(70):
            (tmp_path / "data" / scene / f"{number}.mat").write_text("12")
    (tmp_path / "data" / "classes.txt").write_text("")
    found = stamps(tmp_path, names=["b"])
    assert set(found) == {str(tmp_path / "data/b/*.mat"), str(tmp_path / "data/classes.txt")}
    count, size, newest_ns = found[str(tmp_path / "data/b/*.mat")]
    assert (count, size) == (70, 140)
    os.utime(tmp_path / "data/b/3.mat", ns=(newest_ns + 1, newest_ns + 1))
    assert stamps(tmp_path, names=["b"]) != found
    assert len(stamps(tmp_path)) == 3


# Spheres, meshes, processes -----------------------------------------------------------------------


def test_touching_spheres_become_one_that_holds_both() -> None:
    a, b = Sphere(np.zeros(3), 1.0), Sphere(np.array([1.5, 0, 0]), 1.0)
    (one,) = joined_spheres([a, b])
    np.testing.assert_allclose(one.centre_m, [0.75, 0, 0])
    assert one.radius_m == pytest.approx(1.75)
    assert len(joined_spheres([a, Sphere(np.array([2.5, 0, 0]), 1.0)])) == 2
    (outer,) = joined_spheres([Sphere(np.zeros(3), 0.2), a])
    assert outer.radius_m == 1.0
    far = Sphere(np.array([9.0, 0, 0]), 1.0)
    assert [s.radius_m for s in joined_spheres([far, a, b])] == [1.0, pytest.approx(1.75)]
    chain = [Sphere(np.array([x, 0.0, 0.0]), 1.0) for x in (0.0, 3.0, 1.5)]
    assert [s.radius_m for s in joined_spheres(chain)] == [pytest.approx(2.5)], "the last one ties them"


def test_joined_meshes_keep_their_triangles() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    both = joined_meshes([mesh, mesh])
    np.testing.assert_array_equal(both.triangles, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(both.vertices[both.triangles[1]], np.eye(3))


def test_pool_keeps_the_order_and_equals_one_process() -> None:
    with Pool(2) as pool:
        ranges = pool.ranges(1000)
        assert [b - a for a, b in ranges] == [100] * 10
        assert list(pool.stream(range, ranges)) == list(range(1000))
    assert Pool(1).ranges(1000) == [(0, 1000)]
    with pytest.raises(DataError, match="workers is 0; give 1 or more"):
        Pool(0)


def test_the_order_of_stages_is_that_of_the_build() -> None:
    assert tuple(module.STAGES) == ORDER


def test_planning_changes_nothing(tiny_workspace: Workspace, tmp_path: Path) -> None:
    """What is no longer asked for goes when the build runs, not when it is asked about."""
    root = moved_copy(tiny_workspace.root, tmp_path / "ws")
    workspace = Workspace(root)
    shutil.copy(workspace.labels_file("00"), workspace.labels_file("old_scene"))
    recipe = replace(recipe_of(workspace), refine=RefineRecipe(scenes=False))
    context = Context(recipe, workspace, Pool(1))
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    for plan in STAGES.values():
        plan(context)
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*")} == before
    build(recipe, workspace, until="refine", workers=1)
    assert not workspace.refined_file("carton").exists()
    FORGET["label"](context)
    assert workspace.labelled_scene_names() == ["00", "01", "02"]


def test_a_workspace_is_the_same_however_it_is_named(
    tiny_workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`cd my-workspace; rpl status` and `rpl status --workspace my-workspace` agree."""
    recipe = recipe_of(tiny_workspace)
    for folder in (tiny_workspace.root, tiny_workspace.root.parent):
        monkeypatch.chdir(folder)
        found = stale_steps(recipe, Workspace(tiny_workspace.root.relative_to(folder)))
        assert all(holds for steps in found.values() for _, holds in steps)


def test_a_refused_build_leaves_the_recipe_alone(recording: Path, tmp_path: Path) -> None:
    workspace = Workspace(tmp_path / "ws")
    with alone_in(workspace), pytest.raises(DataError, match="another build is running"):
        build(recipe_for(recording), workspace)
    assert not workspace.recipe_file.exists()
