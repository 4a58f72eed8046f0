"""Meshes and point clouds: reading, writing and simple operations.

PLY files are read and written here, since Open3D's writer reports success on a full disk and its reader
crashes on damaged files. It reads the other formats, in a child process.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8
from scipy.spatial import cKDTree

from rpl_data.files import write_bytes
from rpl_data.geometry import Transform, transform
from rpl_data.types import DataError, Mesh, PointCloud
from rpl_data.untrusted.child import in_child
from rpl_data.untrusted.ply import read_ply
from rpl_data.untrusted.ply_header import Columns

Floats = Float64[np.ndarray, "n 3"]
Colors = UInt8[np.ndarray, "n 3"]


def save_mesh(path: Path, mesh: Mesh, *, seen: Bool[np.ndarray, " m"] | None = None) -> None:
    """Write triangles as binary PLY, completely or not at all; see `mesh_to_ply`."""
    write_bytes(path, mesh_to_ply(mesh, seen=seen))


READING_S = 120
"""Largest CPU time to read a mesh by Open3D, in seconds; a scan of a million triangles takes ten."""


def load_mesh(path: Path) -> Mesh:
    """Read a mesh from PLY, OBJ or any other format that Open3D reads.

    Raises:
        DataError: the file is missing or damaged, holds no triangles, or has a vertex that is not finite.
    """
    if not path.is_file():
        raise DataError(f"there is no mesh {path}")
    if path.suffix.lower() != ".ply":
        mesh = in_child(_read_by_open3d, path, file=path, limit_s=READING_S)
    else:
        ply = read_ply(path)
        mesh = Mesh(_columns(path, ply.vertices, "x y z"), ply.triangles, _colors(ply.vertices))
    if not len(mesh.triangles):
        raise DataError(f"{path} holds no triangles; expected a mesh, not a point cloud")
    if not np.isfinite(mesh.vertices).all():
        raise DataError(f"{path} has a vertex that is not finite; save it again")
    return mesh


def _read_by_open3d(path: Path) -> Mesh:
    import open3d as o3d

    legacy = o3d.io.read_triangle_mesh(str(path))
    colors = (np.asarray(legacy.vertex_colors) * 255).round().astype(np.uint8)
    triangles = np.asarray(legacy.triangles).astype(np.int64)
    vertices = np.asarray(legacy.vertices).copy()
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise DataError(f"{path} has a triangle with a corner that is not a vertex; save it again")
    return Mesh(vertices, triangles, colors if legacy.has_vertex_colors() else None)


def _columns(path: Path, vertices: Columns, names: str) -> Floats:
    """Some properties of vertices side by side, such as "x y z"."""
    missing = [name for name in names.split() if name not in vertices]
    if missing:
        raise DataError(f"{path} has no property {', '.join(missing)} for its vertices; save it again")
    with np.errstate(invalid="ignore"):  # values that are no numbers are refused by whoever asked
        return np.column_stack([vertices[name].astype(np.float64) for name in names.split()])


def _colors(vertices: Columns) -> Colors | None:
    """RGB of vertices, stored as bytes or as fractions of 1; None without colours."""
    found = [vertices[name] for name in ("red", "green", "blue") if name in vertices]
    if len(found) < 3:
        return None
    if found[0].dtype.kind == "f":
        found = [np.nan_to_num(255 * values).clip(0, 255).round() for values in found]
    return np.column_stack(found).clip(0, 255).astype(np.uint8)


def save_cloud(path: Path, cloud: PointCloud) -> None:
    """Write points with normals as binary PLY, completely or not at all."""
    write_bytes(path, cloud_to_ply(cloud))


def load_cloud(path: Path) -> PointCloud:
    """Read points with normals from PLY; DataError when there are none, or some are not finite."""
    if not path.is_file():
        raise DataError(f"there is no point cloud {path}")
    vertices = read_ply(path).vertices
    if not {"x", "nx"} <= vertices.keys() or not len(vertices["x"]):
        raise DataError(f"{path} should hold points with normals")
    points, normals = _columns(path, vertices, "x y z"), _columns(path, vertices, "nx ny nz")
    if not (np.isfinite(points).all() and np.isfinite(normals).all()):
        raise DataError(f"{path} has a point or a normal that is not finite; save it again")
    return PointCloud(points, normals, _colors(vertices))


def mesh_to_ply(mesh: Mesh, *, seen: Bool[np.ndarray, " m"] | None = None, normals: bool = False) -> bytes:
    """Encode vertices (with colours where known) and triangles as PLY.

    Args:
        normals: whether the vertices get normals.
        seen: whether a camera saw each triangle; written as the property `seen` (1 or 0) of the faces.
    """
    columns: list[tuple[Sequence[str], Floats]] = [("xyz", mesh.vertices)]
    if normals:
        columns.append((("nx", "ny", "nz"), vertex_normals(mesh)))
    header, vertices = _vertices(columns, mesh.colors)
    faces = f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\n"
    if seen is not None:
        faces += "property uchar seen\n"
    return _file(header + faces, vertices + _faces(mesh.triangles, seen))


def cloud_to_ply(cloud: PointCloud) -> bytes:
    """Encode points with normals (and colours where known) as PLY."""
    return _file(*_vertices([("xyz", cloud.points), (("nx", "ny", "nz"), cloud.normals)], cloud.colors))


def vertex_normals(mesh: Mesh) -> Floats:
    """Unit normal of every vertex: the mean of its triangles' normals by area; 0 where it has no triangle."""
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
    twice_area = np.cross(b - a, c - a)
    sums = np.zeros_like(mesh.vertices)
    for corner in range(3):
        np.add.at(sums, mesh.triangles[:, corner], twice_area)
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30))


