"""Rigid transforms, the pinhole camera, and the conventions that every other module relies on.

Frames. ``a_from_b`` is a 4x4 float64 array in metres that takes points in b to a; in a product the
neighbours match: ``camera_from_object = invert(scene_from_camera) @ scene_from_object``.

- ``camera``: OpenCV's, x right, y down, z forward (along the optical axis).
- ``scene``: the first camera of the video, or the frame a given trajectory came in.
- ``object``: the keypoint model's, at the centroid of the keypoints.

Pixels. (u, v) = (column, row); the centre of the top-left pixel is (0, 0), as in OpenCV, so the
image covers [-0.5, width - 0.5) x [-0.5, height - 0.5). Boxes are `xyxy` with COCO's edges: a mask
of the one pixel (u, v) has box (u, v, u + 1, v + 1). `box_around` and `inside_image` below are the
only two places where the half pixel between the two appears.

Units are metres, pixels, seconds, radians unless a name says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float64
from scipy.spatial.transform import Rotation

from rpl_data.types import Box, DataError, Intrinsics, SquareBox

Transform = Float64[np.ndarray, "4 4"]
Points = Float64[np.ndarray, "n 3"]
Pixels = Float64[np.ndarray, "n 2"]

NEAREST_M = 1e-6
"""Points with a smaller z count as behind the camera and never project."""

OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""``camera_from_opengl`` and its inverse: OpenGL's (and ARKit's) camera has y up and looks along -z."""

COLLINEAR_M = 1e-4
"""Points whose standard deviation across a line is smaller lie on the line."""


# Rigid transforms ---------------------------------------------------------------------------------


def rigid(rotation: Float64[np.ndarray, "3 3"], translation_m: Float64[np.ndarray, "3"]) -> Transform:
    """The 4x4 transform ``x -> rotation @ x + translation_m``."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation_m
    return transform


def is_rotation(matrix: Float64[np.ndarray, "3 3"], *, tolerance: float = 0.01) -> bool:
    """Whether a matrix of any numbers, infinite ones included, is a proper rotation."""
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 1 + tolerance:
        return False
    orthogonal = np.allclose(matrix @ matrix.T, np.eye(3), atol=tolerance)
    return orthogonal and bool(np.linalg.det(matrix) > 0)


def invert(a_from_b: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 4 4"]:
    """Invert one rigid transform or a stack of them: ``b_from_a``."""
    inverse = np.zeros_like(a_from_b)
    rotation_t = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation_t
    inverse[..., :3, 3] = -(rotation_t @ a_from_b[..., :3, 3:])[..., 0]
    inverse[..., 3, 3] = 1
    return inverse


def transform(
    a_from_b: Transform, points_b: Float64[np.ndarray, "*batch 3"]
) -> Float64[np.ndarray, "*batch 3"]:
    """Move points from b to a; rows of NaN stay NaN."""
    moved: Float64[np.ndarray, "*batch 3"] = points_b @ a_from_b[:3, :3].T + a_from_b[:3, 3]
    return moved


def transform_all(
    a_from_b: Float64[np.ndarray, "h 4 4"], points_b: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "h n 3"]:
    """Move all points by every transform of a stack."""
    moved: Float64[np.ndarray, "h n 3"] = (
        np.einsum("hij,nj->hni", a_from_b[:, :3, :3], points_b) + a_from_b[:, None, :3, 3]
    )
    return moved


def from_rotvec(rotvec_rad: Float64[np.ndarray, "3"], translation_m: Float64[np.ndarray, "3"]) -> Transform:
    """Transform from an axis-angle rotation and a translation."""
    return rigid(Rotation.from_rotvec(rotvec_rad).as_matrix(), translation_m)


def from_quaternion_xyzw(
    quaternion_xyzw: Float64[np.ndarray, "4"], translation_m: Float64[np.ndarray, "3"]
) -> Transform:
    """Transform from a quaternion and a translation, as in a TUM line; the quaternion is normalised.

    Raises:
        DataError: the quaternion is zero or not finite.
    """
    norm = np.linalg.norm(quaternion_xyzw)
    if not np.isfinite(norm) or norm < 1e-9 or not np.isfinite(translation_m).all():
        raise DataError(
            f"a pose is not a rigid transform: quaternion {quaternion_xyzw}, translation "
            f"{translation_m}; expected finite numbers and a unit quaternion x y z w"
        )
    return rigid(Rotation.from_quat(quaternion_xyzw).as_matrix(), translation_m)


def to_quaternion_xyzw(a_from_b: Float64[np.ndarray, "*batch 4 4"]) -> Float64[np.ndarray, "*batch 4"]:
    """Unit quaternion x y z w (w >= 0) of the rotation."""
    rotation = Rotation.from_matrix(a_from_b[..., :3, :3])
    quaternion: Float64[np.ndarray, "*batch 4"] = rotation.as_quat(canonical=True)
    return quaternion


def rotation_angle_rad(rotation: Float64[np.ndarray, "3 3"]) -> float:
    """Geodesic angle of a rotation, 0 to pi: the paper's ``||log R||_F / sqrt(2)``."""
    return float(Rotation.from_matrix(rotation).magnitude())


