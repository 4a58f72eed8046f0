"""Section III-D on a box that stands on a table: its dense model is the box, without the table."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from rpl_data.geometry import Transform, invert, rigid, transform
from rpl_data.pipeline.stages.surface import joined_meshes
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.segment.free_space import DepthView
from rpl_data.segment.mask_votes import MaskView
from rpl_data.segment.region_growing import height_above
from rpl_data.segment.scene_regions import grown_regions
from rpl_data.segment.segment import DenseModel, segment_object
from rpl_data.types import DataError, Intrinsics, KeypointModel, Mesh, Solution

SIZE_M = np.array([0.12, 0.08, 0.06])
CORNERS = SIZE_M * (np.array(list(product((0, 1), repeat=3))) - 0.5)
STEP_M = 0.003
NOISE_M = 0.0005
TABLE_M = 0.25
"""Half the edge of the square of table that each scene's surface holds."""
TURNED = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
"""The rotation that stands the box on another face: its x axis points down, along -z of the scene."""


def sheet(corner: np.ndarray, a: np.ndarray, b: np.ndarray) -> Mesh:
    """A parallelogram in small triangles; its normal is along a x b."""
    rows, columns = (round(float(np.linalg.norm(edge)) / STEP_M) + 1 for edge in (a, b))
    i, j = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    vertices = corner + i.reshape(-1, 1) * a + j.reshape(-1, 1) * b
    number = np.arange(rows * columns).reshape(rows, columns)
    p, q, r, s = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return Mesh(vertices, np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])]))


def box_faces(hidden: tuple[int, int]) -> list[Mesh]:
    """The faces of the box in the object frame, but for the one (axis, sign) that it stands on."""
    faces = []
    for axis, sign in product(range(3), (-1, 1)):
        a, b = np.eye(3)[(axis + 1) % 3] * SIZE_M, np.eye(3)[(axis + 2) % 3] * SIZE_M
        if (axis, sign) != hidden:
            low = -SIZE_M / 2 + (sign > 0) * np.eye(3)[axis] * SIZE_M
            faces.append(sheet(low, a, b) if sign > 0 else sheet(low, b, a))
    return faces


def table_around(low: np.ndarray, high: np.ndarray) -> list[Mesh]:
    """The plane z = 0 of a scene around the rectangle that the box covers."""
    x, y = np.eye(3)[:2]
    edges_x, edges_y = [-TABLE_M, low[0], high[0], TABLE_M], [-TABLE_M, low[1], high[1], TABLE_M]
    return [
        sheet(edges_x[i] * x + edges_y[j] * y, np.diff(edges_x)[i] * x, np.diff(edges_y)[j] * y)
        for i, j in product(range(3), repeat=2)
        if (i, j) != (1, 1)
    ]


def surface(scene_from_object: Transform, hidden: tuple[int, int], seed: int) -> Mesh:
    """The surface of a scene, scene frame: the box on the table, with the noise of a fused surface."""
    faces = [Mesh(transform(scene_from_object, face.vertices), face.triangles) for face in box_faces(hidden)]
    corners = transform(scene_from_object, CORNERS)
    whole = joined_meshes([*faces, *table_around(corners.min(axis=0), corners.max(axis=0))])
    noise_m = np.random.default_rng(seed).normal(0, NOISE_M, whole.vertices.shape)
    return Mesh(whole.vertices + noise_m, whole.triangles)


def two_scenes() -> tuple[dict[str, Mesh], Solution]:
    """The box on its bottom, and on its side at another place; every face is seen in one of the scenes."""
    yaw = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    poses = {
        "00": rigid(np.eye(3), np.array([0.02, -0.01, SIZE_M[2] / 2])),
        "01": rigid(TURNED, np.array([-0.03, 0.02, SIZE_M[0] / 2])),
    }
    surfaces = {"00": surface(poses["00"], (2, -1), 0), "01": surface(poses["01"], (0, 1), 1)}
    world = {"00": rigid(yaw, np.array([1.0, 2, 3])), "01": rigid(yaw.T, np.array([-1.0, 0, 0.5]))}
    moved = {n: Mesh(transform(world[n], m.vertices), m.triangles) for n, m in surfaces.items()}
    names = tuple(str(k) for k in range(8))
    model = KeypointModel("box", names, CORNERS)
    return moved, Solution(model, np.zeros((8, 3, 3)), {n: world[n] @ poses[n] for n in poses})


@pytest.fixture(scope="module")
def dense() -> DenseModel:
    return segment_object(*two_scenes())


def inside(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Which points a closed mesh contains, as Open3D counts crossings."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.triangles.astype(np.uint32))
    )
    found: np.ndarray = scene.compute_occupancy(o3d.core.Tensor(points.astype(np.float32))).numpy() > 0
    return found


