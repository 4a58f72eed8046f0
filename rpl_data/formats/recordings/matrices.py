"""Cameras and poses written as plain matrices, in any of the files that people keep them in."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.files import decoding, read_json, read_text
from rpl_data.formats.recordings.depth_files import read_npy
from rpl_data.formats.recordings.frame_files import Camera
from rpl_data.geometry import Transform, is_rotation
from rpl_data.types import DataError
from rpl_data.untrusted.yaml_text import read_yaml

_NUMBER = re.compile(
    r"(?<![A-Za-z_\d.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)\b", re.IGNORECASE
)
_NAMED = re.compile(r"\b(fx|fy|cx|cy)\b[\s\"':=]{1,4}([-+\d.eE]+)", re.IGNORECASE)
_MATRIX_KEYS = ("intrinsic_matrix", "K", "cam_K", "camera_matrix", "intrinsics", "intrinsic", "matrix")
_LENS_KEYS = ("distortion", "dist", "dist_coeffs", "coeffs", "distortion_coefficients", "d")
_LENS_MODELS = (None, "", "none", "plumb_bob", "rational_polynomial")
"""Of ROS, those that OpenCV's numbers are for."""
_SCALE_KEYS = ("depth_scale", "scale")


@dataclass(frozen=True)
class CameraSaid:
    """What a file says about a camera.

    Attributes:
        camera: fx, fy, cx, cy in pixels, then lens distortion where it names any.
        size: width and height of its images; None where it is silent.
        metres_per_unit: of the depth images; None where it is silent.
    """

    camera: Camera
    size: tuple[int, int] | None = None
    metres_per_unit: float | None = None


def read_matrix_camera(path: Path) -> CameraSaid:
    """Read a camera from a text or JSON file: fx fy cx cy, or a 3x3, 3x4 or 4x4 matrix K, in rows or columns.

    Open3D writes its matrices by columns: the principal point says which it is.

    Raises:
        DataError: the file holds no camera.
    """
    if path.suffix == ".json":
        with decoding(path, "correct it, or give `camera: [fx, fy, cx, cy]`"):
            return _from_json(path, read_json(path))
    if path.suffix == ".npy":
        return CameraSaid(camera_of(read_npy(path).ravel().tolist(), path))
    text = read_text(path, errors="replace")
    if path.suffix in (".yaml", ".yml"):
        with decoding(path, "correct it, or give `camera: [fx, fy, cx, cy]`"):
            return _from_json(path, _yaml(path, text))
    named = {name.lower(): float(value) for name, value in _NAMED.findall(text)}
    if named.keys() == {"fx", "fy", "cx", "cy"}:
        return CameraSaid(camera_of([named[name] for name in ("fx", "fy", "cx", "cy")], path))
    values = numbers_in(text)
    if len(values) in (8, 9, 12) and _matrix_of(values) is None:
        return CameraSaid((*camera_of(values[:4], path), *_lens(values[4:], path)))
    return CameraSaid(camera_of(values, path))


def _yaml(path: Path, text: str) -> Any:
    """Content of a YAML file; OpenCV's have a first line and tags of their own."""
    plain = re.sub(r"\A%YAML[^\n]*\n|!!opencv-matrix", "", text)
    return read_yaml(plain, source=str(path))


def _lens(values: list[float], path: Path) -> tuple[float, ...]:
    """Distortion behind fx fy cx cy; DataError for numbers that are no lens's, as of a damaged matrix."""
    if not max(map(abs, values)) < MOST_DISTORTION:
        raise DataError(
            f"{path}: expected fx fy cx cy and a lens's distortion, or a matrix K with a last row 0 0 1; "
            f"found {len(values) + 4} numbers that are neither; give `camera: [fx, fy, cx, cy]`"
        )
    return tuple(values) if any(values) else ()


MOST_DISTORTION = 100.0
"""No coefficient of a lens is larger, but most numbers of a matrix in pixels are."""


def numbers_in(text: str) -> list[float]:
    """All numbers of a text, whatever separates them; comments with # are left out."""
    lines = (line.partition("#")[0] for line in text.splitlines())
    return [float(found) for line in lines for found in _NUMBER.findall(line)]