def fit_rigid(
    points_a: Points, points_b: Points, weights: Float64[np.ndarray, " n"] | None = None
) -> Transform:
    """Fit ``a_from_b``, which minimises ``sum w |a_from_b(points_b) - points_a|^2``.

    Kabsch's closed form (Acta Cryst. A32, 1976) with the sign that keeps the rotation proper; the
    same optimum as Horn's quaternion solution (JOSA A 4, 1987) which the paper names.

    Raises:
        DataError: fewer than three points, or all on one line: the rotation would be arbitrary.
    """
    if len(points_a) < 3 or is_collinear(points_b) or is_collinear(points_a):
        raise DataError(
            f"a rigid transform needs at least 3 points that do not lie on a line; got {len(points_a)}"
            " with no spread across a line; click more keypoints"
        )
    w = np.ones(len(points_a)) if weights is None else weights
    w = w / w.sum()
    centre_a, centre_b = w @ points_a, w @ points_b
    covariance = (points_a - centre_a).T @ ((points_b - centre_b) * w[:, None])
    u, _, vt = np.linalg.svd(covariance)
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ proper @ vt
    return rigid(rotation, centre_a - rotation @ centre_b)


def is_collinear(points: Points, *, tolerance_m: float = COLLINEAR_M) -> bool:
    """Whether points lie on a line: their standard deviation across it is below the tolerance."""
    return bool(spread_m(points)[1] < tolerance_m)


def spread_m(points: Points) -> Float64[np.ndarray, "3"]:
    """Standard deviations of the points along their principal axes, largest first.

    The second is 0 for points on a line, the third for points in a plane.
    """
    if len(points) == 0:
        return np.zeros(3)
    centred = points - points.mean(axis=0)
    deviations = np.zeros(3)
    singular = np.linalg.svd(centred, compute_uv=False)
    deviations[: len(singular)] = singular / np.sqrt(len(points))
    return deviations


# The camera ---------------------------------------------------------------------------------------


def project(intrinsics: Intrinsics, points_camera: Points) -> Pixels:
    """Project points in the camera frame to pixels; NaN for points that are NaN or behind the camera."""
    uv = np.full((len(points_camera), 2), np.nan)
    ahead = (points_camera[:, 2] > NEAREST_M) & np.isfinite(points_camera).all(axis=1)
    if ahead.any():
        if intrinsics.distortion:
            distorted, _ = cv2.projectPoints(
                points_camera[ahead],
                np.zeros(3),
                np.zeros(3),
                intrinsics.matrix,
                np.array(intrinsics.distortion),
            )
            uv[ahead] = distorted.reshape(-1, 2)
        else:
            xy = points_camera[ahead, :2] / points_camera[ahead, 2:]
            uv[ahead] = xy * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy]
    return uv


UNDISTORTING = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
"""Iterations and accuracy (px of a camera with f = 1) to which lens distortion is removed."""


