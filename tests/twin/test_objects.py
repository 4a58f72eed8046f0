"""Objects of a twin: landmarks worth cutting short, meshes of files, and who stands in which scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial import cKDTree

from rpl_data.pipeline.recipe_file import load_recipe, parse_recipe
from rpl_data.twin import TwinSpec
from rpl_data.twin.film import film
from rpl_data.twin.objects import OBJECTS, build, spread_order
from rpl_data.twin.resting import resting_rotations
from rpl_data.twin.spec import Cast, Thing
from rpl_data.types import DataError

RECIPES = Path(__file__).parents[2] / "datasets"


@pytest.mark.parametrize("name", OBJECTS)
def test_every_beginning_of_the_landmarks_fixes_a_pose(name: str) -> None:
    points = build(name).model.points_object
    whole = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
    for count in range(3, len(points) + 1):
        part = points[:count] - points[:count].mean(axis=0)
        second = np.linalg.svd(part, compute_uv=False)[1] / np.sqrt(count)
        assert second > 0.6 * whole  # nowhere near a line


def test_spread_order_takes_the_corners_of_a_tetrahedron_before_what_lies_between() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    middle = corners.mean(axis=0)
    points = np.vstack([middle, corners.mean(axis=0) * 1.1, corners, corners[:2].mean(axis=0)])
    assert set(spread_order(points)[:4]) == {2, 3, 4, 5}


def test_fewer_landmarks_are_the_first_of_all_with_their_own_centroid() -> None:
    every, few = build("drill").model, build(Thing("tool", shape="drill", landmarks=6)).model
    assert few.name == "tool" and few.keypoints == every.keypoints[:6]
    np.testing.assert_allclose(few.points_object.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.diff(few.points_object, axis=0), np.diff(every.points_object[:6], axis=0))
    with pytest.raises(DataError, match="ask for 3 to 12, not 13"):
        build(Thing("drill", landmarks=13))


@pytest.mark.parametrize("name", OBJECTS)
def test_things_rest_in_unlike_poses_on_at_least_three_points(name: str) -> None:
    vertices = build(name).surface.vertices
    rotations = resting_rotations(vertices)[:6]
    assert len(rotations) >= 3
    downs = np.array([rotation[2] for rotation in rotations])
    angles = np.degrees(np.arccos((downs @ downs.T).clip(-1, 1)))[~np.eye(len(downs), dtype=bool)]
    assert angles.min() >= 25
    for rotation in rotations:
        height = vertices @ rotation[2]
        assert (height < height.min() + 0.002).sum() >= 3


# Files --------------------------------------------------------------------------------------------


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A coloured block of 80 x 50 x 30 mm with many triangles, as a PLY."""
    mesh = o3d.geometry.TriangleMesh.create_box(0.08, 0.05, 0.03).subdivide_midpoint(4)
    points = np.asarray(mesh.vertices)
    mesh.vertex_colors = o3d.utility.Vector3dVector(points / points.max(axis=0))
    path = tmp_path / "block.ply"
    o3d.io.write_triangle_mesh(str(path), mesh)
    return path


def test_landmarks_of_a_block_are_its_corners(block: Path) -> None:
    one = build(Thing("block", mesh=block, landmarks=8))
    corners = np.array([[x, y, z] for x in (0, 0.08) for y in (0, 0.05) for z in (0, 0.03)])
    found = one.model.points_object - one.model.points_object.min(axis=0)
    distance, which = cKDTree(corners).query(found)
    assert distance.max() < 0.006 and len(set(which)) == 8


def test_coloured_vertices_become_a_texture(block: Path) -> None:
    surface = build(Thing("block", mesh=block)).surface
    texel = surface.corner_uv * surface.texture.shape[0] - 0.5
    column, row = np.round(texel).astype(int).reshape(-1, 2).T
    np.testing.assert_allclose(texel, np.round(texel), atol=1e-3)
    points = surface.vertices[surface.triangles].reshape(-1, 3)
    share = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    assert np.abs(surface.texture[row, column] - 255 * share).max() <= 1.01