def test_the_dense_model_is_the_box_to_a_millimetre(dense: DenseModel) -> None:
    axes = [np.arange(-0.6 * size - 0.02, 0.6 * size + 0.02, 0.002) for size in SIZE_M]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    true, found = (np.abs(points) < SIZE_M / 2).all(axis=1), inside(dense.mesh, points)
    a_millimetre_too_small = np.prod(SIZE_M - 0.002) / np.prod(SIZE_M)
    assert (true & found).sum() / (true | found).sum() > a_millimetre_too_small
    assert dense.open_edges == 0


def test_the_support_is_removed(dense: DenseModel) -> None:
    beyond_m = (np.abs(dense.cloud.points) - SIZE_M / 2).max(axis=1)
    assert beyond_m.max() < 0.004
    assert (np.abs(dense.mesh.vertices) - SIZE_M / 2).max() < 0.004


def test_each_region_is_what_its_scene_saw() -> None:
    surfaces, solution = two_scenes()
    regions = grown_regions(surfaces, solution)
    assert set(regions) == {"00", "01"}
    faces_down = {"00": (2, -1), "01": (0, 1)}
    for scene, (axis, sign) in faces_down.items():
        offset_m = np.abs(regions[scene].points[:, axis] - sign * SIZE_M[axis] / 2)
        facing_down = regions[scene].normals[:, axis] * sign > 0.9
        assert not (facing_down & (offset_m < 0.002)).any()
        opposite = regions[scene].normals[:, axis] * sign < -0.9
        assert opposite.sum() > 0.5 * np.prod(np.delete(SIZE_M, axis)) / STEP_M**2


def test_a_scene_without_a_surface_at_the_keypoints_is_named() -> None:
    surfaces, solution = two_scenes()
    far = Mesh(surfaces["01"].vertices + 1.0, surfaces["01"].triangles)
    found = segment_object({"00": surfaces["00"], "01": far}, solution)
    assert found.warnings == ("scene 01 has no surface at the keypoints",)
    with pytest.raises(
        DataError, match="within 8 mm of 0 of them in scene 01; so most keypoints are not where depth"
    ):
        segment_object({"01": far}, solution)


def test_an_object_that_other_scenes_see_through_is_refused() -> None:
    surfaces, solution = two_scenes()
    poses = {"00": solution.scene_from_object["00"], "01": np.eye(4), "02": np.eye(4)}
    corner, x, y = np.array([-0.15, -0.15, 0]), np.array([0.3, 0, 0]), np.array([0, 0.3, 0])
    for scene, height_m in {"01": -0.037, "02": 0.0}.items():  # no box stands there
        surfaces[scene] = sheet(corner + [0, 0, height_m], x, y)
    away = np.full((CAMERA.height, CAMERA.width), 3.0, np.float32)
    views = [DepthView("01", CAMERA, rigid(np.eye(3), np.array([0, 0, z])), away) for z in (0.45, 0.5)]
    with pytest.raises(DataError, match=r"other scenes see through all of its surface in 1 scene \(00\)"):
        segment_object(surfaces, replace(solution, scene_from_object=poses), depth_views=views)


def test_height_is_known_only_straight_above_the_surface() -> None:
    from scipy.spatial import cKDTree

    from rpl_data.meshes import oriented_points

    flat = oriented_points(sheet(np.zeros(3), np.array([0.03, 0, 0]), np.array([0, 0.03, 0])))
    points = np.array([[0.015, 0.015, 0.01], [0.015, 0.015, -0.01], [0.08, 0.015, 0.01]])
    height_m = height_above(flat, cKDTree(flat.points), points)
    np.testing.assert_allclose(height_m, [0.01, -0.01, np.nan], atol=1e-12)


# Given masks --------------------------------------------------------------------------------------

CAMERA = Intrinsics(300.0, 300.0, 119.5, 89.5, 240, 180)
BESIDE = np.array([0.0, SIZE_M[1], 0.0])
"""Where the same box stands once more, flush and in both scenes, as an object on its stand does."""


def flush_neighbour(scene_from_object: Transform, hidden: tuple[int, int], seed: int) -> Mesh:
    """The surface of a scene in which the box touches its twin, object frame: no edge parts the two."""
    own = [face for face in box_faces(hidden) if face.vertices[:, 1].min() < SIZE_M[1] / 2 - 1e-6]
    other = [Mesh(face.vertices + BESIDE, face.triangles) for face in box_faces(hidden)]
    other = [face for face in other if face.vertices[:, 1].max() > SIZE_M[1] / 2 + 1e-6]
    corners = transform(scene_from_object, np.concatenate([CORNERS, CORNERS + BESIDE]))
    table = joined_meshes(table_around(corners.min(axis=0), corners.max(axis=0)))
    table = Mesh(transform(invert(scene_from_object), table.vertices), table.triangles)
    whole = joined_meshes([*own, *other, table])
    noise_m = np.random.default_rng(seed).normal(0, NOISE_M, whole.vertices.shape)
    return Mesh(whole.vertices + noise_m, whole.triangles)