def camera_of(values: Sequence[float], source: Path) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of 4 numbers, or of the 9, 12 or 16 of a matrix; DataError for anything else."""
    matrix = np.array(values, dtype=float)
    rows = _matrix_of(values)
    found = matrix if len(matrix) == 4 else np.zeros(4) if rows is None else rows[[0, 1, 0, 1], [0, 1, 2, 2]]
    if not np.isfinite(found).all() or not (found > 0).all():
        raise DataError(
            f"{source}: expected fx fy cx cy or a matrix K in pixels, found {len(matrix)} numbers; "
            "correct it, or give `camera: [fx, fy, cx, cy]`"
        )
    fx, fy, cx, cy = found.tolist()
    return fx, fy, cx, cy


def _matrix_of(values: Sequence[float]) -> Float64[np.ndarray, "rows columns"] | None:
    """A matrix K of 9, 12 or 16 numbers, by rows or columns; None where they are none."""
    if len(values) not in (9, 12, 16):
        return None
    rows = np.array(values, dtype=float).reshape(-1, 3 if len(values) == 9 else 4)
    rows = rows.T if not rows[:2, 2].any() and rows[2, :2].any() else rows
    last = rows[2, :3] if rows.shape[0] > 2 else np.zeros(3)
    is_k = last[2] > 0 and max(map(abs, (*last[:2], rows[1, 0]))) < 1e-6
    return rows if is_k else None


def _from_json(path: Path, data: Any) -> CameraSaid:
    found = _camera_dict(_without_boxes(data))
    if found is None:
        raise DataError(
            f"{path} names neither fx, fy, cx, cy nor a matrix (K, intrinsic_matrix); "
            "correct it, or give `camera: [fx, fy, cx, cy]`"
        )
    keys = {key.lower(): value for key, value in found.items()}
    named = _flat([keys.get(name, keys.get(other, math.nan)) for name, other in _SYNONYMS])
    if any(map(math.isnan, named)):
        named = _flat(next((found[key] for key in _MATRIX_KEYS if key in found), []))
    camera = camera_of(named, path)
    width, height = (
        keys.get(name, keys.get(name[0], keys.get(f"image_{name}"))) for name in ("width", "height")
    )
    size = (int(width), int(height)) if width and height else None
    return CameraSaid((*camera, *_distortion(keys)), size, _unit(keys))


_SYNONYMS = (("fx", "fl_x"), ("fy", "fl_y"), ("cx", "ppx"), ("cy", "ppy"))


def _without_boxes(data: Any) -> Any:
    """ROS and OpenCV write a matrix as an object of `rows`, `cols` and `data`: the data alone."""
    if isinstance(data, dict) and isinstance(data.get("data"), list):
        return data["data"]
    return {key: _without_boxes(value) for key, value in data.items()} if isinstance(data, dict) else data


def _camera_dict(data: Any, depth: int = 0) -> Mapping[str, Any] | None:
    """The object that holds the numbers: the file's own, or one a level or two below ("camera", "color")."""
    if isinstance(data, list):
        return {"K": data}
    if not isinstance(data, dict):
        return None
    lower = {str(key).lower() for key in data}
    if {"fx", "fy"} <= lower or {"fl_x", "fl_y"} <= lower:
        return data
    if any(key in data and not isinstance(data[key], dict) for key in _MATRIX_KEYS):
        return data
    inner = sorted(data.items(), key=lambda item: "depth" in str(item[0]).lower())
    below = (_camera_dict(value, depth + 1) for _, value in inner if isinstance(value, dict) and depth < 2)
    return next((found for found in below if found is not None), None)


def _flat(value: Any) -> list[float]:
    return [float(x) for row in value for x in (row if isinstance(row, list) else [row])]


def _distortion(keys: Mapping[str, Any]) -> tuple[float, ...]:
    """OpenCV's coefficients where the file names any but 0; ValueError for those of another lens."""
    listed = next((keys[key] for key in _LENS_KEYS if key in keys), None)
    named = listed if isinstance(listed, dict) else keys
    if "k1" in named and not isinstance(listed, list):
        listed = [named.get(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
    values = tuple(_flat(listed)) if isinstance(listed, list) else ()
    if not any(values):
        return ()
    if (model := keys.get("distortion_model")) not in _LENS_MODELS:
        raise ValueError(f"its lens is of model {model}, expected plumb_bob or rational_polynomial")
    count = next((n for n in (4, 5, 8) if len(values) >= n and not any(values[n:])), None)
    if count is None:
        raise ValueError(f"{len(values)} numbers of lens distortion, expected 4, 5 or 8")
    return values[:count]


def _unit(keys: Mapping[str, Any]) -> float | None:
    """Metres per unit: files say 1000 units per metre, or 0.001 metres per unit."""
    scale = next((keys[key] for key in _SCALE_KEYS if isinstance(keys.get(key), (int, float))), None)
    if scale is None or not 0 < scale < 1e6:
        return None
    return float(scale) if scale < 1 else 1 / float(scale) if scale > 1 else None


# Poses --------------------------------------------------------------------------------------------


def rigid_or_none(values: Sequence[float]) -> Transform | None:
    """A rigid transform of 12 or 16 numbers, row by row; None where they are none (a lost tracker)."""
    if len(values) not in (12, 16):
        return None
    pose = np.eye(4)
    pose[: len(values) // 4] = np.array(values, dtype=float).reshape(-1, 4)
    if not np.isfinite(pose).all() or not np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6):
        return None
    return pose if is_rotation(pose[:3, :3]) else None


def read_matrix_pose(path: Path) -> Transform | None:
    """Read a pose from a text or npy file; None where a lost tracker left no rigid transform."""
    if path.suffix == ".npy":
        try:
            return rigid_or_none(read_npy(path).ravel().tolist())
        except DataError:
            return None
    return rigid_or_none(numbers_in(read_text(path, errors="replace")))


def median_camera(cameras: Float64[np.ndarray, "n 4"]) -> tuple[Camera, tuple[str, ...]]:
    """One camera for all frames of a lens that focuses; also a note where they differ by a pixel or more."""
    middle = np.median(cameras, axis=0)
    off_px = float(np.abs(cameras - middle).max())
    fx, fy, cx, cy = middle.tolist()
    note = f"the intrinsics change by up to {off_px:.1f} px between frames (focus); their median is used"
    return (fx, fy, cx, cy), (note,) if off_px >= 1 else ()
