"""What a frame's own images say of a label, on a ball in front of a wall drawn by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from rpl_data.geometry import from_rotvec
from rpl_data.label.alone import Body, ObjectAlone, SceneObject, object_alone
from rpl_data.label.certainty import EDGE_NOISE_PX, quality, sigma_px
from rpl_data.label.motion import Motion
from rpl_data.label.occlusion import Tolerances, depth_disagreement
from rpl_data.label.outline import REACH_PX, color_edges, depth_edges, outline_of
from rpl_data.raycast import PixelTable
from rpl_data.types import Frame, Intrinsics, KeypointModel, Mesh, Scene, Trajectory

CAMERA = PixelTable.of(Intrinsics(500.0, 500.0, 159.5, 119.5, 320, 240))
KEYPOINTS = 0.03 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=float)
STRAYED_M = 0.002
RADIUS_PX = 500 * 0.04 / np.sqrt(0.5**2 - 0.04**2)
"""A ball of 40 mm at 0.5 m: tan of the angle at which it is seen, times the focal length."""


def ball(strayed_m: float = 0.0) -> SceneObject:
    """A ball whose keypoints are known exactly."""
    made = o3d.geometry.TriangleMesh.create_sphere(0.04, resolution=40)
    mesh = Mesh(np.asarray(made.vertices), np.asarray(made.triangles).astype(np.int64))
    model = KeypointModel("ball", ("a", "b", "c", "d", "e"), KEYPOINTS)
    return SceneObject(model, np.zeros((5, 3, 3)), mesh, np.eye(4), strayed_m=strayed_m)


def labelled(offset_px: float = 0.0, *, strayed_m: float = 0.0) -> ObjectAlone:
    """The label of a ball at 0.5 m, `offset_px` to the right of the middle of the image."""
    pose = from_rotvec(np.zeros(3), np.array([offset_px * 0.5 / 500, 0.0, 0.5]))
    found = object_alone(CAMERA, Body.of(ball(strayed_m)), pose)
    assert found is not None
    return found


def drawn(inside: float, outside: float) -> np.ndarray:
    """An image of the ball in the middle, before a background."""
    v, u = np.mgrid[0:240, 0:320]
    return np.where(np.hypot(u - 159.5, v - 119.5) <= RADIUS_PX, inside, outside)


X, Y = CAMERA.directions[..., 0], CAMERA.directions[..., 1]
TOWARDS = 0.5 / (1 + X**2 + Y**2)  # |z (x, y, 1) - (0, 0, 0.5)| = 0.04
FRONT = TOWARDS - np.sqrt(np.maximum(TOWARDS**2 - (0.5**2 - 0.04**2) / (1 + X**2 + Y**2), 0))
DEPTH = np.where(drawn(1, 0) > 0, FRONT, 0.8).astype(np.float32)
GREY = drawn(180, 60).astype(np.uint8)


def sigmas(found: ObjectAlone, depth: np.ndarray | None, grey: np.ndarray | None) -> np.ndarray:
    return sigma_px(CAMERA, found, found.mask, depth, grey, Tolerances())


@pytest.mark.parametrize("offset_px", [0.0, 2.0, 5.0])
def test_edges_are_found_where_the_images_have_them(offset_px: float) -> None:
    found = labelled(offset_px)
    outline = outline_of(found.mask, found.mask, found.depth_m, found.window)
    expected_px = -offset_px * outline.normal[:, 0]  # the true outline lies to the left
    for edges in (depth_edges(outline, DEPTH, Tolerances()), color_edges(outline, GREY)):
        assert edges.found.mean() > 0.95
        error_px = edges.offset_px[edges.found] - expected_px[edges.found]
        assert np.sqrt((error_px**2).mean()) < 0.8
        assert abs(error_px.mean()) < 0.3


@pytest.mark.parametrize(("depth", "grey"), [(DEPTH, None), (None, GREY), (DEPTH, GREY)])
def test_a_label_is_as_uncertain_as_its_frame_shows_it_to_be_wrong(
    depth: np.ndarray | None, grey: np.ndarray | None
) -> None:
    assert sigmas(labelled(), depth, grey).max() < EDGE_NOISE_PX
    found = [sigmas(labelled(offset_px), depth, grey).mean() for offset_px in (2.0, 4.0)]
    assert found == pytest.approx([2.0, 4.0], rel=0.25)


def test_where_the_frame_shows_nothing_the_path_strays_as_usual() -> None:
    plain = np.full((240, 320), 100, np.uint8)
    for grey in (None, plain):
        found = sigmas(labelled(strayed_m=STRAYED_M), None, grey)
        assert found == pytest.approx(500 * STRAYED_M / 0.5, rel=0.1)  # 2 px at 0.5 m, nearer or farther


def test_edges_take_the_place_of_the_usual_straying_as_far_as_they_reach() -> None:
    found = [sigmas(labelled(strayed_m=strayed_m), DEPTH, GREY).mean() for strayed_m in (0.001, 0.012)]
    assert found[0] < 0.4, "1 px: seen"
    assert found[1] > 10, "12 px: mostly beyond the 8 px in which edges are sought"


def test_a_fast_object_is_as_uncertain_as_it_moves_while_a_frame_is_taken() -> None:
    found = labelled()
    slow, fast = [
        sigma_px(CAMERA, found, found.mask, DEPTH, GREY, Tolerances(), speed_px_s=v) for v in (0.0, 300.0)
    ]
    np.testing.assert_allclose(np.sqrt(fast**2 - slow**2), 300 * 0.004)


def test_the_speed_in_the_image_is_that_of_the_path() -> None:
    poses = [from_rotvec(np.zeros(3), np.array([0.001 * frame, 0.0, -0.5])) for frame in (0, 1, 3)]
    frames = tuple(Frame(index, index / 30, Path("c.png"), None) for index in range(4))
    scene = Scene("s", CAMERA.intrinsics, 0.001, frames)
    motion = Motion.of(scene, Trajectory(np.array([0, 1, 3]), np.stack(poses)))
    for frame in (0, 1, 3):  # 1 mm at 0.494 m is 1.01 px, 30 times a second
        assert motion.speed_px_s(CAMERA, frame, ball()) == pytest.approx(30 * 0.5 / 0.494, rel=0.001)
    by_frame = {frame: motion.speed_px_s(CAMERA, frame, ball()) for frame in (0, 1, 3)}
    assert motion.speeds_px_s(CAMERA, ball()) == pytest.approx(by_frame)
    alone = Motion.of(scene, Trajectory(np.array([2]), poses[0][None]))
    assert alone.speeds_px_s(CAMERA, ball()) == {2: 0}
    assert alone.speed_px_s(CAMERA, 2, ball()) == 0


def test_a_gap_in_depth_and_what_hides_the_object_are_no_edges_of_it() -> None:
    found = labelled()
    outline = outline_of(found.mask, found.mask, found.depth_m, found.window)
    assert not depth_edges(outline, np.zeros_like(DEPTH), Tolerances()).found.any()
    assert not depth_edges(outline, np.minimum(DEPTH, 0.3), Tolerances()).found.any()
    hidden = replace(found, mask=found.mask.copy())
    usable = found.mask.copy()
    usable[:, : usable.shape[1] // 2] = False
    half = outline_of(hidden.mask, usable, found.depth_m, found.window)
    assert half.uv_px[:, 0].min() >= 159 and len(half.uv_px) > 30


def test_holes_in_depth_make_no_wrong_label_certain_and_no_dark_object_uncertain() -> None:
    wrong = labelled(80.0)  # wholly beside the ball
    holes = np.where(np.random.default_rng(0).random(DEPTH.shape) < 0.75, 0, DEPTH).astype(np.float32)
    assert sigmas(wrong, DEPTH, None).min() > 30
    np.testing.assert_allclose(sigmas(wrong, holes, None), sigmas(wrong, DEPTH, None), rtol=0.1)
    rim = (drawn(1, 0) > 0) & (np.roll(drawn(1, 0), 2, axis=1) == 0)
    dark = np.where(drawn(1, 0) > 0, np.where(rim, 0.8, 0), DEPTH).astype(np.float32)
    assert sigmas(labelled(), dark, None).max() < EDGE_NOISE_PX
    assert sigmas(wrong, dark, None).min() > 30


def test_what_all_outlines_have_in_common_is_the_sensors() -> None:
    """The whole outline 2 px too wide in depth: as good as right; in colour it is the label's."""
    v, u = np.mgrid[0:240, 0:320]
    wider = np.hypot(u - 159.5, v - 119.5) <= RADIUS_PX + 2
    depth = np.where(wider & (DEPTH > 0.7), 0.497, DEPTH).astype(np.float32)
    by_depth, by_color = (
        sigma_px(CAMERA, labelled(), labelled().mask, *images, Tolerances()).max()
        for images in ((depth, None), (None, np.where(wider, 180, 60).astype(np.uint8)))
    )
    assert by_depth < 0.3 < by_color


