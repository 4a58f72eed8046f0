"""Clicks to rays with candidate depths."""

from dataclasses import replace

import numpy as np
import pytest

from rpl_data.clicks.lift import (
    BEND_SHARE,
    EDGE_SIGMA_M,
    LIFT_SIGMA_M,
    SLOPE_SIGMA_PX,
    STEEPEST,
    candidate_surfaces,
    lift,
    lift_clicks,
)
from rpl_data.geometry import project
from rpl_data.types import Click, DataError, Frame, Intrinsics, Scene, Trajectory

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480, (0.05, -0.1, 0.001, -0.001))


def edge_image(left_m: float, right_m: float) -> np.ndarray:
    """Left of column 100 at one depth, right of it at another."""
    image = np.full((480, 640), left_m, dtype=np.float32)
    image[:, 100:] = right_m
    return image


def depths_at(image, u_px, v_px):
    return candidate_surfaces(image, u_px, v_px, pixel_rad=1 / 600).depths_m


def test_both_surfaces_of_an_edge_are_kept_nearest_first():
    image = edge_image(0.9, 0.7)
    for u in (98.0, 101.0):
        assert np.allclose(depths_at(image, u, 50.0), [0.7, 0.9])


def test_holes_are_no_candidates():
    image = edge_image(0.0, 0.7)
    assert np.allclose(depths_at(image, 98.0, 50.0), [0.7])
    assert len(depths_at(np.zeros((480, 640), dtype=np.float32), 98.0, 50.0)) == 0


def test_a_slanted_surface_is_one_candidate_at_the_click():
    rows, columns = np.mgrid[0:480, 0:640]
    image = (0.7 + 0.0005 * (columns - 200)).astype(np.float32)
    assert np.allclose(depths_at(image, 200.0, 50.0), [0.7], atol=1e-3)


def test_at_the_border_of_the_image():
    assert np.allclose(depths_at(edge_image(0.9, 0.7), 639.4, -0.4), [0.7])


def test_the_ray_goes_through_the_click_with_distortion():
    click = Click("cube", 0, "00", 0, 17.25, 402.5)
    observation = lift(click, CAMERA, np.eye(4), edge_image(0.9, 0.7))
    back = project(CAMERA, (0.8 * observation.ray_camera)[None])
    assert np.allclose(back, [[17.25, 402.5]], atol=1e-3)


def scene_and_reader(tmp_path):
    frames = tuple(Frame(i, i / 30, tmp_path / "c.png", tmp_path / "d.png") for i in (0, 2))
    scene = Scene("00", CAMERA, 0.001, frames)
    trajectory = Trajectory(np.array([0, 2]), np.stack([np.eye(4)] * 2))
    reads = []

    def read(frame):
        reads.append(frame.index)
        return edge_image(0.9, 0.7)

    return {"00": scene}, {"00": trajectory}, read, reads


def test_every_clicked_image_is_read_once(tmp_path):
    scenes, trajectories, read, reads = scene_and_reader(tmp_path)
    clicks = [Click("cube", k, "00", f, 100.0 + k, 50.0) for k in range(4) for f in (0, 2)]
    assert len(lift_clicks(clicks, scenes, trajectories, lambda scene: read)) == 8
    assert sorted(reads) == [0, 2]


def test_clicks_keep_their_order_and_a_frame_may_lack_depth(tmp_path):
    scenes, trajectories, read, reads = scene_and_reader(tmp_path)
    (first, second) = scenes["00"].frames
    scenes = {"00": replace(scenes["00"], frames=(first, replace(second, depth=None)))}
    clicks = [Click("cube", k, "00", f, 100.0, 50.0) for k in range(2) for f in (2, 0)]
    observations = lift_clicks(clicks, scenes, trajectories, lambda scene: read)
    assert [o.click for o in observations] == clicks
    assert reads == [0]
    assert [len(o.depths_m) for o in observations] == [0, 2, 0, 2]


def test_a_click_in_a_frame_without_a_pose_is_named(tmp_path):
    scenes, _, read, _ = scene_and_reader(tmp_path)
    known = {"00": Trajectory(np.array([0]), np.eye(4)[None])}
    with pytest.raises(
        DataError, match="object cube, scene 00, a click in frame 2: the trajectory has no pose"
    ):
        lift_clicks([Click("cube", 0, "00", 2, 10.0, 10.0)], scenes, known, lambda scene: read)


@pytest.mark.parametrize(
    ("click", "message"),
    [
        (Click("cube", 3, "00", 0, 640.0, 50.0), r"outside the image of 640 x 480"),
        (Click("cube", 3, "00", 0, 10.0, -0.6), r"outside the image"),
        (
            Click("cube", 3, "07", 0, 10.0, 10.0),
            r"scene '07', which is not in the workspace; the scenes are 00",
        ),
        (Click("cube", 3, "00", 1, 10.0, 10.0), r"scene 00 has no frame 1"),
    ],
)
def test_bad_clicks_are_named(tmp_path, click, message):
    scenes, trajectories, read, _ = scene_and_reader(tmp_path)
    with pytest.raises(DataError, match=message):
        lift_clicks([click], scenes, trajectories, lambda scene: read)