def seen_from(
    scene: str, frame: int, surface: Mesh, up: np.ndarray, *, empty: bool, camera: Intrinsics = CAMERA
) -> MaskView:
    """Depth of the surface from above and aside, and the true mask of the box alone; or an empty one."""
    turn = 2 * np.pi * frame / 6
    aside = np.linalg.svd(up[None])[2][1:]  # two axes across
    towards = 0.75 * up + 0.6 * (np.cos(turn) * aside[0] + np.sin(turn) * aside[1])
    forward = -towards / np.linalg.norm(towards)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    rotation = np.array([right, np.cross(forward, right), forward])
    pose = rigid(rotation, np.array([0, 0, 0.45]))
    window = {"left_px": 0, "top_px": 0, "width": camera.width, "height": camera.height}
    depth_m = render_depth_m(RayScene([surface]), camera, pose, **window)
    box_m = render_depth_m(RayScene([joined_meshes(box_faces((9, 9)))]), camera, pose, **window)
    mask = (box_m > 0) & (np.abs(box_m - depth_m) < 0.005) & (not empty)
    return MaskView(frame, DepthView(scene, camera, pose, depth_m), mask)


def test_masks_part_what_no_edge_parts() -> None:
    _, solution = two_scenes()
    standing, pose = rigid(np.eye(3), np.array([0, 0, SIZE_M[2] / 2])), solution.scene_from_object["00"]
    own = flush_neighbour(standing, (2, -1), 0)
    views = [seen_from("00", n, own, np.array([0.0, 0, 1]), empty=n == 2) for n in range(6)]
    glued = {"00": Mesh(transform(pose, own.vertices), own.triangles)}

    def beyond_m(points: np.ndarray) -> float:
        return float((np.abs(points) - SIZE_M / 2).max())

    without = grown_regions(glued, solution)["00"]
    assert beyond_m(without.points) > 0.9 * SIZE_M[1]  # the other box is taken along
    parted = segment_object(glued, solution, mask_views=views)
    assert beyond_m(parted.cloud.points) < 0.02  # the votes end 5 px, 8 mm, beside the outline
    assert [line for line in parted.warnings if "out-voted" in line and line.endswith("not used: 2")]


# Objects without depth ----------------------------------------------------------------------------


def test_what_depth_does_not_show_is_carved() -> None:
    surfaces, solution = two_scenes()
    wide = Intrinsics(240.0, 240.0, 159.5, 119.5, 320, 240)
    measured, holes, masks = [], [], []
    for scene, up in {"00": np.array([0.0, 0, 1]), "01": np.array([-1.0, 0, 0])}.items():
        points = transform(invert(solution.scene_from_object[scene]), surfaces[scene].vertices)
        whole = Mesh(points, surfaces[scene].triangles)
        below = (points @ up).min() * up  # the table, larger than any view of it
        corners = [below + x * np.roll(up, 1) + y * np.roll(up, 2) for x, y in product((-1, 1), repeat=2)]
        table = Mesh(np.array(corners), np.array([[0, 1, 2], [1, 2, 3]]))
        for n in range(4):
            shot = seen_from(scene, n, joined_meshes([whole, table]), up, empty=False, camera=wide)
            measured.append(shot.view)
            holes.append(replace(shot.view, depth_m=np.where(shot.mask, 0, shot.view.depth_m)))
            masks.append(replace(shot, view=holes[-1]))
        on_table = ((np.abs(points) - SIZE_M / 2).max(axis=1) > 0.004)[whole.triangles].all(axis=1)
        surfaces[scene] = replace(surfaces[scene], triangles=whole.triangles[on_table])

    dense = segment_object(surfaces, solution, depth_views=holes, mask_views=masks, voxel_m=0.006)
    axes = [np.arange(-0.6 * size - 0.02, 0.6 * size + 0.02, 0.004) for size in SIZE_M]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    true, found = (np.abs(points) < SIZE_M / 2).all(axis=1), inside(dense.mesh, points)
    assert (found & true).sum() > 0.95 * true.sum() and found.sum() < 1.7 * true.sum()
    assert not dense.seen.any() and dense.open_edges == 0
    assert dense.carved
    assert "hardly any depth is measured on it" in dense.warnings[0] and "not used" in dense.warnings[1]

    risen = replace(solution.model, points_object=CORNERS + [0.1, 0, 0.1])  # where the cameras saw through
    for placed, views in ((solution, measured), (replace(solution, model=risen), holes)):
        with pytest.raises(DataError, match="no dense model grows"):
            segment_object(surfaces, placed, depth_views=views, voxel_m=0.006)
