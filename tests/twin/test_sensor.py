"""Every effect of the sensor, alone, against the number that is to set it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, invert, project, transform
from rpl_data.pipeline.recipe_file import parse_recipe
from rpl_data.twin import TwinSpec
from rpl_data.twin.film import Film, film
from rpl_data.twin.sensor import (
    PERFECT_COLOR,
    PERFECT_DEPTH,
    ColorSensor,
    DepthSensor,
    PerfectView,
    Sensor,
    measure_color,
    measure_depth,
    shifted,
)
from rpl_data.twin.sensor.depth import half_occluded
from rpl_data.twin.sensor.motion import flow_px_s, image_flow_px_s, twist
from rpl_data.types import Intrinsics

SHAPE = (240, 320)
CAMERA = Intrinsics(600.0, 590.0, 160.3, 119.2, 320, 240)


def view(
    depth_m: float | np.ndarray, *, cosine: float = 1.0, albedo: float = 0.5, shininess: float = 0.0
) -> PerfectView:
    def full(value: float | np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.broadcast_to(np.asarray(value, np.float32), SHAPE))

    return PerfectView(full(depth_m), full(cosine), full(albedo), full(shininess))


def measured(seen: PerfectView, sensor: DepthSensor, *, seed: int = 0) -> np.ndarray:
    return measure_depth(seen, sensor, focal_px=600.0, rng=np.random.default_rng(seed))


def step(*, front_m: float = 0.6, back_m: float = 1.0) -> PerfectView:
    """The front is right of column 160."""
    return view(np.where(np.arange(SHAPE[1]) < 160, back_m, front_m))


def only(**effects: float) -> DepthSensor:
    return replace(PERFECT_DEPTH, **effects)


# Wrong depth --------------------------------------------------------------------------------------


def test_a_perfect_sensor_changes_nothing() -> None:
    seen = view(np.random.default_rng(0).uniform(0.5, 2, SHAPE))
    np.testing.assert_array_equal(measured(seen, PERFECT_DEPTH), seen.depth_m)
    image = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3), np.uint8)
    flow = np.full((*SHAPE, 2), 500, np.float32)
    still = measure_color(image, PERFECT_COLOR, flow_px_s=flow, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(still, image)


@pytest.mark.parametrize("grain_px", [0.0, 4.0])
def test_axial_noise_grows_with_the_square_of_the_distance_as_triangulation_has_it(grain_px: float) -> None:
    sensor = only(subpixel_px=0.08, baseline_m=0.05, focal_px=386.0, grain_px=grain_px)
    distances_m = np.array([0.4, 0.7, 1.0, 1.5, 2.0])
    errors = [measured(view(z), sensor, seed=i) - z for i, z in enumerate(distances_m)]
    sigma_m = np.array([error.std() for error in errors])
    power, level = np.polyfit(np.log(distances_m), np.log(sigma_m), 1)
    assert power == pytest.approx(2, abs=0.06)
    assert np.exp(level) == pytest.approx(0.08 / (386 * 0.05), rel=0.06)
    assert max(abs(error.mean()) for error in errors) < 0.2 * sigma_m.max()


def test_noise_is_alike_over_its_grain() -> None:
    error = measured(view(0.7), only(subpixel_px=0.08, baseline_m=0.05, grain_px=3.0)) - 0.7
    alike = [(error[:, :-k] * error[:, k:]).mean() / error.var() for k in (3, 6, 12)]
    np.testing.assert_allclose(alike, np.exp(-np.square([3, 6, 12]) / (4 * 3.0**2)), atol=0.06)


@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 75.0])
def test_slanted_surfaces_are_noisier_as_nguyen_measured(angle_deg: float) -> None:
    angle = np.deg2rad(angle_deg)
    error = measured(view(0.8, cosine=float(np.cos(angle))), only(slope_noise=1.0, grain_px=0.0)) - 0.8
    assert error.std() == pytest.approx(1e-4 / np.sqrt(0.8) * (angle / (np.pi / 2 - angle)) ** 2, rel=0.02)


def test_disparity_comes_in_steps_of_a_32nd_pixel() -> None:
    seen = view(np.linspace(1.5, 2.5, SHAPE[1]))
    values = np.unique(measured(seen, only(disparity_step_px=1 / 32, baseline_m=0.05, focal_px=386.0)))
    steps = 386.0 * 0.05 * 32 / values[values > 0]
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert np.diff(np.round(steps[::-1])).min() == 1
    assert np.diff(values).mean() == pytest.approx(2.0**2 / (386 * 0.05 * 32), rel=0.1)  # 6 mm at 2 m


def test_the_stored_unit_is_a_millimetre() -> None:
    seen = view(np.linspace(0.7, 0.72, SHAPE[0] * SHAPE[1]).reshape(SHAPE))
    error = measured(seen, only(quantum_m=0.001)) - seen.depth_m
    assert error.std() == pytest.approx(0.001 / np.sqrt(12), rel=0.05)


@pytest.mark.parametrize("fatten_px", [0.0, 1.5])
def test_outlines_move_outwards_and_wander_by_the_given_widths(fatten_px: float) -> None:
    depth_m = measured(step(), only(bleed_px=1.5, fatten_px=fatten_px))
    assert set(np.unique(depth_m)) == {np.float32(0.6), np.float32(1.0)}  # never in between
    width_px = (depth_m == np.float32(0.6)).sum(axis=1) - 160.0  # of the front, by row
    assert width_px.mean() == pytest.approx(fatten_px, abs=0.45)
    assert width_px.std() == pytest.approx(1.5, rel=0.35)
    still = measured(step(), only(fatten_px=2.0))
    assert ((still == np.float32(0.6)).sum(axis=1) == 162).all()


# No depth -----------------------------------------------------------------------------------------


def test_near_and_far_are_lost() -> None:
    seen = view(np.linspace(0.1, 8.0, SHAPE[1]))
    lost = measured(seen, only(nearest_m=0.2, farthest_m=6.0)) == 0
    np.testing.assert_array_equal(lost, (seen.depth_m < 0.2) | (seen.depth_m > 6))


@pytest.mark.parametrize("angle_deg", [0.0, 6.0, 10.0, 16.0])
def test_grazing_surfaces_lose_depth_in_proportion(angle_deg: float) -> None:
    sine, limit = np.sin(np.deg2rad(angle_deg)), np.sin(np.deg2rad(15))
    lost = measured(view(1.0, cosine=float(sine)), only(grazing_deg=15.0)) == 0
    assert lost.mean() == pytest.approx(max(0.0, 1 - sine / limit), abs=0.015)


@pytest.mark.parametrize(
    ("albedo", "shininess", "share"), [(0.5, 0.0, 0), (0.01, 0.0, 0.5), (0.03, 0.5, 0.25)]
)
def test_dark_surfaces_lose_depth_and_darker_ones_more(albedo: float, shininess: float, share: float) -> None:
    seen = view(0.7, albedo=albedo, shininess=shininess)
    assert (measured(seen, only(dimmest=0.02)) == 0).mean() == pytest.approx(share, abs=0.015)


def test_polished_surfaces_lose_depth_where_they_face_the_camera() -> None:
    def lost(cosine: float, shininess: float) -> float:
        return float((measured(view(0.7, cosine=cosine, shininess=shininess), only(glare=1.0)) == 0).mean())

    assert lost(1.0, 0.8) == pytest.approx(0.8, abs=0.015)
    assert lost(float(np.cos(np.deg2rad(12))), 0.8) == pytest.approx(0.4, abs=0.03)
    assert lost(float(np.cos(np.deg2rad(40))), 0.8) < 0.001 and lost(1.0, 0.0) == 0


def test_half_occlusion_is_a_strip_left_of_the_front_as_wide_as_the_disparity_step() -> None:
    depth_m = np.full((4, 200), 1.0, np.float32)
    depth_m[:, 100:150] = 0.5
    hidden = half_occluded(depth_m, focal_px=600.0, baseline_m=0.05)
    # disparities 600 * 0.05 / z: 30 px behind, 60 px in front; 71 lands at 41, right of where 100 does
    np.testing.assert_array_equal(np.flatnonzero(hidden[0]), np.arange(71, 100))


def test_outlines_cost_depth_behind_them_and_less_before_them() -> None:
    lost = np.mean(
        [measured(step(), only(dropout=0.4, dropout_px=12.0), seed=i) == 0 for i in range(8)], axis=(0, 1)
    )
    behind, before = lost[:160][::-1], lost[160:]
    assert behind[0] == pytest.approx(0.4 * (1 - 1 / 12), abs=0.05)
    assert behind[5] == pytest.approx(0.4 * (1 - 6 / 12), abs=0.05)
    assert before[0] == pytest.approx(0.2 * (1 - 1 / 4), abs=0.05)
    assert not behind[12:].any() and not before[4:].any()


def test_a_slanted_plane_has_no_outline() -> None:
    v = np.arange(SHAPE[0], dtype=float)[:, None] * np.ones(SHAPE[1])
    plane = 0.3 / (np.sin(0.4) + (v - 120) / 600 * np.cos(0.4)).clip(0.02)  # a table 0.3 m below the camera
    cosine = 0.3 / plane
    seen = PerfectView(plane.astype(np.float32), cosine.astype(np.float32), *[np.ones(SHAPE, np.float32)] * 2)
    lost = measured(seen, only(dropout=0.5, dropout_px=12.0)) == 0
    assert not lost[plane < 1.5].any()


# Depth against colour -----------------------------------------------------------------------------


def test_a_wrong_registration_moves_the_depth_image() -> None:
    moved = shifted(step(), (3.0, -2.0))
    np.testing.assert_array_equal(moved.depth_m[2:230, 3:], step().depth_m[2:230, :-3])
    assert shifted(step(), (0.0, 0.0)).depth_m[0, 0] == np.float32(1.0)


@pytest.fixture(scope="module")
def hurried() -> Film:
    """A camera whose depth is two frames late and whose shutter rolls slowly; not rendered yet.

    It is near: the rows of a small thing in the middle of the image are all exposed at nearly one time.
    """
    sensor = Sensor(PERFECT_DEPTH, replace(PERFECT_COLOR, readout_s=0.06), lag_frames=2.0)
    spec = TwinSpec(objects=("carton",), scenes=1, seconds=1.0, rate_hz=10.0, width=480, height=360)
    return film(replace(spec, clutter=0, seed=3, distance_m=(0.35, 0.45), sensor=sensor), 0)


def test_a_lag_takes_the_depth_from_where_the_camera_was(hurried: Film) -> None:
    late = hurried.shoot(6)
    in_time = hurried.renderer.render(hurried.table_from_camera[4])
    np.testing.assert_allclose(late.depth_m, in_time.depth_m, atol=1e-5)
    assert np.abs(late.depth_m - late.perfect.depth_m).max() > 0.01


# Motion -------------------------------------------------------------------------------------------


def test_flow_is_how_projected_points_move() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.2, -0.15, 0.5], [0.2, 0.15, 1.5], (50, 3))
    now_from_later = from_rotvec(np.array([0.003, -0.002, 0.004]), np.array([0.001, -0.002, 0.0015]))
    camera = twist(np.eye(4), now_from_later, 0.01)
    before = project(CAMERA, transform(now_from_later, points))  # half way each, so to second order
    half = from_rotvec(camera[3:] * 0.005, camera[:3] * 0.005)
    before, after = (project(CAMERA, transform(move, points)) for move in (half, invert(half)))
    flow = flow_px_s(CAMERA, project(CAMERA, points), points[:, 2], camera)
    np.testing.assert_allclose(flow, (after - before) / 0.01, atol=0.2)
    assert np.abs(flow).max() > 100


def test_far_points_move_by_the_turn_alone() -> None:
    camera = np.array([1.0, 0, 0, 0, 0.5, 0])
    flow = image_flow_px_s(CAMERA, np.zeros(SHAPE, np.float32), camera)
    assert flow[119, 160, 0] == pytest.approx(-600 * 0.5, rel=0.01)


def _bar() -> np.ndarray:
    image = np.zeros((*SHAPE, 3), np.uint8)
    image[:, 160:] = 255
    return image


def test_motion_blur_is_as_long_as_the_camera_moves_during_the_exposure() -> None:
    flow = np.zeros((*SHAPE, 2), np.float32)
    flow[..., 0] = 1000
    sensor = replace(PERFECT_COLOR, exposure_s=0.008)
    row = measure_color(_bar(), sensor, flow_px_s=flow, rng=np.random.default_rng(0))[120, :, 0]
    light = np.power(row / 255, 2.2)
    ramp = np.flatnonzero((light > 0.02) & (light < 0.98))
    assert 7 <= len(ramp) <= 9
    np.testing.assert_allclose(ramp.mean(), 159.5, atol=0.6)  # about the moment of the frame
    np.testing.assert_allclose(light.sum(), 160, atol=0.2)


def test_a_rolling_shutter_shears_what_moves_about_the_middle_row() -> None:
    flow = np.zeros((*SHAPE, 2), np.float32)
    flow[..., 0] = 1000
    sensor = replace(PERFECT_COLOR, readout_s=0.016)
    image = measure_color(_bar(), sensor, flow_px_s=flow, rng=np.random.default_rng(0))
    edge = 320 - np.power(image[..., 0] / 255, 2.2).sum(axis=1)
    np.testing.assert_allclose(edge, 160 + 16 * (np.arange(240) / 239 - 0.5), atol=0.1)


def test_keypoints_are_shown_where_the_rolling_shutter_put_them(hurried: Film) -> None:
    """The patch around a corner is found again in the sheared image where `as_shown` says."""
    moves_px, errors_px = [], []
    for frame in (2, 7):
        shot = hurried.shoot(frame)
        true, shown = shot.label.instances[0], hurried.as_shown(shot.label).instances[0]
        for i in np.flatnonzero(true.visibility == 2):
            move = shown.keypoints_px[i] - true.keypoints_px[i]
            found = _found(shot.perfect.color, shot.color, true.keypoints_px[i])
            moves_px.append(np.hypot(*move))
            errors_px.append(np.hypot(*(found - move)))
    assert max(moves_px) > 3
    assert np.median(errors_px) < 1 and np.percentile(errors_px, 80) < 2


def _found(before: np.ndarray, after: np.ndarray, at_px: np.ndarray, reach: int = 24) -> np.ndarray:
    """How far the patch around a position has moved, whole pixels."""
    u, v = np.round(at_px).astype(int)
    patch = before[v - 12 : v + 13, u - 12 : u + 13]
    search = after[v - 12 - reach : v + 13 + reach, u - 12 - reach : u + 13 + reach]
    best = cv2.minMaxLoc(cv2.matchTemplate(search, patch, cv2.TM_CCOEFF_NORMED))[3]
    return np.array(best) - reach


# Colour -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [20, 120, 220])
def test_color_noise_grows_with_the_light(level: int) -> None:
    noisy = replace(PERFECT_COLOR, noise=3.0, shot_noise=4.0)
    grey = np.full((200, 200, 3), level, np.uint8)
    image = measure_color(grey, noisy, flow_px_s=None, rng=np.random.default_rng(0))
    assert image.std() == pytest.approx(np.hypot(3, 4 * np.sqrt(level / 255)), rel=0.03)


def test_exposure_differs_from_frame_to_frame() -> None:
    grey = np.full((20, 20, 3), 120, np.uint8)
    means = [
        measure_color(
            grey, replace(PERFECT_COLOR, exposure_spread=0.05), flow_px_s=None, rng=np.random.default_rng(i)
        ).mean()
        for i in range(60)
    ]
    assert np.std(means) / 120 == pytest.approx(0.05, rel=0.3)


def test_the_lens_blurs() -> None:
    image = measure_color(
        _bar(), replace(PERFECT_COLOR, blur_px=1.5), flow_px_s=None, rng=np.random.default_rng(0)
    )
    spread = np.diff(image[100, :, 0].astype(float))
    at = np.arange(len(spread))
    middle = (spread * at).sum() / spread.sum()
    assert np.sqrt((spread * (at - middle) ** 2).sum() / spread.sum()) == pytest.approx(1.5, rel=0.1)


# The whole ----------------------------------------------------------------------------------------


def test_the_defaults_are_what_was_measured_on_a_real_d435() -> None:
    """Triangulation and steps of disparity are read off real depth images; noise and holes are close."""
    sensor = DepthSensor()
    assert sensor.triangulation_m_px == pytest.approx(19.3)
    flat = measured(view(0.7, cosine=0.9), sensor)
    assert np.std(flat[flat > 0]) == pytest.approx(0.0020, rel=0.1)
    assert (flat == 0).mean() < 0.002
    lost = np.mean([measured(step(), sensor, seed=i) == 0 for i in range(8)], axis=(0, 1))
    assert 0.1 < lost[160:162].mean() < 0.25 and lost[170:].mean() < 0.01


def test_a_recipe_switches_effects_one_by_one() -> None:
    twin = {"sensor": {"depth": {"bleed_px": 0.0}, "color": {"readout_s": 0.017}, "lag_frames": 0.5}}
    spec = parse_recipe({"name": "x", "twin": twin}, source="x.yaml").twin
    assert spec is not None
    assert spec.sensor.depth == replace(DepthSensor(), bleed_px=0.0)
    assert spec.sensor.color == replace(ColorSensor(), readout_s=0.017)
    assert spec.lag_s == pytest.approx(0.5 / 30)
