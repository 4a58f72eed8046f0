"""The paper's evaluation, in which a CAD model aligned by ICP serves as truth (section IV-A).

GT-CAD is aligned to the sparse model and to every scene's surface: a person picks the keypoints on the CAD
once, which gives the start, and ICP does the rest. GT-SPARSE are the points of the CAD that are closest to
the aligned sparse model. Aligning absorbs part of the error that is to be measured, so these figures flatter;
where true poses are known, the strict protocol of `quality.py` is reported beside them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from rpl_data.formats.models.meshlab import picked_in_order, read_picked_points
from rpl_data.geometry import Points, Transform, fit_rigid, invert, rigid, transform
from rpl_data.meshes import load_mesh, oriented_points, select, thinned
from rpl_data.raycast import RayScene
from rpl_data.types import DataError, KeypointModel, Mesh, PointCloud
from rpl_data.wording import counted

MESHES = (".obj", ".ply", ".stl", ".glb", ".off")

REACHES_M = (0.015, 0.010, 0.006, 0.004)
"""How far a surface may lie from the CAD to count, from the first to the last rounds of ICP."""
ROUNDS = 15
"""Rounds of ICP per distance in `REACHES_M`."""
LEAST_POINTS = 60
"""With fewer surface points near the CAD, six degrees of freedom cannot be determined."""


@dataclass(frozen=True)
class Cad:
    """GT-CAD: the CAD model of an object.

    Attributes:
        mesh: triangles in the CAD's frame, metres.
        picked: one row per keypoint, where a person picked it on the CAD; NaN where not. Only starts ICP.
    """

    object: str
    mesh: Mesh
    picked: Points

    def __post_init__(self) -> None:
        """Refuse a CAD without enough picked points, and a mesh in millimetres."""
        size_m = np.ptp(self.mesh.vertices, axis=0).max()
        if size_m > 5:
            raise DataError(
                f"the CAD of {self.object} is {size_m:.0f} m long; expected metres: give its unit "
                "(0.001 for millimetres)"
            )
        if np.isfinite(self.picked).all(axis=1).sum() < 3:
            raise DataError(
                f"the CAD of {self.object} has fewer than 3 picked points; pick at least 3 keypoints on it"
            )


@dataclass(frozen=True)
class SparseOnCad:
    """The sparse model aligned to the CAD.

    Attributes:
        gt_sparse: GT-SPARSE, one row per keypoint, CAD frame; NaN where the model has none.
        distances_m: distance of every keypoint from its row of `gt_sparse`.
    """

    cad_from_object: Transform
    gt_sparse: Points
    distances_m: Float64[np.ndarray, " k"]


@dataclass(frozen=True)
class CadInScene:
    """The CAD aligned to a scene's surface.

    Attributes:
        points: number of surface points that lie on it.
        rms_m: root mean square of their distances.
    """

    scene_from_cad: Transform
    points: int
    rms_m: float


def align_sparse(cad: Cad, model: KeypointModel, *, rounds: int = 200) -> SparseOnCad:
    """Align the keypoints to the CAD by ICP, point to closest point, from the picked points.

    Raises:
        DataError: fewer than three keypoints are both known and picked.
    """
    both = model.known & np.isfinite(cad.picked).all(axis=1)
    if both.sum() < 3:
        raise DataError(
            f"object {model.name}: only {both.sum()} of its keypoints are both clicked and picked on the "
            "CAD; pick more of them"
        )
    surface = RayScene([cad.mesh], threads=1)
    points = model.points_object[model.known]
    cad_from_object = fit_rigid(cad.picked[both], model.points_object[both])
    for _ in range(rounds):
        moved = transform(cad_from_object, points)
        step = fit_rigid(surface.closest(moved).points, moved)
        cad_from_object = step @ cad_from_object
        if np.abs(transform(step, moved) - moved).max() < 1e-7:
            break
    moved = transform(cad_from_object, points)
    gt_sparse = np.full_like(model.points_object, np.nan)
    gt_sparse[model.known] = surface.closest(moved).points
    distances = np.linalg.norm(transform(cad_from_object, model.points_object) - gt_sparse, axis=1)
    return SparseOnCad(cad_from_object, gt_sparse, distances)


def align_scene(cad: Cad, surface: Mesh, start: Transform, *, voxel_m: float = 0.003) -> CadInScene:
    """Align the CAD to a scene's surface by ICP, point to plane, with ever nearer surface points.

    A surface point counts when it lies near the CAD and faces the same way as the CAD there, which excludes
    the support beside the object.

    Args:
        surface: surface of the scene, in the scene frame.
        start: initial `scene_from_cad`; it may be off by a few centimetres and ten degrees.

    Raises:
        DataError: too little of the surface is near the CAD at the start.
    """
    seen = thinned(oriented_points(surface), voxel_m=voxel_m)
    shape = RayScene([cad.mesh], threads=1)
    found = _Fit(start, np.inf, 0)
    for reach_m in REACHES_M:
        for _ in range(ROUNDS):
            before = found.scene_from_cad
            found = _step(shape, _around(cad.mesh, seen, before, reach_m), before, reach_m)
            if found.points < LEAST_POINTS:
                raise DataError(
                    f"object {cad.object}: only {counted(found.points, 'point')} of the surface lie within "
                    f"{1e3 * reach_m:.0f} mm of the CAD; check its picked points and its unit"
                )
            if np.abs(found.scene_from_cad - before).max() < 1e-6:
                break
    return CadInScene(found.scene_from_cad, found.points, found.rms_m)


@dataclass(frozen=True)
class _Fit:
    """An alignment, with the number and RMS distance of the points that counted before it."""

    scene_from_cad: Transform
    rms_m: float
    points: int


def _around(mesh: Mesh, seen: PointCloud, scene_from_cad: Transform, reach_m: float) -> PointCloud:
    """The points within reach of the CAD's box; closest-point queries on the others would cost most."""
    points = transform(invert(scene_from_cad), seen.points)
    low, high = mesh.vertices.min(axis=0) - reach_m, mesh.vertices.max(axis=0) + reach_m
    return select(seen, ((points > low) & (points < high)).all(axis=1))


