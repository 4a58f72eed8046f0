"""ElasticFusion's surface."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from rpl_data.formats.models.surfels import Surfels, read_surfels, write_surfels
from rpl_data.meshes import load_cloud
from rpl_data.types import DataError, PointCloud


def ball(count: int = 500) -> Surfels:
    """The half of a ball, 1 m in front of the first camera, that it sees."""
    normals = np.random.default_rng(1).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:, 2] = -np.abs(normals[:, 2])
    colors = np.random.default_rng(2).integers(0, 256, (count, 3)).astype(np.uint8)
    return Surfels(PointCloud(np.array([0, 0, 1]) + 0.1 * normals, normals, colors), np.full(count, 0.003))


def test_what_is_written_is_read_and_other_readers_agree(tmp_path: Path) -> None:
    surfels = ball()
    write_surfels(tmp_path / "00.ply", surfels)
    read = read_surfels(tmp_path / "00.ply")
    for cloud in (read.cloud, load_cloud(tmp_path / "00.ply")):  # the second is Open3D
        np.testing.assert_allclose(cloud.points, surfels.cloud.points, atol=1e-6)
        np.testing.assert_allclose(cloud.normals, surfels.cloud.normals, atol=1e-6)
        np.testing.assert_array_equal(cloud.colors, surfels.cloud.colors)
    np.testing.assert_allclose(read.radii_m, 0.003, atol=1e-9)


def test_normals_point_out_whoever_wrote_them(tmp_path: Path) -> None:
    surfels = ball()
    inwards = PointCloud(surfels.cloud.points, -surfels.cloud.normals, surfels.cloud.colors)
    write_surfels(tmp_path / "00.ply", Surfels(inwards, surfels.radii_m))
    np.testing.assert_allclose(
        read_surfels(tmp_path / "00.ply").cloud.normals, surfels.cloud.normals, atol=1e-6
    )


def test_by_hand(tmp_path: Path) -> None:
    """One surfel and half of another."""
    properties = ["float x", "float y", "float z", *(f"uchar {c}" for c in ("red", "green", "blue"))]
    properties += ["float nx", "float ny", "float nz", "float radius"]
    header = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
    header += [f"property {one}" for one in properties] + ["end_header", ""]
    surfel = struct.pack("<fffBBBffff", 0.5, -0.25, 2.0, 255, 128, 0, 0.0, 0.0, -1.0, 0.5)
    (tmp_path / "a.ply").write_bytes("\n".join(header).encode() + surfel + surfel[:20])
    read = read_surfels(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.cloud.points, [[0.5, -0.25, 2.0]])
    np.testing.assert_array_equal(read.cloud.normals, [[0, 0, -1]])
    np.testing.assert_array_equal(read.cloud.colors, [[255, 128, 0]])
    assert (read.radii_m.tolist(), read.lost) == ([0.5], 1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no ply", "is not a surface of ElasticFusion"),
        (b"ply\nformat ascii 1.0\nend_header\n", "expected a binary little-endian PLY"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nend_header\n",
            "lacking y, z, red",
        ),
        (b"", "is not a surface"),
    ],
)
def test_others_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_surfels(tmp_path / "a.ply")
    with pytest.raises(DataError, match="does not exist"):
        read_surfels(tmp_path / "nowhere.ply")
    write_surfels(tmp_path / "b.ply", ball(1))
    (tmp_path / "b.ply").write_bytes((tmp_path / "b.ply").read_bytes()[:-1])
    with pytest.raises(DataError, match="holds no complete surfel"):
        read_surfels(tmp_path / "b.ply")
