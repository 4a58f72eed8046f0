"""The folder of a dataset: what is saved is loaded, and nothing half-written remains."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rpl_data import images as pixels
from rpl_data import meshes as surface_files
from rpl_data.clicks.log import click_event, keypoints_event
from rpl_data.geometry import from_rotvec
from rpl_data.types import (
    Click,
    DataError,
    Frame,
    FrameLabel,
    Intrinsics,
    KeypointModel,
    Mesh,
    PointCloud,
    Recording,
    Scene,
    Solution,
    Trajectory,
)
from rpl_data.workspace import workspace as ws
from rpl_data.workspace.paths import Paths

FullDisk = Callable[[int], AbstractContextManager[None]]
RNG = np.random.default_rng(3)
CUBE = KeypointModel("cube", ("a",), np.zeros((1, 3)))


def make_scene(folder: Path, *, frames: int = 4, no_depth_units: tuple[int, ...] = ()) -> Scene:
    listed = tuple(
        Frame(2 * i, 1.1e9 + i / 30, folder / f"{i}.png", folder / f"{i}.depth.png") for i in range(frames)
    )
    camera = Intrinsics(50.0, 50.0, 4.0, 3.0, 8, 6)
    return Scene("00", camera, 0.001, listed, no_depth_units=no_depth_units)


@pytest.fixture
def workspace(tmp_path: Path) -> ws.Workspace:
    return ws.Workspace(tmp_path / "workspace")


def test_recording_and_trajectory_round_trip(workspace: ws.Workspace, tmp_path: Path) -> None:
    scene = make_scene(tmp_path)
    poses = np.array([from_rotvec(RNG.normal(size=3), RNG.normal(size=3)) for _ in range(3)])
    trajectory = Trajectory(np.array([0, 2, 6]), poses)  # frame 4 has no pose
    workspace.save_recording(Recording(scene, trajectory, ("skipped",), ("note",)))
    assert workspace.scene_names() == ["00"]
    assert workspace.load_recording("00") == Recording(scene, None, ("skipped",), ("note",))
    assert workspace.load_scene("00") == scene
    loaded = workspace.load_trajectory(scene)
    assert loaded.frames.tolist() == [0, 2, 6]
    np.testing.assert_allclose(loaded.scene_from_camera, poses, atol=1e-12)
    np.testing.assert_allclose(loaded.at(6), poses[2], atol=1e-12)


def test_a_trajectory_without_poses(workspace: ws.Workspace, tmp_path: Path) -> None:
    scene = make_scene(tmp_path)
    workspace.save_trajectory(scene, Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4))))
    assert workspace.load_trajectory(scene).scene_from_camera.shape == (0, 4, 4)


def save(workspace: ws.Workspace, scene: Scene) -> None:
    workspace.save_recording(Recording(scene, None))


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (lambda w, s: w.load_scene("07"), r"has no scene '07'; it has \[\]"),
        (lambda w, s: w.load_trajectory(s), "scene 00 has no trajectory yet"),
        (lambda w, s: w.load_solution("cup"), "there is no object cup in .*its objects are: none"),
        (
            lambda w, s: [w.append_events("cup", []), w.load_solution("cup")],
            "cup has no solution yet; run `rpl solve`",
        ),
        (lambda w, s: [save(w, s), *w.load_labels("00")], "scene 00 has no labels yet; run `rpl label`"),
        (lambda w, s: list(w.load_labels("00")), "there is no scene 00 in .*Scenes with labels: none"),
        (lambda w, s: surface_files.load_mesh(w.mesh_file("cup")), "there is no mesh"),
        (lambda w, s: surface_files.load_cloud(w.cloud_file("cup")), "there is no point cloud"),
        (lambda w, s: s.frame(1), "scene 00 has no frame 1: it has 4 frames, 0 to 6"),
        (lambda w, s: Trajectory(np.array([0, 2]), np.zeros((2, 4, 4))).at(1), "no pose for frame 1"),
        (lambda w, s: Trajectory(np.array([0, 2]), np.zeros((2, 4, 4))).at(3), "no pose for frame 3"),
    ],
)
def test_what_is_not_there_is_named(
    workspace: ws.Workspace, tmp_path: Path, load: object, message: str
) -> None:
    assert callable(load)
    with pytest.raises(DataError, match=message):
        load(workspace, make_scene(tmp_path))


# Clicks


def test_events_are_appended(workspace: ws.Workspace) -> None:
    click = Click("cube", 0, "00", 3, 1.0, 2.0)
    workspace.append_events("cube", [keypoints_event(["a"])])
    workspace.append_events("cube", [click_event(click), {"op": "undo"}, {"op": "redo"}])
    annotation = workspace.load_annotation("cube")
    assert (annotation.keypoints, annotation.clicks) == (("a",), (click,))
    assert workspace.object_names() == ["cube"]
    assert workspace.load_events("nothing") == []


def test_a_last_line_cut_by_a_crash_is_left_out(workspace: ws.Workspace) -> None:
    clicks = [Click("cube", 0, "00", frame, 1.0, 2.0) for frame in range(3)]
    workspace.append_events("cube", map(click_event, clicks))
    path = workspace.clicks_file("cube")
    path.write_text(path.read_text()[:-9])
    assert workspace.load_annotation("cube").clicks == tuple(clicks[:2])
    # The next click is written behind the crash: neither it nor the others may be lost.
    workspace.append_events("cube", [click_event(clicks[2])])
    assert workspace.load_annotation("cube").clicks == tuple(clicks)


def test_a_full_disk_saves_all_events_or_none(workspace: ws.Workspace, full_disk: FullDisk) -> None:
    workspace.append_events("cube", [keypoints_event(["a"])])
    before = workspace.clicks_file("cube").read_bytes()
    with full_disk(len(before) + 100), pytest.raises(DataError, match="the last action was not saved"):
        workspace.append_events("cube", [click_event(Click("cube", 0, "00", 3, 1.0, 2.0))] * 5)
    assert workspace.clicks_file("cube").read_bytes() == before


def test_a_mesh_on_a_full_disk_leaves_the_old_one(workspace: ws.Workspace, full_disk: FullDisk) -> None:
    path = workspace.mesh_file("cube")
    surface_files.save_mesh(path, Mesh(np.eye(3), np.array([[0, 1, 2]])))
    many = Mesh(RNG.normal(size=(3000, 3)), np.arange(3000).reshape(-1, 3))
    with full_disk(4096), pytest.raises(DataError, match="cannot write"):
        surface_files.save_mesh(path, many)
    assert len(surface_files.load_mesh(path).vertices) == 3
    assert list(path.parent.iterdir()) == [path]


def test_a_broken_line_within_the_log_is_named(workspace: ws.Workspace) -> None:
    workspace.append_events("cube", [keypoints_event(["a"])] * 3)
    path = workspace.clicks_file("cube")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[1][:-4], lines[2]]) + "\n")
    with pytest.raises(DataError, match=r"clicks.jsonl line 2 is damaged.*delete that line"):
        workspace.load_events("cube")


def test_clicks_that_cannot_be_saved_say_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="the last action was not saved"):
        ws.Workspace(tmp_path / "file").append_events("cube", [{"op": "undo"}])


# Solutions and labels


def test_labels_follow_the_refined_solution_until_it_is_solved_again(tmp_path: Path) -> None:
    workspace = ws.Workspace(tmp_path)
    clicked = Solution(CUBE, np.zeros((1, 3, 3)), {"00": np.eye(4)})
    nudged = from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.002]))
    refined = replace(clicked, scene_from_object={"00": nudged})
    workspace.save_solution(clicked)
    assert workspace.load_placed("cube").scene_from_object["00"][2, 3] == 0
    workspace.save_refined(refined)
    assert workspace.load_placed("cube").scene_from_object["00"][2, 3] == 0.002
    assert workspace.load_solution("cube").scene_from_object["00"][2, 3] == 0
    workspace.save_solution(clicked)
    assert workspace.load_placed("cube").scene_from_object["00"][2, 3] == 0


def test_solution_round_trip(workspace: ws.Workspace) -> None:
    workspace.save_solution(Solution(CUBE, np.zeros((1, 3, 3)), {"00": np.eye(4)}))
    assert workspace.load_solution("cube").model.keypoints == ("a",)
    assert workspace.object_names() == ["cube"]


def test_labels_are_streamed(workspace: ws.Workspace) -> None:
    labels = [FrameLabel("00", i, i / 30) for i in range(5)]
    assert workspace.save_labels("00", iter(labels)) == 5
    assert list(workspace.load_labels("00")) == labels
    assert workspace.labelled_scene_names() == ["00"]


def test_labels_that_fail_half_way_leave_the_old_ones(workspace: ws.Workspace) -> None:
    def failing() -> Iterator[FrameLabel]:
        yield FrameLabel("00", 7, 0.0)
        raise DataError("frame 8 is broken")

    workspace.save_labels("00", [FrameLabel("00", 1, 0.0)])
    with pytest.raises(DataError, match="frame 8"):
        workspace.save_labels("00", failing())
    assert [label.frame for label in workspace.load_labels("00")] == [1]
    assert len(list(workspace.labels_file("00").parent.iterdir())) == 1


# Pixels


def test_color_is_rgb(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.full((6, 8, 3), (1, 2, 3), np.uint8))  # BGR
    assert pixels.read_color(make_scene(tmp_path).frames[0])[0, 0].tolist() == [3, 2, 1]


def test_depth_is_metres_and_zero_is_none(tmp_path: Path) -> None:
    raw = np.full((6, 8), 1500, np.uint16)
    raw[0, 0], raw[0, 1] = 0, 65535
    cv2.imwrite(str(tmp_path / "0.depth.png"), raw)
    scene = make_scene(tmp_path, no_depth_units=(65535,))
    depth_m = pixels.read_depth_m(scene, scene.frames[0])
    assert depth_m.dtype == np.float32
    np.testing.assert_allclose(depth_m[0, :3], [0, 0, 1.5])


@pytest.mark.parametrize(
    ("image", "found"),
    [
        (np.zeros((6, 8), np.uint8), r"found uint8 \(6, 8\)"),
        (np.zeros((8, 6), np.uint16), r"found uint16 \(8, 6\)"),
        (None, "found nothing readable"),
    ],
)
def test_depth_of_another_kind_is_refused(tmp_path: Path, image: np.ndarray | None, found: str) -> None:
    if image is not None:
        cv2.imwrite(str(tmp_path / "0.depth.png"), image)
    scene = make_scene(tmp_path)
    with pytest.raises(DataError, match=rf"scene 00, frame 0: .* 16-bit image of 8 x 6 px, {found}"):
        pixels.read_depth_m(scene, scene.frames[0])


def test_broken_colour_is_named(tmp_path: Path) -> None:
    frame = make_scene(tmp_path).frames[1]
    frame.color.write_bytes(b"\x89PNG")
    with pytest.raises(DataError, match="frame 2: cannot read the colour image"):
        pixels.read_color(frame)


# Surfaces


def test_mesh_and_cloud_round_trip(workspace: ws.Workspace) -> None:
    vertices, colors = RNG.normal(size=(4, 3)), RNG.integers(0, 256, (4, 3)).astype(np.uint8)
    mesh = Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), colors)
    surface_files.save_mesh(workspace.mesh_file("cube"), mesh)
    back = surface_files.load_mesh(workspace.mesh_file("cube"))
    np.testing.assert_allclose(back.vertices, vertices, atol=1e-6)
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    np.testing.assert_array_equal(back.colors, colors)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    surface_files.save_cloud(workspace.cloud_file("cube"), PointCloud(vertices, normals))
    cloud = surface_files.load_cloud(workspace.cloud_file("cube"))
    np.testing.assert_allclose(cloud.points, vertices, atol=1e-6)
    np.testing.assert_allclose(cloud.normals, normals, atol=1e-6)
    assert cloud.colors is None
    with pytest.raises(DataError, match="holds no triangles"):
        surface_files.load_mesh(workspace.cloud_file("cube"))
    assert len(list(workspace.mesh_file("cube").parent.iterdir())) == 2


def test_a_mesh_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(DataError, match="cannot write"):
        surface_files.save_mesh(tmp_path / "file/mesh.ply", mesh)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_scene_json_names_pixels_in_place(workspace: ws.Workspace, tmp_path: Path) -> None:
    workspace.save_recording(Recording(make_scene(tmp_path), None))
    data = json.loads(workspace.scene_file("00").read_text())
    assert data["frames"][1] == {
        "index": 2, "timestamp_s": 1.1e9 + 1 / 30, "color": str(tmp_path / "1.png"),
        "depth": str(tmp_path / "1.depth.png"),
    }  # fmt: skip


def test_no_name_leads_out_of_the_workspace(tmp_path: Path) -> None:
    """Every file and folder that is named after a scene or an object."""
    named = [
        name
        for name, method in vars(Paths).items()
        if inspect.isfunction(method) and not name.startswith("__") and name not in ("export", "upload_log")
        if len(inspect.signature(method).parameters) == 2
    ]
    assert len(named) > 15
    for name in named:
        for wrong in ("..", "../../etc", "a/b", ""):
            with pytest.raises(DataError, match="cannot be the name of"):
                getattr(Paths(tmp_path), name)(wrong)