def _step(shape: RayScene, seen: PointCloud, scene_from_cad: Transform, reach_m: float) -> _Fit:
    """Make a Gauss-Newton step on Huber-weighted distances from the CAD's planes (Chen & Medioni, 1992)."""
    cad_from_scene = invert(scene_from_cad)
    points = transform(cad_from_scene, seen.points)
    closest = shape.closest(points)
    offsets = points - closest.points
    facing = (seen.normals @ cad_from_scene[:3, :3].T * closest.normals).sum(axis=1) > 0.6
    near = np.linalg.norm(offsets, axis=1) < reach_m
    chosen: Bool[np.ndarray, " n"] = near & facing
    if chosen.sum() < LEAST_POINTS:
        return _Fit(scene_from_cad, np.inf, int(chosen.sum()))
    points, normals = points[chosen], closest.normals[chosen]
    distances = (offsets[chosen] * normals).sum(axis=1)
    weights = np.minimum(1, 0.4 * reach_m / np.maximum(np.abs(distances), 1e-9))
    centre = points.mean(axis=0)
    rows = np.hstack([np.cross(points - centre, normals), normals])
    normal_matrix = (rows * weights[:, None]).T @ rows
    # Where the surface leaves a rotation free (a can about its axis), the start's rotation is kept.
    damped = normal_matrix + 1e-6 * np.trace(normal_matrix) * np.eye(6)
    step = np.linalg.solve(damped, -rows.T @ (weights * distances))
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    moved = rigid(turn, centre - turn @ centre + step[3:])
    rms_m = float(np.sqrt(np.mean(distances**2)))
    return _Fit(scene_from_cad @ invert(moved), rms_m, int(chosen.sum()))


def cads_in(folder: Path, objects: Mapping[str, Sequence[str]], *, metres_per_unit: float) -> dict[str, Cad]:
    """Read the CADs of a folder: `<object>.obj` (or .ply .stl .glb .off) with `<object>.pp` beside it.

    Args:
        folder: the folder of the CADs.
        objects: names of the keypoints by object.
        metres_per_unit: unit of the meshes and of the points picked on them.

    Raises:
        DataError: the folder has a CAD for none of the objects, or one without picked points.
    """
    cads = {}
    for name, keypoints in objects.items():
        mesh = mesh_of(folder, name)
        if mesh is None:
            continue
        picks = folder / f"{name}.pp"
        if not picks.exists():
            raise DataError(
                f"{mesh} has no picked points; pick the keypoints on it with MeshLab and save {picks}"
            )
        picked = read_picked_points(picks, metres_per_unit=metres_per_unit)
        points = picked_in_order(picked.names, picked.points_mesh, keypoints, source=str(picks))
        cads[name] = Cad(name, scaled(load_mesh(mesh), metres_per_unit), points)
    if not cads:
        names = ", ".join(objects)
        raise DataError(f"{folder} has a CAD for none of {names}; name the files <object>.obj, <object>.pp")
    return cads


def mesh_of(folder: Path, name: str) -> Path | None:
    """The CAD file of an object; None where there is none."""
    return next((path for path in (folder / f"{name}{suffix}" for suffix in MESHES) if path.exists()), None)


def scaled(mesh: Mesh, metres_per_unit: float) -> Mesh:
    """Convert a mesh to metres."""
    return replace(mesh, vertices=mesh.vertices * metres_per_unit)
