"""What is said of clicks: the mistake that was made, or that they disagree; nothing of clean clicks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpl_data.geometry import invert, rays, rigid, transform
from rpl_data.solve.bundle_adjustment import State
from rpl_data.solve.click_rays import Noise, rays_of
from rpl_data.solve.diagnosis import Placed, diagnose, left_out
from rpl_data.solve.explanations import contradiction
from rpl_data.solve.refit import costs_without, read_as_named, refit
from rpl_data.solve.solve import register, solve
from rpl_data.solve.unnoticed import POWER_SIGMAS, unnoticed_slips_px
from rpl_data.types import Click, Intrinsics, KeypointModel, Observation

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480)
POINTS = np.random.default_rng(2).uniform(-0.06, 0.06, (8, 3))
NAMES = tuple("abcdefgh")


def scene_poses(scenes, seed=0):
    random = np.random.default_rng(seed)
    places = [rigid(Rotation.random(rng=random).as_matrix(), np.array([0, 0, 0.7])) for _ in range(scenes)]
    return {f"{s:02d}": place for s, place in enumerate(places)}


def clicks_on(places, *, frames=1, noise_px=1.0, seed=1, keypoints=None):
    """One click per keypoint, scene and frame; `keypoints` may say which ones a scene shows."""
    random, found = np.random.default_rng(seed), []
    for scene, scene_from_object in places.items():
        for frame in range(frames):
            around = rigid(Rotation.from_rotvec([0, 0.3 * frame, 0]).as_matrix(), np.zeros(3))
            pivot = rigid(np.eye(3), np.array([0, 0, 0.7]))
            scene_from_camera = pivot @ around @ invert(pivot)
            points = transform(invert(scene_from_camera) @ scene_from_object, POINTS)
            for k in (keypoints or {}).get(scene, range(len(POINTS))):
                u, v = points[k, :2] / points[k, 2] * 600 + [320, 240] + random.normal(0, noise_px, 2)
                depth_m = points[k, 2] + random.normal(0, 0.002)
                found.append(_observed(Click("it", k, scene, frame, u, v), scene_from_camera, depth_m))
    return found


def _observed(click, scene_from_camera, depth_m):
    return Observation(
        click,
        rays(CAMERA, np.array([[click.u_px, click.v_px]]))[0],
        scene_from_camera,
        np.array([depth_m]),
        np.array([0.004]),
        1 / 600,
    )


def changed(observations, which, change):
    """The clicks that `which` picks as `change` makes them, at the depth that was there."""
    return [
        _observed(change(o.click), o.scene_from_camera, o.depths_m[0]) if which(o.click) else o
        for o in observations
    ]


def moved(px):
    return lambda click: replace(click, u_px=click.u_px + px)


def about_faults(statements):
    """Without the clicks that could not be judged, which are named with most sets of few clicks."""
    return tuple(said for said in statements if said.kind != "unjudged")


def told(observations):
    return about_faults(solve("it", NAMES, observations).statements)


def test_a_slip_in_a_click_that_could_not_be_judged_is_small_in_the_residuals():
    """The stated slip against the fall of the cost when that click slips by so much."""
    places = scene_poses(4)
    observations = clicks_on(places)
    all_rays = rays_of(observations, sorted(places))
    at = np.stack(list(places.values())), POINTS
    fit = refit(all_rays, read_as_named(all_rays), *at, sigma_px=2.0, most_steps=60)
    slips_px = unnoticed_slips_px(fit)
    n, needed = int(slips_px.argmin()), (np.sqrt(contradiction(len(observations))) + POWER_SIGMAS) ** 2
    falls = []
    for angle in np.linspace(0, np.pi, 13):
        shift = slips_px[n] * all_rays.pixel_rad[n] * np.array([np.cos(angle), np.sin(angle)])
        xy = all_rays.xy + shift * (np.arange(len(all_rays.xy)) == n)[:, None]
        slipped = refit(all_rays._replace(xy=xy), read_as_named(all_rays), *at, sigma_px=2.0, most_steps=60)
        falls.append(costs_without(slipped, [np.array([n])])[0])
    assert min(falls) == pytest.approx(needed, rel=0.3)


def test_clicks_that_nothing_would_contradict_are_named_weakest_first():
    observations = clicks_on(scene_poses(2), noise_px=1.0)
    (said,) = (s for s in solve("it", NAMES, observations).statements if s.kind == "unjudged")
    assert not said.blames and f"{len(said.clicks)} clicks of {len(observations)}" in said.text
    worst = said.clicks[0]
    title = f"{worst.keypoint} {NAMES[worst.keypoint]}"
    assert f"click keypoint {title} in scene {worst.scene} again" in said.text
    assert f"another frame than {worst.frame}" in said.text


@pytest.mark.parametrize("frames", [1, 3])
def test_nothing_is_said_of_clean_clicks(frames):
    for seed in range(6):
        assert not told(clicks_on(scene_poses(4, seed), frames=frames, noise_px=2.0, seed=seed))


@pytest.mark.parametrize("frames", [1, 3])
def test_exchanged_keypoints_are_a_swap_and_not_two_wrong_clicks(frames):
    exchange = {2: 5, 5: 2}
    observations = changed(
        clicks_on(scene_poses(4), frames=frames),
        lambda c: c.scene == "01" and c.keypoint in exchange,
        lambda c: replace(c, keypoint=exchange[c.keypoint]),
    )
    (said,) = told(observations)
    assert said.kind == "swapped"
    assert {(c.scene, c.keypoint) for c in said.clicks} == {("01", 2), ("01", 5)}
    assert "scene 01: keypoints 2 c and 5 f are swapped" in said.text


def test_a_click_on_another_keypoint_names_it():
    clean = clicks_on(scene_poses(4))
    there = next(o.click for o in clean if (o.click.scene, o.click.keypoint) == ("02", 6))
    observations = changed(
        clean,
        lambda c: (c.scene, c.keypoint) == ("02", 1),
        lambda c: replace(c, u_px=there.u_px, v_px=there.v_px),
    )
    (said,) = told(observations)
    assert (said.kind, [c.keypoint for c in said.clicks]) == ("wrong name", [1])
    assert "keypoint 1 b was clicked where keypoint 6 g is" in said.text


@pytest.mark.parametrize("px", [20.0, 60.0])
def test_a_slip_is_blamed_alone_with_its_distance(px):
    observations = changed(clicks_on(scene_poses(4)), lambda c: (c.scene, c.keypoint) == ("03", 4), moved(px))
    solution = solve("it", NAMES, observations)
    (said,) = about_faults(solution.statements)
    assert [(c.scene, c.keypoint) for c in said.clicks] == [("03", 4)]
    assert said.kind in ("wrong place", "wrong name")
    assert [r.click for r in solution.residuals if r.outlier] == list(said.clicks)


def test_one_of_three_frames_is_blamed_alone():
    observations = changed(
        clicks_on(scene_poses(3), frames=3),
        lambda c: (c.scene, c.keypoint, c.frame) == ("01", 4, 2),
        moved(25.0),
    )
    (said,) = told(observations)
    assert [(c.scene, c.keypoint, c.frame) for c in said.clicks] == [("01", 4, 2)]


def test_two_placements_disagree_and_a_third_is_asked_for():
    shown = {"02": range(7), "03": range(7)}  # keypoint h in scenes 00 and 01 only
    observations = changed(
        clicks_on(scene_poses(4), keypoints=shown),
        lambda c: (c.scene, c.keypoint) == ("01", 7),
        moved(40.0),
    )
    solution = solve("it", NAMES, observations)
    (said,) = about_faults(solution.statements)
    assert said.kind == "disagree"
    assert {(c.scene, c.keypoint) for c in said.clicks} == {("00", 7), ("01", 7)}
    assert "keypoint 7 h: its clicks in scene 00 and scene 01 disagree by" in said.text
    assert "mark it in a third scene" in said.text
    assert not any(r.outlier for r in solution.residuals)
    assert {r.click.scene for r in solution.residuals if r.reason} == {"00", "01"}


def test_frames_of_one_scene_that_disagree_may_be_the_cameras_fault():
    elsewhere = {scene: range(7) for scene in ("01", "02", "03")}  # keypoint h in scene 00 only
    twice = clicks_on(scene_poses(4), frames=2, keypoints=elsewhere)
    observations = changed(
        [o for o in twice if o.click.frame == 0 or o.click.keypoint == 7],
        lambda c: (c.keypoint, c.frame) == (7, 1),
        moved(40.0),
    )
    (said,) = told(observations)
    assert said.kind == "disagree" and {c.frame for c in said.clicks} == {0, 1}
    assert "whether the camera's path strays there; mark it in one more frame" in said.text


def test_a_mirrored_scene_is_said_as_a_whole():
    observations = changed(
        clicks_on(scene_poses(4), frames=2),
        lambda c: c.scene == "02",
        lambda c: replace(c, u_px=640 - c.u_px),
    )
    kinds = {s.kind: s for s in told(observations)}
    assert "scene 02" in kinds["whole scene"].text
    assert {c.scene for c in kinds["whole scene"].clicks} == {"02"}


def four_clicks_in(scene, observations):
    """Of that scene one click each of four keypoints only, every one in another frame."""
    return [
        o
        for o in observations
        if (o.click.scene == scene and o.click.keypoint < 4 and o.click.frame == o.click.keypoint)
        or (o.click.scene != scene and o.click.frame == 0)
    ]


def test_a_mirrored_scene_of_four_clicks_is_said_as_a_whole():
    """One wrong click would explain it too: with three of the four clicks the object can be placed."""
    clean = clicks_on(scene_poses(4), frames=4)
    middle_px = {}
    for frame in range(4):
        across = [o.click.u_px for o in clean if (o.click.scene, o.click.frame) == ("02", frame)][:4]
        middle_px[frame] = (min(across) + max(across)) / 2
    observations = changed(
        four_clicks_in("02", clean),
        lambda c: c.scene == "02",
        lambda c: replace(c, u_px=2 * middle_px[c.frame] - c.u_px),
    )
    (said,) = told(observations)
    assert said.kind == "whole scene" and {c.scene for c in said.clicks} == {"02"}
    assert (
        "scene 02: its 4 clicks contradict those of the other scenes, and fit as a mirror image" in said.text
    )


@pytest.mark.parametrize("keypoint", [0, 2])
def test_one_wrong_click_of_four_is_not_taken_for_a_mirrored_scene(keypoint):
    observations = changed(
        four_clicks_in("02", clicks_on(scene_poses(4), frames=4)),
        lambda c: (c.scene, c.keypoint) == ("02", keypoint),
        moved(40.0),
    )
    assert all(said.kind != "whole scene" for said in told(observations))


def test_a_wrong_depth_is_no_wrong_click():
    """The background beside a corner: the ray is right, the depth 30 cm too far."""
    places = scene_poses(4)
    observations = [
        replace(o, depths_m=o.depths_m + 0.3) if (o.click.scene, o.click.keypoint) == ("01", 3) else o
        for o in clicks_on(places)
    ]
    assert not told(observations)


def test_a_new_scene_is_diagnosed_against_the_known_model():
    places = scene_poses(1)
    model = KeypointModel("it", NAMES, POINTS)
    clean = clicks_on(places)
    assert not any(r.reason for r in register(model, clean)[1])
    slipped = changed(clean, lambda c: c.keypoint == 3, moved(40.0))
    assert [r.click.keypoint for r in register(model, slipped)[1] if r.outlier] == [3]


def placed_at(places, observations, ties):
    """An answer at the truth, as sure as 3 mm in every scene."""
    names = sorted(places)
    return Placed(
        names,
        rays_of(observations, names),
        State(np.stack([places[name] for name in names]), POINTS),
        Noise(2.0, 1.0),
        1e-6 * np.eye(6 * len(names) + POINTS.size),
        {name: np.tile(3e-6 * np.eye(3), (len(POINTS), 1, 1)) for name in names},
        np.ones(len(POINTS), dtype=bool),
        ties,
        {},
    )


def test_a_click_far_from_the_answer_is_never_passed_over():
    places = scene_poses(3)
    observations = changed(
        clicks_on(places),
        lambda c: (c.scene, c.keypoint) == ("01", 4),
        lambda c: replace(c, v_px=c.v_px + 40),
    )
    clicks, placed = [o.click for o in observations], placed_at(places, observations, {})
    (said,) = left_out(clicks, placed, [], NAMES)
    assert (said.kind, [(c.scene, c.keypoint) for c in said.clicks]) == ("disagree", [("01", 4)])
    assert "keypoint e was clicked" in said.text and not said.blames
    assert not list(left_out(clicks, placed, [said], NAMES))  # once is enough


def test_a_scene_that_could_stand_elsewhere_is_said_once():
    places = scene_poses(3)
    observations = clicks_on(places)
    placed = placed_at(places, observations, {"01": "scene 01: it could stand elsewhere"})
    placed.covariance_in_scene["01"][:] *= 100
    (said,) = about_faults(diagnose(observations, NAMES, placed).statements)
    assert (said.kind, said.text) == ("weak scene", "scene 01: it could stand elsewhere")


def test_the_linearised_fall_is_that_of_fitting_again():
    """Cook and Weisberg's formula against an actual fit without the click."""
    places = scene_poses(3)
    observations = clicks_on(places, noise_px=1.0)
    all_rays = rays_of(observations, sorted(places))
    reading = read_as_named(all_rays)
    fit = refit(all_rays, reading, np.stack(list(places.values())), POINTS, most_steps=60)
    (fall,) = costs_without(fit, [np.array([5])])
    unused = np.arange(len(observations)) != 5
    without = refit(
        all_rays, reading._replace(ray_used=unused, depth_used=unused), fit.scene_from_model, fit.points_model
    )
    own_depth = float(fit.residuals[5, 2] ** 2)
    assert fit.cost - without.cost == pytest.approx(fall + own_depth, abs=0.3)


def test_more_clicks_need_more_evidence():
    """One in a hundred recordings may be accused wrongly, however many clicks it has."""
    assert np.exp(-contradiction(26) / 2) * 26 == pytest.approx(0.01)
    assert contradiction(150) > contradiction(26)