def rays(intrinsics: Intrinsics, uv_px: Pixels) -> Points:
    """Directions (z = 1) of the rays through pixels, lens distortion removed; inverse of `project`."""
    if intrinsics.distortion and len(uv_px):
        pixels, lens = np.asarray(uv_px, dtype=float).reshape(-1, 1, 2), np.array(intrinsics.distortion)
        undistort = getattr(cv2, "undistortPointsIter", None)  # OpenCV 4's, where the other stops early
        if undistort is None:
            found = cv2.undistortPoints(pixels, intrinsics.matrix, lens, criteria=UNDISTORTING)
        else:
            found = undistort(pixels, intrinsics.matrix, lens, None, None, UNDISTORTING)
        xy = found.reshape(-1, 2)
    else:
        xy = (uv_px - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    directions: Points = np.column_stack([xy, np.ones(len(uv_px))])
    return directions


def back_project(intrinsics: Intrinsics, uv_px: Pixels, depth_m: Float64[np.ndarray, " n"]) -> Points:
    """Points in the camera frame behind these pixels, at the given depths along the optical axis."""
    points: Points = rays(intrinsics, uv_px) * depth_m[:, None]
    return points


def cropped(intrinsics: Intrinsics, *, left_px: int, top_px: int, width: int, height: int) -> Intrinsics:
    """Camera whose image is this rectangle of the image (whole pixels)."""
    return Intrinsics(
        intrinsics.fx,
        intrinsics.fy,
        intrinsics.cx - left_px,
        intrinsics.cy - top_px,
        width,
        height,
        intrinsics.distortion,
    )


def resized(intrinsics: Intrinsics, *, width: int, height: int) -> Intrinsics:
    """Camera whose image is the resized image; edges stay edges, so centres move by half a pixel."""
    sx, sy = width / intrinsics.width, height / intrinsics.height
    return Intrinsics(
        intrinsics.fx * sx,
        intrinsics.fy * sy,
        (intrinsics.cx + 0.5) * sx - 0.5,
        (intrinsics.cy + 0.5) * sy - 0.5,
        width,
        height,
        intrinsics.distortion,
    )


def depth_sigma_m(depth_m: Float[np.ndarray, "*shape"] | float) -> Float[np.ndarray, "*shape"] | float:
    """Standard deviation of a depth measurement: 1.5 mm at 0.7 m, growing with z squared.

    Stereo triangulation: dz = z^2 / (f b) * d(disparity); for a RealSense D435 at 640x480
    (f b = 19 m px) this is 0.06 px of disparity noise.
    """
    return 1.5e-3 * (depth_m / 0.7) ** 2


# Boxes --------------------------------------------------------------------------------------------


def inside_image(intrinsics: Intrinsics, uv_px: Pixels) -> Bool[np.ndarray, " n"]:
    """Which positions lie on the image's pixels; False for NaN."""
    u, v = uv_px[:, 0], uv_px[:, 1]
    inside: Bool[np.ndarray, " n"] = (
        (u >= -0.5) & (u < intrinsics.width - 0.5) & (v >= -0.5) & (v < intrinsics.height - 0.5)
    )
    return inside


def box_around(uv_px: Pixels) -> Box:
    """Smallest box, with COCO's edges, around positions; a single pixel centre gives a 1x1 box."""
    u0, v0 = uv_px.min(axis=0) + 0.0
    u1, v1 = uv_px.max(axis=0) + 1.0
    return float(u0), float(v0), float(u1), float(v1)


def square_box(uv_px: Pixels, *, scale: float = 1.5) -> SquareBox:
    """The paper's bounding square of keypoints (section III-E): their box made square, times `scale`."""
    low, high = uv_px.min(axis=0), uv_px.max(axis=0)
    centre = (low + high) / 2
    return SquareBox(float(centre[0]), float(centre[1]), float((high - low).max() * scale))


@dataclass(frozen=True)
class Sphere:
    """A ball of space, in the frame its user says.

    Attributes:
        centre_m: its centre, metres.
        radius_m: its radius, metres.
    """

    centre_m: Float64[np.ndarray, "3"]
    radius_m: float


def sphere_around(points: Points, *, factor: float = 1.8, margin_m: float = 0.06) -> Sphere:
    """The ball about the centroid of points that reaches `factor` times as far as they do, and a margin more.

    With the defaults it holds an object whose keypoints the points are, and some of what it stands on.
    """
    centre = points.mean(axis=0)
    return Sphere(centre, factor * float(np.linalg.norm(points - centre, axis=1).max()) + margin_m)