def test_a_mesh_in_millimetres_or_without_triangles_is_refused(block: Path, tmp_path: Path) -> None:
    mesh = o3d.io.read_triangle_mesh(str(block))
    o3d.io.write_triangle_mesh(str(tmp_path / "mm.obj"), mesh.scale(1000, np.zeros(3)))
    with pytest.raises(DataError, match=r"in metres, 0.01 to 2 m"):
        build(Thing("block", mesh=tmp_path / "mm.obj"))
    with pytest.raises(DataError, match="there is no mesh"):
        build(Thing("block", mesh=tmp_path / "none.obj"))


def test_scanned_meshes_have_texture_landmarks_and_resting_poses(real_data: Path) -> None:
    for path in sorted((real_data / "ycb").glob("*/textured.obj")):
        one = build(Thing(path.parent.name, mesh=path, landmarks=12))
        assert one.surface.texture.shape == (1024, 1024, 3)
        points = one.model.points_object
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1)[~np.eye(12, dtype=bool)]
        assert apart.min() > 0.012
        assert len(resting_rotations(one.surface.vertices)) >= 3


# Who stands where ---------------------------------------------------------------------------------


def test_each_scene_has_its_cast_and_its_length() -> None:
    casts = (Cast(("carton",), count=2), Cast(("carton", "cup"), seconds=1.0))
    spec = TwinSpec(objects=("carton", "cup"), scenes=casts, seconds=2.0, keep_hz=3.0, clutter=0)
    spec.check()
    assert [len(film(spec, scene).objects) for scene in range(3)] == [1, 1, 2]
    assert [spec.frames(scene) for scene in range(3)] == [6, 6, 3]
    np.testing.assert_allclose(spec.times_s(0), np.arange(6) / 3, atol=1e-6)
    lying = [film(spec, scene).scene.table_from_object[0][2, :3] for scene in range(3)]
    assert all(a @ b < 0.95 for i, a in enumerate(lying) for b in lying[:i])  # a new pose every time


def test_kept_frames_have_times_of_the_camera() -> None:
    spec = TwinSpec(seconds=2.0, rate_hz=30.0, keep_hz=7.0)
    ticks = spec.times_s(0) * 30
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-4)
    assert set(np.diff(np.round(ticks))) == {4, 5}


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (TwinSpec(scenes=(Cast(("carton",)),)), "every object in at least one"),
        (TwinSpec(objects=("carton",), scenes=(Cast(("cup",)),)), "no other than carton"),
        (TwinSpec(objects=("carton",), scenes=(Cast(("carton",)), Cast(()))), "at least one object in each"),
        (TwinSpec(objects=("carton", Thing("carton"))), "each once"),
        (TwinSpec(seconds=1.0, keep_hz=1.0), "at least 2 frames"),
    ],
)
def test_impossible_casts_are_refused(spec: TwinSpec, message: str) -> None:
    with pytest.raises(DataError, match=message):
        spec.check()


def test_recipes_name_meshes_relative_to_their_root(tmp_path: Path) -> None:
    text = "name: x\ntwin: {objects: [carton, {name: can, mesh: a/can.obj, landmarks: 7}], scenes: 2}\n"
    (tmp_path / "x.yaml").write_text(text)
    recipe = load_recipe(tmp_path / "x.yaml", root=tmp_path / "data")
    assert recipe.twin is not None
    assert recipe.twin.things[1] == Thing("can", mesh=tmp_path / "data" / "a/can.obj", landmarks=7)
    assert recipe.twin.things[0] == Thing("carton")


def test_a_misspelt_key_of_an_object_is_named() -> None:
    with pytest.raises(DataError, match="landmark"):
        parse_recipe({"name": "x", "twin": {"objects": [{"name": "a", "landmark": 3}]}}, source="x.yaml")


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*twin.yaml")), ids=lambda path: path.stem)
def test_recipes_of_twins_can_be_made(path: Path) -> None:
    twin = load_recipe(path).twin
    assert twin is not None
    twin.check()