def test_the_edge_near_the_outline_counts_not_a_stronger_one_beside_it() -> None:
    v, u = np.mgrid[0:240, 0:320]
    beside = np.hypot(u - 159.5, v - 119.5) > RADIUS_PX + 6
    grey = np.where(beside, 255, np.where(drawn(1, 0) > 0, 60, 130)).astype(np.uint8)
    found = labelled()
    edges = color_edges(outline_of(found.mask, found.mask, found.depth_m, found.window), grey)
    assert edges.found.all() and np.abs(edges.offset_px).max() < 1.5


def test_outlines_near_the_border_of_the_image_are_not_judged() -> None:
    found = labelled(159.5 - RADIUS_PX - REACH_PX / 2)
    outline = outline_of(found.mask, found.mask, found.depth_m, found.window)
    edges = color_edges(outline, GREY)
    assert not edges.found[outline.uv_px[:, 0] > 319 - REACH_PX / 2].any()


def test_quality_is_what_the_expected_error_makes_of_it() -> None:
    assert quality(np.zeros(3)) == 1.0
    assert quality(np.array([4.0, 4.0, np.nan])) == pytest.approx(0.5)  # 1.25 * 4 px = 5 px
    assert quality(np.full(3, np.nan)) == 0.0


def test_of_edges_and_print_the_smaller_counts() -> None:
    found, quiet = labelled(4.0), labelled()

    def largest(one: ObjectAlone, by_print_px: float | None) -> float:
        given = (CAMERA, one, one.mask, DEPTH, GREY, Tolerances())
        return float(sigma_px(*given, by_print_px=by_print_px).max())

    assert largest(found, 0.0) < largest(found, None)
    assert largest(found, 1.0) ** 2 == pytest.approx(largest(found, 0.0) ** 2 + 2.0**2), "twice what it moves"
    assert largest(found, 100.0) == largest(found, None)
    assert largest(quiet, 100.0) == largest(quiet, None)


def test_pixels_without_depth_do_not_disagree() -> None:
    """A dark object: of its 100 pixels five have depth, four of them that of the table behind its edges."""
    model_m, measured_m = np.ones((10, 10), np.float32), np.zeros((10, 10), np.float32)
    visible = np.ones((10, 10), bool)
    measured_m[0, :5] = [1.0, 1.5, 1.5, 1.5, 1.5]
    assert depth_disagreement(model_m, visible, measured_m, Tolerances()) == pytest.approx(0.04)
    assert depth_disagreement(model_m, ~visible, measured_m, Tolerances()) == 0.0
