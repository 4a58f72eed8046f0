"""The surface that ElasticFusion fused, <scene>.ply of a RapidPoseLabels tree: a binary PLY of surfels.

::

    element vertex n: float x y z, uchar red green blue, float nx ny nz, float radius

Little-endian; metres, in the frame of the first camera, where the trajectory starts. ElasticFusion flips its
normals when it writes them. Whatever their direction in the file, here they point out of the surface:
most of what was filmed faces the first camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.files import decoding, read_bytes, write_bytes
from rpl_data.types import DataError, PointCloud

_FIELDS = [
    ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
    ("nx", "<f4"), ("ny", "<f4"), ("nz", "<f4"), ("radius", "<f4"),
]  # fmt: skip
_TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "uchar": "u1", "uint8": "u1"}
_END = b"end_header\n"


@dataclass(frozen=True)
class Surfels:
    """A surface made of small discs (surfels).

    Attributes:
        cloud: centres, normals and colours, in the scene frame.
        radii_m: radii of the discs.
        lost: number of surfels that the header promises and the file lacks.
    """

    cloud: PointCloud
    radii_m: Float64[np.ndarray, " n"]
    lost: int = 0


def read_surfels(path: Path) -> Surfels:
    """Read the surfels of a file; those after a cut are lost and counted.

    Raises:
        DataError: the file is missing, not such a PLY, or holds no surfels.
    """
    content = read_bytes(path)
    with decoding(path, "run ElasticFusion on the recording again"):
        promised, kind = _header(path, content[: content.find(_END)].decode("ascii", "replace").split("\n"))
    body = content[content.find(_END) + len(_END) :]
    whole = min(promised, len(body) // kind.itemsize)
    if whole == 0:
        raise DataError(f"{path} holds no complete surfel; run ElasticFusion on the recording again")
    table = np.frombuffer(body, kind, whole)
    points, normals = (_columns(table, names) for names in ("x y z", "nx ny nz"))
    if not (np.isfinite(points).all() and np.isfinite(normals).all()):
        raise DataError(f"{path} has a surfel that is not finite; run ElasticFusion on the recording again")
    facing = np.einsum("ij,ij->i", normals, -points) > 0
    outwards = normals if facing.mean() >= 0.5 else -normals
    colors = np.stack([table[name] for name in ("red", "green", "blue")], axis=1)
    return Surfels(PointCloud(points, outwards, colors), table["radius"].astype(np.float64), promised - whole)


def _header(path: Path, lines: list[str]) -> tuple[int, np.dtype[np.void]]:
    """Read the number of surfels and their layout from the header."""
    words = [line.split() for line in lines]
    counts = [int(w[2]) for w in words if w[:2] == ["element", "vertex"] and w[2:] and w[2].isdigit()]
    fields = [(w[2], _TYPES.get(w[1], "")) for w in words if w[:1] == ["property"] and len(w) == 3]
    binary = ["format", "binary_little_endian", "1.0"] in words
    missing = [name for name, _ in _FIELDS if name not in dict(fields)]
    if lines[0] != "ply" or not binary or len(counts) != 1 or missing or not all(t for _, t in fields):
        raise DataError(
            f"{path} is not a surface of ElasticFusion; expected a binary little-endian PLY with "
            f"{', '.join(name for name, _ in _FIELDS)} per vertex"
            + (f", lacking {', '.join(missing)}" if lines[0] == "ply" and missing else "")
        )
    return counts[0], np.dtype(fields)


def _columns(table: np.ndarray, names: str) -> Float64[np.ndarray, "n 3"]:
    with np.errstate(invalid="ignore"):  # values that are no numbers are refused by whoever asked
        return np.stack([table[name] for name in names.split()], axis=1).astype(np.float64)


def write_surfels(path: Path, surfels: Surfels) -> None:
    """Write the file as ElasticFusion does."""
    cloud = surfels.cloud
    table = np.zeros(len(cloud.points), np.dtype(_FIELDS))
    blocks = [("x y z", cloud.points), ("nx ny nz", cloud.normals)]
    for names, values in [*blocks, *([] if cloud.colors is None else [("red green blue", cloud.colors)])]:
        for name, column in zip(names.split(), values.T, strict=True):
            table[name] = column
    table["radius"] = surfels.radii_m
    words = {"<f4": "float", "u1": "uchar"}
    properties = "".join(f"property {words[kind]} {name}\n" for name, kind in _FIELDS)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{properties}"
    write_bytes(path, header.encode("ascii") + _END + table.tobytes())