def _file(elements: str, content: bytes) -> bytes:
    return f"ply\nformat binary_little_endian 1.0\n{elements}end_header\n".encode("ascii") + content


def _vertices(columns: Sequence[tuple[Sequence[str], Floats]], colors: Colors | None) -> tuple[str, bytes]:
    """The header and the content of the vertex element."""
    fields = [(name, "<f8") for names, _ in columns for name in names]
    if colors is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
    table = np.empty(len(columns[0][1]), dtype=fields)
    for names, values in [*columns, *([] if colors is None else [(("red", "green", "blue"), colors)])]:
        for name, column in zip(names, values.T, strict=True):
            table[name] = column
    kinds = {"<f8": "double", "u1": "uchar"}
    properties = "".join(f"property {kinds[kind]} {name}\n" for name, kind in fields)
    return f"element vertex {len(table)}\n{properties}", table.tobytes()


def _faces(triangles: Int64[np.ndarray, "m 3"], seen: Bool[np.ndarray, " m"] | None) -> bytes:
    fields: list[tuple[str, str] | tuple[str, str, int]] = [("count", "u1"), ("corners", "<i4", 3)]
    if seen is not None:
        fields.append(("seen", "u1"))
    table = np.empty(len(triangles), dtype=fields)
    table["count"], table["corners"] = 3, triangles
    if seen is not None:
        table["seen"] = seen
    return table.tobytes()


def oriented_points(mesh: Mesh) -> PointCloud:
    """The vertices that triangles use, with outward normals (`vertex_normals`)."""
    normals = vertex_normals(mesh)
    used = normals.any(axis=1)
    colors = None if mesh.colors is None else mesh.colors[used]
    return PointCloud(mesh.vertices[used], normals[used], colors)


def moved_cloud(cloud: PointCloud, a_from_b: Transform) -> PointCloud:
    """Points and normals moved from b to a."""
    return PointCloud(transform(a_from_b, cloud.points), cloud.normals @ a_from_b[:3, :3].T, cloud.colors)


def select(cloud: PointCloud, chosen: Bool[np.ndarray, " n"] | Int64[np.ndarray, " m"]) -> PointCloud:
    """Select some of the points."""
    colors = None if cloud.colors is None else cloud.colors[chosen]
    return PointCloud(cloud.points[chosen], cloud.normals[chosen], colors)


