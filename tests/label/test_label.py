"""Labels against OpenCV's projection, pycocotools and cases worked out by hand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from inspect import unwrap
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
from pycocotools import mask as coco

from rpl_data.geometry import from_rotvec, transform
from rpl_data.keypoint_surface import KeypointSurface
from rpl_data.label.alone import SceneObject
from rpl_data.label.compiled_masks import encoded
from rpl_data.label.label import label_frames, sample_frames
from rpl_data.label.occlusion import Tolerances, hidden_pixels
from rpl_data.raycast import RayScene
from rpl_data.types import (
    DataError,
    Frame,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    Mesh,
    Rle,
    Scene,
    Trajectory,
)

CAMERA = Intrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)
LENS = Intrinsics(500.0, 510.0, 319.5, 239.5, 640, 480, (0.12, -0.25, 0.001, -0.0008, 0.05))
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def cube(half_m: float = 0.05, *, name: str = "cube", points: np.ndarray | None = None) -> SceneObject:
    """A cube around the origin with its corners as keypoints; covariance 1 mm on each axis."""
    triangles = np.array([t for a, b, c, d in FACES for t in ([a, b, c], [a, c, d])], dtype=np.int64)
    points = CORNERS * half_m if points is None else points
    model = KeypointModel(name, tuple(f"k{i}" for i in range(len(points))), points)
    covariance = np.tile(np.eye(3) * 1e-6, (len(points), 1, 1))
    return SceneObject(model, covariance, Mesh(CORNERS * half_m, triangles), np.eye(4))


def at(x: float, y: float, z: float, rotvec: Iterable[float] = (0, 0, 0)) -> np.ndarray:
    """A transform."""
    return from_rotvec(np.array(list(rotvec), dtype=float), np.array([x, y, z], dtype=float))


def no_depth(frame: Frame) -> np.ndarray:
    """Reads the depth of frames without a depth image: it must not be called."""
    raise AssertionError(f"frame {frame.index} has no depth image")


def label(
    objects: dict[str, tuple[SceneObject, np.ndarray]],
    depth_m: np.ndarray | None = None,
    intrinsics: Intrinsics = CAMERA,
    grey: np.ndarray | None = None,
) -> dict[str, InstanceLabel]:
    """Instances of one frame by object name; the camera stands in the scene's origin."""
    frame = Frame(0, 0.0, Path("c.png"), None if depth_m is None else Path("d.png"))
    scene = Scene("s", intrinsics, 0.001, (frame,))
    trajectory = Trajectory(np.array([0]), np.eye(4)[None])
    poses = {(0, name, ""): pose for name, (_, pose) in objects.items()}
    items = [item for item, _ in objects.values()]
    read = {0: depth_m}
    (answer,) = label_frames(
        scene,
        trajectory,
        items,
        [frame],
        lambda asked: read[asked.index],
        camera_from_object=poses,
        read_grey=None if grey is None else lambda asked: grey,
    )
    return {instance.object: instance for instance in answer.instances}


