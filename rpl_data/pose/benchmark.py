"""An object as the BOP benchmark judges it, and all errors of one estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Points, Transform
from rpl_data.meshes import simplified
from rpl_data.pose.benchmark_errors import Depths, Symmetries, mspd_px, mssd_m, rendered_vsd
from rpl_data.raycast import PixelTable, RayScene
from rpl_data.symmetries import symmetry_transforms
from rpl_data.types import Intrinsics, Mesh
from rpl_data.types import Symmetries as Described

_table = lru_cache(maxsize=4)(PixelTable.of)

EVALUATED_TRIANGLES = 5_000
"""The models that errors are computed on are as coarse as `models_eval` of the BOP export."""


@dataclass(frozen=True)
class BenchmarkModel:
    """An object, metres, in the frame of the poses that are compared.

    Attributes:
        points: vertices of its simplified mesh.
        corners: those on the convex hull.
        diameter_m: largest distance between two points of the whole mesh.
        symmetries: transforms that leave it looking the same, the identity first.
        rays: the simplified mesh, to be rendered.
    """

    points: Points
    corners: Points
    diameter_m: float
    symmetries: Symmetries
    rays: RayScene


def benchmark_model(mesh: Mesh, symmetries: Described, *, threads: int = 1) -> BenchmarkModel:
    """Prepare an object; `threads` render it.

    Errors are computed on a simplified mesh and normalised by the diameter of the whole one, as the benchmark
    does with `models_eval`. It is simplified in millimetres, like that, since the result depends on the unit.
    """
    in_mm = simplified(replace(mesh, vertices=1000 * mesh.vertices), most_triangles=EVALUATED_TRIANGLES)
    few = replace(in_mm, vertices=in_mm.vertices / 1000)
    return BenchmarkModel(
        few.vertices,
        _corners(few.vertices),
        _diameter(_corners(mesh.vertices)),
        symmetry_transforms(symmetries),
        RayScene([few], threads=threads),
    )


def _corners(points: Points) -> Points:
    """The points on the convex hull."""
    from scipy.spatial import ConvexHull

    return np.asarray(points[ConvexHull(points).vertices])


def _diameter(corners: Points) -> float:
    from scipy.spatial.distance import pdist

    return float(pdist(corners).max())


@dataclass(frozen=True)
class BenchmarkErrors:
    """Errors of one estimate.

    Attributes:
        vsd: one per tolerance of `VSD_TAUS`; None without a depth image.
        mssd: in diameters.
        mspd_px: in pixels of an image that is 640 px wide, as the benchmark scales it.
    """

    vsd: Float64[np.ndarray, " t"] | None
    mssd: float
    mspd_px: float


def benchmark_errors(
    model: BenchmarkModel,
    estimated: Transform,
    true: Transform,
    *,
    intrinsics: Intrinsics,
    measured_m: Depths | None = None,
) -> BenchmarkErrors:
    """Measure the three errors of a pose ``camera_from_object``.

    Args:
        model: the object.
        estimated, true: the poses.
        intrinsics: the camera; it is prepared once, as long as few cameras alternate.
        measured_m: depth image at the colour pixels, metres; 0 = none.
    """
    surfaces = None
    if measured_m is not None:
        surfaces = rendered_vsd(
            estimated,
            true,
            measured_m,
            rays=model.rays,
            table=_table(intrinsics),
            corners=model.corners,
            diameter_m=model.diameter_m,
        )
    apart_px = mspd_px(estimated, true, model.points, intrinsics, model.symmetries)
    return BenchmarkErrors(
        surfaces,
        mssd_m(estimated, true, model.corners, model.symmetries) / model.diameter_m,
        apart_px * 640.0 / intrinsics.width,
    )