def smoothed_normals(cloud: PointCloud, *, radius_m: float) -> PointCloud:
    """Replace every normal by the mean of its neighbourhood's normals."""
    pairs = cKDTree(cloud.points).query_pairs(radius_m, output_type="ndarray")
    mean = cloud.normals.copy()
    for a, b in ((0, 1), (1, 0)):
        for axis in range(3):
            mean[:, axis] += np.bincount(
                pairs[:, a], weights=cloud.normals[pairs[:, b], axis], minlength=len(mean)
            )
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    return PointCloud(cloud.points, mean, cloud.colors)


def thinned(cloud: PointCloud, *, voxel_m: float) -> PointCloud:
    """Reduce to one point per voxel: the mean of its points, normals and colours."""
    _, cell = np.unique(np.floor(cloud.points / voxel_m).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.column_stack([np.bincount(cell, weights=column) for column in values.T]) / count[:, None]

    normals = mean(cloud.normals)
    length = np.linalg.norm(normals, axis=1)
    kept = length > 0.2  # opposite sides of a thin sheet in one voxel have no common normal
    colors = None if cloud.colors is None else np.round(mean(cloud.colors)).astype(np.uint8)[kept]
    return PointCloud(mean(cloud.points)[kept], normals[kept] / length[kept, None], colors)


def joined(clouds: list[PointCloud]) -> PointCloud:
    """Join the points of several clouds; colours are kept only when all have them."""
    colors = [cloud.colors for cloud in clouds if cloud.colors is not None]
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.normals for cloud in clouds]),
        np.concatenate(colors) if len(colors) == len(clouds) else None,
    )


def joined_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    colors = [mesh.colors for mesh in meshes if mesh.colors is not None]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
        np.concatenate(colors) if len(colors) == len(meshes) else None,
    )


def in_order(mesh: Mesh) -> Mesh:
    """The same surface with vertices and triangles sorted, so that it is the same bytes however it was made.

    Open3D's threads extract vertices in an order that differs from run to run. Vertices that are equal become
    one.
    """
    columns = mesh.vertices if mesh.colors is None else np.c_[mesh.vertices, mesh.colors]
    order = np.lexsort(columns.T[::-1])
    is_new = np.r_[True, (columns[order[1:]] != columns[order[:-1]]).any(axis=1)] if len(order) else order > 0
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.cumsum(is_new) - 1
    corners = place[mesh.triangles]
    first = corners.argmin(axis=1)[:, None]
    corners = np.take_along_axis(corners, (first + np.arange(3)) % 3, axis=1)  # turned, never mirrored
    kept = order[is_new]
    return Mesh(
        mesh.vertices[kept],
        corners[np.lexsort(corners.T[::-1])],
        None if mesh.colors is None else mesh.colors[kept],
    )


def simplified(mesh: Mesh, *, most_triangles: int) -> Mesh:
    """Reduce a mesh to at most `most_triangles`, by quadric error (Garland and Heckbert, SIGGRAPH 1997)."""
    if len(mesh.triangles) <= most_triangles:
        return mesh
    import open3d as o3d

    legacy = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    if mesh.colors is not None:
        legacy.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255.0)
    small = legacy.simplify_quadric_decimation(most_triangles)
    colors = np.clip(np.asarray(small.vertex_colors) * 255, 0, 255).round().astype(np.uint8)
    return Mesh(
        np.asarray(small.vertices).copy(),
        np.asarray(small.triangles).astype(np.int64),
        colors if small.has_vertex_colors() else None,
    )


def sampled(mesh: Mesh, *, count: int, seed: int = 0) -> Floats:
    """Sample points uniformly from the surface of a mesh; the same ones for the same seed.

    A triangle is drawn with a probability proportional to its area, a point within it uniformly (Osada et
    al., "Shape distributions", ACM Transactions on Graphics 21, 2002, section 4.2).
    """
    generator = np.random.default_rng(seed)
    a, b, c = (mesh.vertices[mesh.triangles[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = generator.choice(len(areas), size=count, p=areas / areas.sum())
    along, across = np.sqrt(generator.random((count, 1))), generator.random((count, 1))
    points: Floats = (1 - along) * a[chosen] + along * (1 - across) * b[chosen] + along * across * c[chosen]
    return points