def decoded(rle: Rle) -> np.ndarray:
    """The mask as pycocotools reads it."""
    return coco.decode({"size": rle["size"], "counts": rle["counts"].encode()}).astype(bool)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union."""
    return float((a & b).sum() / (a | b).sum())


# The front face of the cube below is 0.1 m wide at 0.5 m, f = 500: 319.5 -+ 50 px, pixels 270 .. 369.
FRONT = at(0, 0, 0.55)


def test_eq3_joins_trajectory_and_object() -> None:
    scene_from_camera, scene_from_object = at(0.1, 0, -0.4, (0, 0.2, 0)), at(0.05, 0.02, 0.3, (0.3, 0, 1))
    item = cube()
    item = SceneObject(item.model, item.covariance, item.mesh, scene_from_object)
    frame = Frame(7, 1.5, Path("c.png"), None)
    scene = Scene("s", CAMERA, 0.001, (frame,))
    trajectory = Trajectory(np.array([7]), scene_from_camera[None])
    (found,) = label_frames(scene, trajectory, [item], [frame], no_depth)
    assert (found.scene, found.frame, found.timestamp_s) == ("s", 7, 1.5)
    expected = np.linalg.inv(scene_from_camera) @ scene_from_object
    np.testing.assert_allclose(found.instances[0].camera_from_object, expected, atol=1e-12)


def test_hand_worked_cube_in_front() -> None:
    found = label({"cube": (cube(), FRONT)})["cube"]
    assert found.box_full == found.box == (270, 190, 370, 290)
    assert decoded(found.mask).sum() == 100 * 100
    assert found.mask == found.mask_full
    assert (found.visib_fract, found.truncated) == (1.0, False)
    # Standard deviation 1 mm: 1 px at 0.5 m, 500 / 600 px at 0.6 m, a little more off the axis (6 and 4 %).
    sigma_px = np.sqrt((1.01**2 + (1.008 / 1.2) ** 2) / 2)
    assert found.quality == pytest.approx(1 / (1 + 1.25 * sigma_px / 5), abs=0.002)
    # Corners are ordered (x, y, z): every second one is on the hidden back face at 0.6 m.
    assert found.visibility.tolist() == [2, 1] * 4
    np.testing.assert_allclose(found.keypoints_px[0], [269.5, 189.5])
    # Front corners span 100 px, so the square is 150 px.
    assert found.square_box.side_px == pytest.approx(150)
    assert (found.square_box.cx_px, found.square_box.cy_px) == pytest.approx((319.5, 239.5))


def test_sigma_is_the_covariance_in_pixels() -> None:
    found = label({"cube": (cube(points=np.array([[0, 0, -0.05]])), FRONT)})["cube"]
    # 1 mm across at 0.5 m and f = 500 is 1 px; along the axis it does not move the pixel.
    np.testing.assert_allclose(found.sigma_px, [1.0], rtol=1e-6)


@pytest.mark.parametrize("intrinsics", [CAMERA, LENS])
@pytest.mark.parametrize("pose", [at(0.02, -0.03, 0.5, (0.5, -0.4, 0.2)), at(0.22, 0.15, 0.6, (1, 0.3, 2))])
def test_keypoints_and_mask_agree_with_opencv(intrinsics: Intrinsics, pose: np.ndarray) -> None:
    found = label({"cube": (cube(), pose)}, intrinsics=intrinsics)["cube"]
    lens = np.array(intrinsics.distortion) if intrinsics.distortion else None
    rotvec, _ = cv2.Rodrigues(pose[:3, :3])
    uv, _ = cv2.projectPoints(CORNERS * 0.05, rotvec, pose[:3, 3], intrinsics.matrix, lens)
    np.testing.assert_allclose(found.keypoints_px, uv[:, 0], atol=1e-6)
    drawn = np.zeros((480, 640), np.uint8)
    dense = cube_edges() * 0.05
    uv, _ = cv2.projectPoints(dense, rotvec, pose[:3, 3], intrinsics.matrix, lens)
    hull = cv2.convexHull((uv[:, 0] * 16).round().astype(np.int32))
    cv2.fillConvexPoly(drawn, hull, 1, shift=4)
    assert iou(decoded(found.mask), drawn.astype(bool)) > 0.975  # OpenCV draws half a pixel of outline too


def cube_edges() -> np.ndarray:
    """Points along the twelve edges of the cube of side 2."""
    steps = np.linspace(0, 1, 50)[:, None]
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(CORNERS[a] - CORNERS[b]).sum() == 2]
    return np.concatenate([CORNERS[a] + steps * (CORNERS[b] - CORNERS[a]) for a, b in pairs])


def test_corners_of_a_turned_cube_hide_only_the_last_one() -> None:
    # Looking along the diagonal, seven corners are seen and the farthest is not.
    diagonal = np.array([1.0, 1, 1]) / np.sqrt(3)
    axis = np.cross(diagonal, [0, 0, 1])
    turn = axis / np.linalg.norm(axis) * np.arccos(diagonal[2])
    pose = at(0, 0, 0.6, turn + 0.05)
    found = label({"cube": (cube(), pose)})["cube"]
    farthest = int(np.argmax(transform(pose, CORNERS * 0.05)[:, 2]))
    assert [v for i, v in enumerate(found.visibility) if i != farthest] == [2] * 7
    assert found.visibility[farthest] == 1


def test_measured_occluder_hides_what_is_behind_it() -> None:
    depth = np.full((480, 640), 1.0, np.float32)
    depth[190:290, 270:370] = 0.5
    depth[:, :320] = 0.4  # a board in front of the left half
    found = label({"cube": (cube(), FRONT)}, depth)["cube"]
    assert found.box == (320, 190, 370, 290) and found.box_full == (270, 190, 370, 290)
    assert found.visib_fract == pytest.approx(0.5)
    assert found.visibility.tolist() == [1, 1, 1, 1, 2, 1, 2, 1]
    assert found.quality > 0.75, "its own half of the outline is where the label has it"


def test_depth_noise_and_missing_depth_hide_nothing() -> None:
    rng = np.random.default_rng(0)
    depth = (0.5 + 0.004 * rng.standard_normal((480, 640))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.01] = 0.3  # flying pixels
    depth[:, 300:320] = 0
    found = label({"cube": (cube(), FRONT)}, depth)["cube"]
    assert found.visib_fract > 0.995
    assert found.quality > 0.75
    without = label({"cube": (cube(), FRONT)}, np.zeros((480, 640), np.float32))["cube"]
    assert without.visib_fract == 1.0 and without.mask == found.mask_full


def test_quality_tells_a_pose_that_the_depth_contradicts() -> None:
    depth = np.full((480, 640), 0.7, np.float32)  # the object should be at 0.5
    # All of 100 x 100 pixels disagree, 30 % of which is usual: as if it were 0.886 * 100 * 0.7 = 62 px off.
    found = label({"cube": (cube(), FRONT)}, depth)["cube"]
    assert found.quality == pytest.approx(1 / (1 + 1.25 * 62 / 5), abs=0.001)


def test_another_object_hides_and_masks_do_not_overlap() -> None:
    near = at(0.05, 0, 0.35)
    found = label({"far": (cube(name="far"), FRONT), "near": (cube(0.02, name="near"), near)})
    far, front = found["far"], found["near"]
    assert front.visib_fract == 1.0 and far.visib_fract < 1.0
    masks = decoded(far.mask), decoded(front.mask)
    assert not (masks[0] & masks[1]).any()
    np.testing.assert_array_equal(masks[0], decoded(far.mask_full) & ~masks[1])
    assert far.mask_full == label({"far": (cube(name="far"), FRONT)})["far"].mask_full


def test_an_instance_hides_another_one_as_any_other_object_does() -> None:
    near = at(0.05, 0, 0.35)
    other = label({"far": (cube(name="far"), FRONT), "near": (cube(name="near"), near)})
    frame = Frame(0, 0.0, Path("c.png"), None)
    items = [replace(cube(), scene_from_object=FRONT), replace(cube(), scene_from_object=near, instance="2")]
    trajectory = Trajectory(np.array([0]), np.eye(4)[None])
    scene = Scene("s", CAMERA, 0.001, (frame,))
    (found,) = label_frames(scene, trajectory, items, [frame], lambda asked: np.zeros((1, 1), np.float32))
    for one, same in zip(found.instances, other.values(), strict=True):
        assert one.mask == same.mask and one.visibility.tolist() == same.visibility.tolist()
    assert [(one.object, one.instance) for one in found.instances] == [("cube", ""), ("cube", "2")]


def test_keypoint_behind_another_object_is_hidden() -> None:
    cover = at(-0.036, -0.036, 0.36)  # a small cube on the ray to the front corner (-, -)
    found = label({"far": (cube(name="far"), FRONT), "near": (cube(0.02, name="near"), cover)})["far"]
    assert found.visibility.tolist() == [1, 1, 2, 1, 2, 1, 2, 1]


def test_wholly_hidden_object_keeps_its_full_mask() -> None:
    found = label({"cube": (cube(), FRONT)}, np.full((480, 640), 0.3, np.float32))["cube"]
    assert found.box is None and found.visib_fract == 0.0
    assert found.box_full == (270, 190, 370, 290)
    assert decoded(found.mask).sum() == 0
    assert found.visibility.tolist() == [1] * 8


def test_wholly_hidden_object_has_no_edges_to_look_at() -> None:
    nearer = np.full((480, 640), 0.3, np.float32)
    grey = np.full((480, 640), 90, np.uint8)
    found, blind = (label({"cube": (cube(), FRONT)}, nearer, grey=g)["cube"] for g in (grey, None))
    np.testing.assert_array_equal(found.sigma_px, blind.sigma_px)


def test_truncated_at_the_border() -> None:
    found = label({"cube": (cube(), at(0.31, 0, 0.55))})["cube"]
    assert found.truncated
    assert found.box_full[2] == 640
    outside = found.keypoints_px[:, 0] >= 639.5
    assert outside.any() and not outside.all()
    assert (found.visibility[outside] == 0).all() and (found.visibility[~outside] > 0).all()
    assert np.isnan(found.sigma_px[outside]).all() and np.isfinite(found.sigma_px[~outside]).all()


@pytest.mark.parametrize("intrinsics", [CAMERA, LENS])
@pytest.mark.parametrize("pose", [at(0, 0, -0.55), at(3, 0, 0.5), at(0, -2, 0.6)])
def test_objects_out_of_view_have_no_instance(intrinsics: Intrinsics, pose: np.ndarray) -> None:
    assert label({"cube": (cube(), pose)}, intrinsics=intrinsics) == {}


def test_points_behind_the_camera_never_project() -> None:
    points = np.array([[0, 0, -0.05], [0, 0, -2.0], [np.nan] * 3])
    found = label({"cube": (cube(points=points), FRONT)})["cube"]
    assert found.visibility.tolist() == [2, 0, 0]
    assert np.isnan(found.keypoints_px[1:]).all() and np.isnan(found.sigma_px[1:]).all()
    left, top, right, bottom = found.box_full
    side_px = pytest.approx(1.5 * max(right - left, bottom - top))
    assert found.square_box.side_px == side_px, "around the mask, as one keypoint has no extent"


def test_camera_inside_the_object_is_survived() -> None:
    found = label({"cube": (cube(0.5), at(0, 0, 0.1))})["cube"]
    assert found.truncated and decoded(found.mask_full).all()


def test_far_points_folded_into_the_image_by_a_lens_are_not_keypoints() -> None:
    lens = Intrinsics(500.0, 500.0, 319.5, 239.5, 640, 480, (-0.4, 0.0, 0.0, 0.0))
    # r (1 - 0.4 r^2) falls back to 0 at r = 1.58, which lies far outside the field of view.
    points = np.array([[0.0, 0, -0.05], [0.5 * 1.55, 0, -0.05]])
    found = label({"cube": (cube(points=points), FRONT)}, intrinsics=lens)["cube"]
    assert found.visibility.tolist() == [2, 0]


def test_unregistered_depth_is_refused() -> None:
    scene = Scene("kitchen", CAMERA, 0.001, (), registered=False)
    with pytest.raises(DataError, match="kitchen.*not registered"):
        label_frames(scene, Trajectory(np.zeros(0, int), np.zeros((0, 4, 4))), [cube()], [], no_depth)


def test_depth_of_another_size_than_the_camera_is_an_error() -> None:
    """Also without the check of types that tests have: compiled code would read past the end."""
    model_m = np.full((4, 6), 0.5, np.float32)
    with pytest.raises(ValueError, match="of the camera's size"):
        unwrap(hidden_pixels)(model_m, model_m, model_m[:2], Tolerances())


def test_labels_are_lazy_and_frames_independent() -> None:
    frames = tuple(Frame(i, i / 30, Path("c.png"), None) for i in range(6))
    scene = Scene("s", CAMERA, 0.001, frames)
    poses = np.array([at(0.01 * i, 0, -0.6, (0, 0.02 * i, 0)) for i in range(6)])
    trajectory = Trajectory(np.arange(6), poses)
    pulled = []

    def source(indices: Iterable[int]) -> Iterable[Frame]:
        for i in indices:
            pulled.append(i)
            yield frames[i]

    everything = label_frames(scene, trajectory, [cube()], source(range(6)), no_depth)
    first = next(iter(everything))
    assert pulled == [0]
    whole: list[FrameLabel] = [first, *everything]
    parts = [
        x
        for r in (range(3), range(3, 6))
        for x in label_frames(scene, trajectory, [cube()], source(r), no_depth)
    ]
    assert [x.instances[0].mask for x in whole] == [x.instances[0].mask for x in parts]


def test_sampling_by_timestamps() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(90) / 30 + rng.uniform(-0.002, 0.002, 90)
    frames = [Frame(i, float(t), Path("c.png"), None) for i, t in enumerate(times)]
    assert [f.index for f in sample_frames(frames, rate_hz=3.0)] == list(range(0, 90, 10))
    assert sample_frames(frames, rate_hz=None) == frames
    assert sample_frames(frames, rate_hz=100.0) == frames
    assert sample_frames([], rate_hz=3.0) == []
    with pytest.raises(DataError, match="label rate"):
        sample_frames(frames, rate_hz=0.0)


@pytest.mark.parametrize("window", [(slice(3, 9), slice(2, 12)), (slice(0, 20), slice(0, 30))])
def test_window_code_equals_pycocotools(window: tuple[slice, slice]) -> None:
    rng = np.random.default_rng(2)
    for share in (0.0, 0.3, 0.9, 1.0):
        patch = rng.random((window[0].stop - window[0].start, window[1].stop - window[1].start)) < share
        full = np.zeros((20, 30), np.uint8, order="F")
        full[window] = patch
        expected = coco.encode(full)
        found = encoded(patch, window, width=30, height=20)
        assert found.rle["counts"] == expected["counts"].decode() and found.pixels == coco.area(expected)
        x, y, w, h = coco.toBbox(expected)
        assert found.box == ((x, y, x + w, y + h) if patch.any() else None)


def test_a_rigid_motion_of_the_scene_changes_nothing() -> None:
    move = at(0.3, -0.2, 1.0, (0.4, 1.0, -0.3))
    frame = Frame(0, 0.0, Path("c.png"), None)
    scene = Scene("s", CAMERA, 0.001, (frame,))
    item = cube()
    answers = []
    for scene_from in (np.eye(4), move):
        placed = SceneObject(
            item.model, item.covariance, item.mesh, scene_from @ at(0, 0, 0.6, (0.2, 0.1, 0.4))
        )
        trajectory = Trajectory(np.array([0]), scene_from[None])
        (found,) = label_frames(scene, trajectory, [placed], [frame], no_depth)
        answers.append(found.instances[0])
    np.testing.assert_allclose(answers[0].keypoints_px, answers[1].keypoints_px, atol=1e-9)
    assert iou(decoded(answers[0].mask), decoded(answers[1].mask)) > 0.999


def ball(resolution: int) -> RayScene:
    """A ball of radius 50 mm around the origin."""
    made = o3d.geometry.TriangleMesh.create_sphere(0.05, resolution=resolution)
    return RayScene([Mesh(np.asarray(made.vertices), np.asarray(made.triangles).astype(np.int64))])


def test_points_behind_the_horizon_of_a_ball_are_hidden() -> None:
    # The horizon is at 86 degrees from the direction of the camera, as cos 86 = 0.05 / 0.7.
    angles = np.deg2rad([0, 45, 70, 80, 90, 110, 135, 180])
    points = 0.05 * np.column_stack([np.sin(angles), np.zeros(8), -np.cos(angles)])
    rays, pose = ball(resolution=100), from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.7]))
    around = KeypointSurface.around(rays, points)
    assert around.faces(rays, pose).tolist() == [True] * 4 + [False] * 4


def test_keypoints_on_a_part_that_the_mesh_lacks_are_hidden_by_what_lies_in_front_of_them() -> None:
    points = np.array([[0.0, -0.07, 0.0], [0.0, 0.0, 0.07], [0.0, 0.0, -0.07]])  # above, behind, before
    rays, pose = ball(resolution=20), from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.7]))
    assert KeypointSurface.around(rays, points).faces(rays, pose).tolist() == [True, False, True]


def test_a_keypoint_without_a_position_is_not_seen() -> None:
    points = np.array([[np.nan] * 3, [0.0, 0.0, -0.05]])
    rays, pose = ball(resolution=20), from_rotvec(np.zeros(3), np.array([0.0, 0.0, 0.7]))
    assert KeypointSurface.around(rays, points).faces(rays, pose).tolist() == [False, True]
