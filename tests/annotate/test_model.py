"""Known models from files, meshes to pick on, three clicks in a scene, and the grasp in every file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from annotate_client import OBJECT, act, client_of, unpacked
from fastapi.testclient import TestClient

from rpl_data.formats.models.meshlab import write_picked_points
from rpl_data.formats.models.sparse_model import (
    points_in_first_scene,
    read_grasp,
    read_sparse_model,
    write_sparse_model,
)
from rpl_data.geometry import from_rotvec, rotation_angle_rad, transform
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.exported_labels import export_labels
from rpl_data.types import Mesh, Solution
from rpl_data.workspace.workspace import Workspace

MOVED = from_rotvec(np.array([0.4, -0.9, 0.3]), np.array([0.5, 0.2, -0.7]))
"""A known model is in any frame."""


@pytest.fixture
def client(root: Path) -> TestClient:
    return client_of(root)


@pytest.fixture
def truth(tiny_workspace: Workspace) -> Solution:
    return Workspace(tiny_workspace.truth).load_solution("carton")


def load(client: TestClient, path: Path, unit: float = 1.0) -> Any:
    answer = client.post(f"{OBJECT}/model?file={path.name}&metres_per_unit={unit}", content=path.read_bytes())
    return answer.json() | {"status": answer.status_code}


@pytest.mark.parametrize("kind", ["txt", "pp", "pp in mm"])
def test_three_clicks_place_a_known_model(
    client: TestClient, truth: Solution, tmp_path: Path, kind: str
) -> None:
    points, unit = transform(MOVED, truth.model.points_object), 0.001 if "mm" in kind else 1.0
    path = tmp_path / ("sparse_model.txt" if kind == "txt" else "picked.pp")
    if kind == "txt":
        write_sparse_model(path, points)
    else:
        write_picked_points(path, truth.model.keypoints, points / unit)
    found = load(client, path, unit)
    act(client, {"op": "batch", "events": found["actions"]})
    state = client.get(OBJECT).json()
    np.testing.assert_allclose(np.array(state["known_points"], dtype=float), points, atol=1e-6)
    assert [k["name"] for k in state["keypoints"]] == list(truth.model.keypoints)
    marks = {}
    for mark in state["clicks"]:
        marks.setdefault((mark["scene"], mark["keypoint"]), mark)
    kept = [m for (scene, _), m in marks.items() if scene == "01"][:3]
    for mark in state["clicks"]:
        if mark not in kept:
            act(client, {"op": "delete", **{k: mark[k] for k in ("keypoint", "scene", "frame")}})
    result = client.get(OBJECT + "/result").json()
    place = np.reshape(result["scene_from_object"]["01"], (4, 4))
    centroid = np.nanmean(truth.model.points_object, axis=0)
    true_place = truth.scene_from_object["01"]
    moved = place @ np.vstack([np.column_stack([MOVED[:3, :3], np.zeros(3)]), [0, 0, 0, 1]])
    assert np.degrees(rotation_angle_rad(moved[:3, :3].T @ true_place[:3, :3])) < 5
    assert np.linalg.norm(place[:3, 3] - transform(true_place, centroid[None])[0]) < 0.008


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("sparse_model.txt", b"<SparseObjectPoints></SparseObjectPoints>", "has no point"),
        ("points.pp", b"<PickedPoints", "not a PickedPoints file"),
        ("mesh.ply", b"ply", "Choose a mesh"),
    ],
)
def test_broken_models_are_refused_by_their_own_name(
    client: TestClient, tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    found = load(client, tmp_path / name)
    assert found["status"] == 422 and message in found["error"] and name in found["error"]


def test_millimetres_are_noticed(client: TestClient, truth: Solution, tmp_path: Path) -> None:
    write_sparse_model(tmp_path / "sparse_model.txt", 1e3 * truth.model.points_object)
    assert "millimetres" in load(client, tmp_path / "sparse_model.txt")["error"]


def test_a_mesh_with_picked_keypoints_becomes_the_dense_model(
    client: TestClient,
    root: Path,
    truth: Solution,
    tmp_path: Path,
    tiny_workspace: Workspace,
) -> None:
    from rpl_data.pipeline.stages.segment import segment_steps

    mesh = load_mesh(Workspace(tiny_workspace.truth).mesh_file("carton"))
    save_mesh(tmp_path / "cad.ply", Mesh(1e3 * transform(MOVED, mesh.vertices), mesh.triangles))
    assert load(client, tmp_path / "cad.ply", 0.001)["actions"] == []
    shown = client.get(OBJECT + "/given").json()
    vertices = unpacked(shown["points"], "<f4")
    np.testing.assert_allclose(
        np.ptp(vertices, axis=0), np.ptp(transform(MOVED, mesh.vertices), axis=0), atol=1e-4
    )
    act(client, {"op": "model", "points": transform(MOVED, truth.model.points_object).tolist()})
    workspace = Workspace(root)
    (step,) = segment_steps(context_of(workspace))
    outcome = step.run(lambda done, total: None)
    assert "given mesh" in outcome.messages[0]
    made = load_mesh(workspace.mesh_file("carton")).vertices
    expected = transform(MOVED, mesh.vertices) - transform(MOVED, truth.model.points_object).mean(axis=0)
    np.testing.assert_allclose(made, expected, atol=1e-6)
    client.delete(OBJECT + "/given")
    assert client.get(OBJECT + "/given").json() is None
    (step,) = segment_steps(context_of(workspace))
    assert step.sources == {}


def test_a_grasp_is_in_the_result_in_both_files_and_in_the_export(
    client: TestClient,
    root: Path,
    tmp_path: Path,
    tiny_workspace: Workspace,
) -> None:
    label = next(iter(tiny_workspace.load_labels("00"))).instances[0]
    seen = label.keypoints_px[label.visibility == 2]
    (u, v), (tu, tv) = seen.mean(axis=0), seen[0]
    grasp = {"op": "grasp", "scene": "00", "frame": 0, "u_px": u, "v_px": v}
    act(client, {**grasp, "toward_u_px": tu, "toward_v_px": tv})
    result = client.get(OBJECT + "/result").json()
    object_from_grasp = np.reshape(result["grasp"], (4, 4))
    assert np.linalg.det(object_from_grasp[:3, :3]) == pytest.approx(1, abs=1e-5)
    vertices = load_mesh(Workspace(root).mesh_file("carton")).vertices
    assert np.linalg.norm(vertices - object_from_grasp[:3, 3], axis=1).min() < 0.006  # on the surface
    outward = object_from_grasp[:3, :3][:, 2] @ (object_from_grasp[:3, 3] - vertices.mean(axis=0))
    assert outward > 0
    path = tmp_path / "sparse_model.txt"
    path.write_text(client.get(OBJECT + "/sparse_model.txt").text)
    solution = Workspace(root).load_solution("carton")
    np.testing.assert_allclose(read_sparse_model(path), points_in_first_scene(solution), atol=1e-6)
    np.testing.assert_allclose(
        read_grasp(path), solution.scene_from_object["00"] @ object_from_grasp, atol=1e-5
    )
    export_labels(context_of(Workspace(root)))
    exported = json.loads(next(Workspace(root).export("coco").glob("*.json")).read_text())
    (described,) = exported["rpl"]["objects"]
    placed = Workspace(root).load_placed("carton")  # with the frame of the refined keypoints
    np.testing.assert_allclose(
        placed.scene_from_object["00"] @ np.reshape(described["object_from_grasp"], (4, 4)),
        solution.scene_from_object["00"] @ object_from_grasp,
        atol=1e-5,
    )
    saved = json.loads(Workspace(root).grasp_file("carton").read_text())
    np.testing.assert_allclose(saved["object_from_grasp"], described["object_from_grasp"], atol=1e-9)
    act(client, {"op": "undo"})
    export_labels(context_of(Workspace(root)))
    assert not Workspace(root).grasp_file("carton").exists()
