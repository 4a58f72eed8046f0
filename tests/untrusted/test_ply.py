"""PLY files: what Open3D writes is read as Open3D reads it, and what is damaged is refused."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from rpl_data.meshes import load_cloud, load_mesh, mesh_to_ply, save_cloud
from rpl_data.types import DataError, Mesh, PointCloud

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], dtype=float)
SHEET = Mesh(CORNERS, np.array([[0, 1, 2], [1, 3, 2]]), np.array([[9, 8, 7]] * 4, np.uint8))
TEXT = """ply
format ascii 1.0
comment made by hand
element vertex 4
property float x
property float y
property float z
element face 2
property uchar flags
property list uchar int vertex_index
element edge 1
property int first
end_header
0 0 0
1 0 0
0 1 0
1 1 0.5
7 3 0 1 2
7 4 0 1 3 2
5
"""


@pytest.mark.parametrize("name", ["text.ply", "binary.ply", "sheet.off", "sheet.obj"])
def test_a_mesh_is_read_as_open3d_reads_it(tmp_path: Path, name: str) -> None:
    import open3d as o3d

    sphere = o3d.geometry.TriangleMesh.create_sphere(0.1, 12)
    sphere.paint_uniform_color([0.2, 0.4, 0.6])
    o3d.io.write_triangle_mesh(str(tmp_path / name), sphere, write_ascii=name == "text.ply")
    judge, mesh = o3d.io.read_triangle_mesh(str(tmp_path / name)), load_mesh(tmp_path / name)
    np.testing.assert_array_equal(mesh.vertices, np.asarray(judge.vertices))
    np.testing.assert_array_equal(mesh.triangles, np.asarray(judge.triangles))
    assert mesh.colors is not None and (mesh.colors == [51, 102, 153]).all()


def test_polygons_become_fans_and_unknown_elements_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(TEXT)
    mesh = load_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 1, 3], [0, 3, 2]]


def test_binary_polygons_of_different_sizes_in_the_other_byte_order(tmp_path: Path) -> None:
    header = TEXT.split("end_header")[0].replace("ascii", "binary_big_endian") + "end_header\n"
    faces = b"\x07\x03" + np.arange(3).astype(">i4").tobytes()
    faces += b"\x07\x04" + np.array([0, 1, 3, 2]).astype(">i4").tobytes()
    (tmp_path / "a.ply").write_bytes(header.encode() + CORNERS.astype(">f4").tobytes() + faces + bytes(4))
    assert load_mesh(tmp_path / "a.ply").triangles.tolist() == [[0, 1, 2], [0, 1, 3], [0, 3, 2]]


def test_a_cloud_comes_back(tmp_path: Path) -> None:
    cloud = PointCloud(CORNERS, np.tile([0.0, 0.0, 1.0], (4, 1)), SHEET.colors)
    save_cloud(tmp_path / "a.ply", cloud)
    back = load_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(back.points, cloud.points)
    np.testing.assert_array_equal(back.normals, cloud.normals)
    np.testing.assert_array_equal(back.colors, cloud.colors)


GOOD = mesh_to_ply(SHEET)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GOOD + b"\n", "1 bytes follow"),
        (GOOD[:-1], "ends before the last of 2 face items"),
        (GOOD.replace(b"vertex 4", b"vertex 1000000000000"), "ends before the last of 1000000000000 vertex"),
        (GOOD.replace(b"face 2", b"face 1000000000"), "ends before"),
        (GOOD[:-4] + np.int32(4).tobytes(), "corner 4, but there are 4 vertices"),
        (GOOD[:-4] + np.int32(-1).tobytes(), "face has the corner"),
        (TEXT.replace("1 1 0.5", "1 1 nan").encode(), "not finite"),
        (TEXT.replace("7 3 0", "7 -3 0").encode(), "whole number"),
        (TEXT.replace("7 4 0", "7 -4 0").encode(), "ends before"),
        (TEXT.replace("7 4 0", "7 4.5 0").encode(), "ends before"),
        (TEXT.replace("1 1 0.5", "1 1-0.5").encode(), "could not convert"),
        (TEXT.replace("1 1 0.5", "1 1,0.5").encode(), "commas"),
        (TEXT.replace("7 3 0 1 2", "7 3 0 1 99999999999999999999").encode(), "whole number"),
        (TEXT.replace("7 3 0", "7 999999999 0").encode(), "ends before"),
        (TEXT.replace("1 1 0.5", "1 1 half").encode(), "could not convert"),
        (TEXT.replace("property float y\n", "").encode(), "no property y|numbers follow"),
        (TEXT.replace("uchar int vertex_index", "float int vertex_index").encode(), "not a whole number"),
        (TEXT.replace("format ascii 1.0\n", "").encode(), "names no format"),
        (b"solid block", "PLY header"),
        (b"", "PLY header"),
    ],
)
def test_what_is_damaged_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(DataError, match=message):
        load_mesh(tmp_path / "a.ply")


def test_no_damage_ends_in_anything_but_an_answer(tmp_path: Path) -> None:
    chance = random.Random(7)
    for number in range(600):
        content = bytearray((GOOD, TEXT.encode())[number % 2])
        for _ in range(chance.choice([1, 3])):
            content[chance.randrange(len(content))] = chance.randrange(256)
        (tmp_path / "a.ply").write_bytes(content)
        try:
            mesh = load_mesh(tmp_path / "a.ply")
        except DataError:
            continue
        assert np.isfinite(mesh.vertices).all() and mesh.triangles.max() < len(mesh.vertices)