def test_a_far_surface_is_less_sure_and_continued_as_a_plane():
    """The right half slopes; a click 6 px left of its edge takes the slope along."""
    columns = np.mgrid[0:480, 0:640][1]
    inverse = 1 / 0.7 + 0.0005 * (columns - 200)
    image = np.where(columns >= 206, 1 / inverse, 0).astype(np.float32)
    found = candidate_surfaces(image, 200.0, 50.0, pixel_rad=1 / 600)
    depths, sigmas = found.depths_m, found.sigmas_m
    assert depths == pytest.approx([0.7], abs=1e-3)
    slope_m = SLOPE_SIGMA_PX * 0.0005 * 0.7**2  # metres over so many pixels
    assert sigmas[0] == pytest.approx(
        np.sqrt(0.0015**2 + LIFT_SIGMA_M**2 + EDGE_SIGMA_M**2 + slope_m**2 + (5 * 0.7 / 600) ** 2), rel=0.01
    )


def test_across_a_hole_a_steep_surface_is_less_sure():
    """The same hole of 5 px; the surface beside it changes by 1.2 m of depth per metre across."""
    columns = np.mgrid[0:480, 0:640][1]
    flat, steep = (
        candidate_surfaces(
            np.where(columns >= 206, 0.7 / (1 - slope * (columns - 200) / 600), 0).astype(np.float32),
            200.0, 50.0, pixel_rad=1 / 600,
        )
        for slope in (0.0, 1.2)
    )  # fmt: skip
    gap_m, found = 5 * 0.7 / 600, float(np.hypot(*steep.slopes_m[0])) / steep.depths_m[0]
    sloping_m = SLOPE_SIGMA_PX * found * steep.depths_m[0] / 600
    wider = steep.sigmas_m[0] ** 2 - flat.sigmas_m[0] ** 2
    assert wider == pytest.approx((gap_m * found) ** 2 + sloping_m**2, rel=0.15)


def test_two_faces_rounded_into_one_are_no_plane():
    """A ridge whose sides fall by 45 degrees: beside it the pixels lie below any plane through it."""
    columns = np.mgrid[0:480, 0:640][1]
    ridge = (0.7 + np.abs(columns - 200) * 0.7 / 600).astype(np.float32)
    found = candidate_surfaces(ridge, 200.0, 50.0, pixel_rad=1 / 600)
    flat = candidate_surfaces(np.full((480, 640), 0.7, np.float32), 200.0, 50.0, pixel_rad=1 / 600)
    bend_m = np.sqrt(found.sigmas_m[0] ** 2 - flat.sigmas_m[0] ** 2) / BEND_SHARE
    # The distance from the ridge has this standard deviation under the weights 2^-(r^2 / 25).
    sigma_px = 5 / np.sqrt(2 * np.log(2))
    assert bend_m == pytest.approx(sigma_px * np.sqrt(1 - 2 / np.pi) * 0.7 / 600, rel=0.1)


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 65.0])
def test_the_slope_of_a_tilted_plane_is_found(angle_deg):
    """A plane through (0, 0, 0.7) turned about the v axis: depth changes by tan(angle) per metre across."""
    across = (np.mgrid[0:480, 0:640][1] - 320) / 600
    image = (0.7 / (1 - np.tan(np.radians(angle_deg)) * across)).astype(np.float32)
    found = candidate_surfaces(image, 320.0, 240.0, pixel_rad=1 / 600)
    assert found.depths_m == pytest.approx([0.7], abs=1e-3)
    assert found.slopes_m[0] == pytest.approx([0.7 * np.tan(np.radians(angle_deg)), 0], rel=0.08, abs=1e-3)


def test_a_steep_surface_is_less_sure_than_one_that_faces_the_camera():
    across = (np.mgrid[0:480, 0:640][1] - 320) / 600
    sigmas = [
        candidate_surfaces(
            (0.7 / (1 - tan * across)).astype(np.float32), 320.0, 240.0, pixel_rad=1 / 600
        ).sigmas_m[0]
        for tan in (0.0, 0.7, 1.4)
    ]
    assert sigmas[0] < sigmas[1] < sigmas[2]


def test_slopes_that_cannot_be_are_cut_off():
    columns = np.mgrid[0:480, 0:640][1]
    image = (0.7 + 0.006 * (columns - 320)).astype(np.float32)  # 6 mm per pixel: 79 degrees
    slopes = candidate_surfaces(image, 320.0, 240.0, pixel_rad=1 / 600).slopes_m
    assert np.hypot(*slopes[0]) <= STEEPEST * 0.7 * (1 + 1e-6)


def test_a_surface_that_ends_near_the_click_is_less_sure():
    sigmas = [
        candidate_surfaces(edge_image(0.9, 0.7), u_px, 50.0, pixel_rad=1 / 600).sigmas_m[0]
        for u_px in (130.0, 110.0, 100.0)
    ]
    assert sigmas[0] < sigmas[1] < sigmas[2]
