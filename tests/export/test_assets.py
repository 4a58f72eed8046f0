"""The objects as textured meshes: the right unit, the right colours in the right places."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from labelled_scenes import BOX, CAN, labelled_scene

from rpl_data.export import export_assets, export_coco
from rpl_data.export.split import SplitRule
from rpl_data.export.texture import save_textured
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.types import DataError, Mesh

RED, GREEN = (200, 30, 30), (30, 180, 60)


def two_coloured_sphere(radius_m: float) -> Mesh:
    """Red above, green below."""
    ball = o3d.geometry.TriangleMesh.create_sphere(radius_m, resolution=20)
    vertices = np.asarray(ball.vertices).copy()
    colors = np.where(vertices[:, 2:] > 0, RED, GREEN).astype(np.uint8)
    return Mesh(vertices, np.asarray(ball.triangles).astype(np.int64), colors)


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("assets")
    save_mesh(root / "ball.ply", two_coloured_sphere(0.05))
    scene = labelled_scene(root / "recording", "desk")
    meshes = {"box": root / "ball.ply"}
    export_coco(root / "coco", [scene], [BOX, CAN], split=SplitRule(0, 0.0), meshes=meshes)
    summary = export_assets(root / "assets", root / "coco")
    assert summary.messages == ("can has no dense model, so no mesh",)
    return root / "assets"


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_a_textured_mesh_in_metres(assets: Path, suffix: str) -> None:
    """Read back by Open3D: each corner of each triangle has the colour of its side in the texture."""
    model = o3d.io.read_triangle_model(str(assets / f"box_m.{suffix}"))
    mesh = model.meshes[0].mesh
    np.testing.assert_allclose(mesh.get_max_bound() - mesh.get_min_bound(), 0.1, rtol=0.02)
    image = np.asarray(model.materials[0].albedo_img)[..., :3]
    height, width = image.shape[:2]
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)].mean(axis=1)
    uv = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2).mean(axis=1)
    column, row = (uv[:, 0] * width).astype(int), ((1 - uv[:, 1]) * height).astype(int)
    clear = np.abs(corners[:, 2]) > 0.01
    wanted = np.where(corners[clear, 2:] > 0, RED, GREEN)
    found = image[row[clear].clip(0, height - 1), column[clear].clip(0, width - 1)].astype(int)
    assert (np.abs(found - wanted).max(axis=1) < 40).mean() > 0.97


def test_a_surface_with_fins_flaps_and_touching_tips_is_textured(tmp_path: Path) -> None:
    """Open3D unwraps none of them as they are; no triangle is lost but the second side of the flap."""
    ball = two_coloured_sphere(0.05)
    a, b, c = ball.triangles[100]
    extra = np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0], [0.02, 0.0, 0.12], [-0.02, 0.0, 0.12]])
    fin, tip = len(ball.vertices), len(ball.vertices) + 2
    triangles = [(a, b, fin), (b, c, fin + 1), (c, b, fin + 1), (0, tip, tip + 1)]
    mesh = Mesh(
        np.concatenate([ball.vertices, extra]),
        np.concatenate([ball.triangles, np.array(triangles)]),
        np.concatenate([ball.colors, np.zeros((4, 3), np.uint8)]),
    )
    save_textured(mesh, [tmp_path / "ball.obj"])
    found = o3d.io.read_triangle_mesh(str(tmp_path / "ball.obj"))
    assert len(found.triangles) == len(mesh.triangles) - 1
    np.testing.assert_allclose(found.get_max_bound(), mesh.vertices.max(axis=0), atol=1e-5)


def test_millimetres_and_facts(assets: Path) -> None:
    mesh = load_mesh(assets / "box_mm.ply")
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), 100, rtol=0.02)
    facts = json.loads((assets / "box.json").read_text())
    assert facts["closed"] and facts["open_edges"] == 0 and list(facts["keypoints_m"]) == list(BOX.keypoints)
    np.testing.assert_allclose(facts["size_m"], 0.1, rtol=0.02)


def test_a_surface_without_charts_is_a_data_error(tmp_path: Path) -> None:
    """A triangle without area, as a damaged mesh has it."""
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), None)
    with pytest.raises(DataError, match="charts"):
        save_textured(flat, [tmp_path / "flat_m.glb"])
