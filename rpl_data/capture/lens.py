"""Convert the camera models of librealsense, and of other makers, to OpenCV's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.types import DataError, Intrinsics


def intrinsics_of(lens: Any) -> tuple[Intrinsics, tuple[str, ...]]:
    """Convert a librealsense lens to OpenCV's model, with a note when it fits badly.

    Brown-Conrady is OpenCV's model. Coefficients for other models are fitted: librealsense projects a grid of
    rays, and OpenCV's k1 k2 p1 p2 k3 are linear in the projected positions.
    """
    import pyrealsense2 as rs

    fx, fy, cx, cy = (as_meant(value) for value in (lens.fx, lens.fy, lens.ppx, lens.ppy))
    size = (fx, fy, cx, cy, lens.width, lens.height)
    if not any(lens.coeffs) or lens.model == rs.distortion.none:
        return Intrinsics(*size), ()
    if lens.model == rs.distortion.brown_conrady:
        return Intrinsics(*size, tuple(as_meant(value) for value in lens.coeffs)), ()
    rays = _grid_of_rays(lens)
    landed = [rs.rs2_project_point_to_pixel(lens, [*ray, 1.0]) for ray in rays.tolist()]
    distortion, worst_px = _fit_distortion(lens, rays, np.array(landed))
    note = f"lens model {lens.model.name} written as OpenCV's, at most {worst_px:.2f} px off"
    return Intrinsics(*size, distortion), (note,)


def _grid_of_rays(lens: Any) -> Float64[np.ndarray, "n 2"]:
    """Rays (x, y, 1) of a grid of 20 x 20 pixels."""
    u, v = np.meshgrid(np.linspace(0, lens.width - 1, 20), np.linspace(0, lens.height - 1, 20))
    return np.stack([(u.ravel() - lens.ppx) / lens.fx, (v.ravel() - lens.ppy) / lens.fy], axis=1)


def _fit_distortion(
    lens: Any, rays: Float64[np.ndarray, "n 2"], landed_px: Float64[np.ndarray, "n 2"]
) -> tuple[tuple[float, ...], float]:
    """Fit k1, k2, p1, p2, k3 by least squares; also the largest error in pixels."""
    x, y = rays.T
    r2 = x * x + y * y
    columns_x = [x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3]
    columns_y = [y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3]
    focal = np.array([lens.fx, lens.fy])
    moved = landed_px - (rays * focal + [lens.ppx, lens.ppy])
    design = np.concatenate([np.stack(columns_x, 1) * lens.fx, np.stack(columns_y, 1) * lens.fy])
    target = moved.T.ravel()
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    worst_px = float(np.abs(design @ solution - target).max())
    return tuple(float(value) for value in solution), worst_px


def as_meant(value: float) -> float:
    """Round a number that librealsense holds as float32 (0.001000000047) to the intended one (0.001)."""
    return float(f"{value:.7g}")


def opencv_camera(
    lens: Sequence[float], size_px: tuple[int, int], coefficients: Sequence[float]
) -> Intrinsics:
    """The camera of a maker whose lens model is OpenCV's.

    Args:
        lens: fx, fy, cx, cy in pixels.
        size_px: width and height.
        coefficients: k1, k2, p1, p2, k3, k4, k5, k6 and those of thin prisms and tilted sensors; any number.

    Raises:
        DataError: a prism or tilt is not 0; no reader of recordings knows these.
    """
    values = [as_meant(value) for value in coefficients]
    if any(values[8:]):
        raise DataError(
            f"the lens has the distortion {values}; only the first eight of OpenCV's coefficients can be "
            "recorded"
        )
    count = next((n for n in (0, 4, 5, 8) if not any(values[n:])), 8)
    fx, fy, cx, cy = (as_meant(value) for value in lens)
    return Intrinsics(fx, fy, cx, cy, *size_px, tuple(values[:count]))
