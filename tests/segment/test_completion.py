"""Closing the sides nobody saw: as far out as no camera saw through, and marked as not seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rpl_data.geometry import project
from rpl_data.meshes import load_mesh, save_mesh
from rpl_data.segment.completion import closed_mesh, open_edges
from rpl_data.segment.free_space import DepthView, free_share, witnesses
from rpl_data.types import Intrinsics, Mesh, PointCloud

CAMERA = Intrinsics(200.0, 200.0, 79.5, 59.5, 160, 120)
SIDES = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
BOTTOM = (2, -1)


def box_sides(low: np.ndarray, high: np.ndarray, without: tuple[tuple[int, int], ...] = ()) -> PointCloud:
    """Points 3 mm apart on the sides of a box, normals outwards."""
    points, normals = [], []
    for axis, sign in SIDES:
        if (axis, sign) in without:
            continue
        across = [other for other in range(3) if other != axis]
        grid = np.meshgrid(*[np.arange(low[a], high[a] + 1e-9, 0.003) for a in across])
        side = np.empty((grid[0].size, 3))
        side[:, across] = np.column_stack([g.ravel() for g in grid])
        side[:, axis] = high[axis] if sign > 0 else low[axis]
        points.append(side)
        normals.append(np.tile(sign * np.eye(3)[axis], (len(side), 1)))
    return PointCloud(np.concatenate(points), np.concatenate(normals))


def ell() -> PointCloud:
    """An L of two boxes of 12 x 6 x 6 cm; nobody saw the two faces of its notch, nor its bottom."""
    lower = box_sides(np.array([0.0, 0, 0]), np.array([0.12, 0.06, 0.06]), (BOTTOM, (2, 1)))
    upper = box_sides(np.array([0.0, 0, 0.06]), np.array([0.06, 0.06, 0.12]), (BOTTOM, (0, 1)))
    return PointCloud(
        np.concatenate([lower.points, upper.points]), np.concatenate([lower.normals, upper.normals])
    )


def views_across_the_notch() -> list[DepthView]:
    """Two depth images along y: the L before a wall."""
    views = []
    for x in (0.05, 0.055):  # from where the faces of the notch are not seen
        camera_from_object = np.eye(4)
        camera_from_object[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
        camera_from_object[:3, 3] = [-x, 0.06, 0.3]
        v, u = np.mgrid[0:120, 0:160]
        at_m = 0.3  # of the front face
        x_px = (u - 79.5) / 200 * at_m + x
        z_px = -((v - 59.5) / 200 * at_m - 0.06)
        on = (x_px >= 0) & (x_px <= 0.12) & (z_px >= 0) & (z_px <= np.where(x_px <= 0.06, 0.12, 0.06))
        depth_m = np.where(on, at_m, 0.8).astype(np.float32)
        views.append(DepthView("00", CAMERA, camera_from_object, depth_m))
    return views


def volume_m3(mesh: Mesh) -> float:
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def test_a_point_is_seen_through_where_depth_is_measured_behind_it() -> None:
    depth_m = np.full((120, 160), 1.0, np.float32)
    depth_m[:, 100:] = 0  # not measured there
    view = DepthView("00", CAMERA, np.eye(4), depth_m)
    points = np.array([[0, 0, 0.9], [0, 0, 0.995], [0, 0, 1.1], [0.3, 0, 0.9], [5.0, 0, 0.9], [0, 0, -1.0]])
    assert project(CAMERA, points[3:4])[0, 0] > 100
    assert witnesses(points, [view, view], margin_m=0.01).tolist() == [2, 0, 0, 0, 0, 0]


def test_the_bottom_nobody_saw_is_closed_and_marked(tmp_path: Path) -> None:
    low, high = np.array([0.0, 0, 0]), np.array([0.09, 0.06, 0.06])
    closed = closed_mesh(box_sides(low, high, (BOTTOM,)), np.array([low, high]), voxel_m=0.003)
    assert closed.open_edges == open_edges(closed.mesh) == 0
    assert abs(volume_m3(closed.mesh) / np.prod(high - low) - 1) < 0.05
    centres = closed.mesh.vertices[closed.mesh.triangles].mean(axis=1)
    middle = (np.abs(centres[:, :2] - [0.045, 0.03]) < 0.015).all(axis=1)
    assert not closed.seen[middle & (centres[:, 2] < 0.01)].any()
    assert closed.seen[middle & (centres[:, 2] > 0.05)].all()

    save_mesh(tmp_path / "mesh.ply", closed.mesh, seen=closed.seen)
    header, _, content = (tmp_path / "mesh.ply").read_bytes().partition(b"end_header\n")
    assert b"property uchar seen" in header
    faces = np.frombuffer(
        content, [("n", "u1"), ("v", "<i4", 3), ("seen", "u1")], offset=24 * len(closed.mesh.vertices)
    )
    np.testing.assert_array_equal(faces["seen"].astype(bool), closed.seen)
    np.testing.assert_array_equal(load_mesh(tmp_path / "mesh.ply").triangles, closed.mesh.triangles)


def test_a_notch_nobody_saw_the_faces_of_stays_open_where_cameras_saw_through_it() -> None:
    true_m3 = 0.12 * 0.06 * 0.06 + 0.06 * 0.06 * 0.06
    views, cloud = views_across_the_notch(), ell()
    blind = closed_mesh(cloud, np.empty((0, 3)), voxel_m=0.003)
    told = closed_mesh(cloud, np.empty((0, 3)), voxel_m=0.003, views=views)
    assert volume_m3(blind.mesh) > 1.1 * true_m3
    assert abs(volume_m3(told.mesh) / true_m3 - 1) < 0.06
    assert free_share(told.mesh, views) < 0.8 * free_share(blind.mesh, views)


def test_open_edges_are_counted() -> None:
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert open_edges(Mesh(corners, tetrahedron)) == 0
    assert open_edges(Mesh(corners, tetrahedron[:3])) == 3


def test_colours_of_two_scenes_are_blended() -> None:
    """Each vertex of a box, which one scene saw lighter than another, gets about the mean of both."""
    dark = box_sides(np.zeros(3), np.array([0.12, 0.09, 0.06]))
    light = box_sides(np.full(3, 0.0004), np.array([0.1204, 0.0904, 0.0604]))
    colors = np.repeat(np.array([[60] * 3, [140] * 3], dtype=np.uint8), len(dark.points), axis=0)
    both = PointCloud(
        np.concatenate([dark.points, light.points]), np.concatenate([dark.normals, light.normals]), colors
    )
    made = closed_mesh(both, np.empty((0, 3)), voxel_m=0.003).mesh
    assert made.colors is not None
    assert np.abs(made.colors.astype(float) - 100).mean() < 12  # the nearest point alone: 40
