"""Scenes placed by `rpl register` follow their model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from clicked_scenes import CUBE, NAMES, cameras, click_scene, pose

from rpl_data.clicks.log import Annotation, click_event, keypoints_event
from rpl_data.geometry import from_rotvec, invert, transform
from rpl_data.pipeline.context import path_key
from rpl_data.pipeline.placements import (
    after_alignment,
    fallen,
    fallen_lines,
    standing,
    thin_instances,
    thin_lines,
    with_placements,
)
from rpl_data.pipeline.register import alone_in
from rpl_data.pipeline.stages.solve import place_known
from rpl_data.solve.joint import joint_clicks
from rpl_data.solve.register import register_scene
from rpl_data.types import (
    Click,
    ClickResidual,
    Frame,
    Intrinsics,
    KeypointModel,
    NextClick,
    Observation,
    Placement,
    Recording,
    Scene,
    Solution,
    Statement,
    Trajectory,
)
from rpl_data.workspace.workspace import Workspace

POINTS = np.array([[0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.07], [np.nan] * 3])
POSE = from_rotvec(np.array([0.4, -1.0, 0.3]), np.array([0.2, -0.1, 0.5]))
CLICK = ClickResidual(Click("egg", 1, "07", 3, 10.0, 20.0), 1.0, None, None, "none")
SAID = Statement("wrong place", (CLICK.click,), "keypoint b is off")
PLACED = Placement(
    POSE, POINTS, np.tile(1e-6 * np.eye(3), (4, 1, 1)), (CLICK,), "aligned", "its print", "path"
)
SPREADS = np.array([1, 9, 4, np.nan])[:, None, None] * 1e-6 * np.eye(3)
STILL = np.tile(np.eye(4), (3, 1, 1))
SOLUTION = Solution(
    KeypointModel("egg", ("a", "b", "c", "d"), POINTS), np.zeros((4, 3, 3)), {"00": np.eye(4)}
)


def test_a_placement_follows_the_keypoints_into_another_frame() -> None:
    other = from_rotvec(np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02, -0.03]))
    model = replace(SOLUTION.model, points_object=transform(other, POINTS))
    found = with_placements(replace(SOLUTION, model=model), {"07": PLACED})
    np.testing.assert_allclose(found.scene_from_object["07"], POSE @ invert(other), atol=1e-12)
    assert set(found.covariance_in_scene) == {"07"} and found.residuals == (CLICK,)


def test_a_placed_scene_keeps_what_is_known_of_it_and_says_it_once() -> None:
    known = replace(SOLUTION.model, points_object=np.vstack([POINTS[:3], [[0, 0, 0.01]]]))
    placed = replace(PLACED, trajectory_sigma_m=0.004, statements=(SAID,), covariance_in_scene=SPREADS)
    once = with_placements(replace(SOLUTION, model=known), {"07": placed})
    twice = with_placements(once, {"07": placed})
    for found in (once, twice):
        assert found.trajectory_sigma_m == {"07": 0.004} and found.statements == (SAID,)
    spreads = once.covariance_in_scene["07"]
    np.testing.assert_array_equal(spreads[:3], SPREADS[:3])
    np.testing.assert_array_equal(spreads[3], SPREADS[1])  # first known afterwards: as the least known


def test_a_warning_of_a_lost_placement_goes_when_it_is_placed_again() -> None:
    other = replace(SOLUTION, model=replace(SOLUTION.model, points_object=1.3 * POINTS))
    lost = with_placements(with_placements(other, {"07": PLACED}), {"07": PLACED})
    assert len(lost.warnings) == 1
    again = with_placements(lost, {"07": replace(PLACED, points_object=1.3 * POINTS)})
    assert again.warnings == () and "07" in again.scene_from_object


def at_work(root: Path, *clicks: Click, path: np.ndarray = STILL) -> Workspace:
    """A workspace with a placed scene, 07, whose poses and clicks are these."""
    workspace = Workspace(root)
    frames = tuple(Frame(n, n / 30, root / "c.png", None) for n in range(4))
    scene = Scene("07", Intrinsics(500.0, 500.0, 320.0, 240.0, 640, 480), 0.001, frames)
    trajectory = Trajectory(np.arange(3), path)  # frame 3 has no pose
    workspace.save_recording(Recording(scene, trajectory))
    workspace.append_events("egg", [keypoints_event(tuple("abcd")), *map(click_event, clicks)])
    key = path_key(Trajectory(np.arange(3), STILL))
    workspace.save_placements("egg", {"07": replace(PLACED, path_key=key)})
    return workspace


def test_a_placement_holds_with_its_clicks_and_poses_only(tmp_path: Path) -> None:
    own = replace(CLICK.click, frame=2)
    placed = replace(CLICK, click=own)
    no_pose, unknown = replace(own, frame=3), replace(own, keypoint=3)
    cases = {
        "same": ((own,), STILL, True),
        "and clicks that count for nothing": ((own, no_pose, unknown), STILL, True),
        "another click": ((own, replace(own, keypoint=0)), STILL, False),
        "moved": ((own,), STILL + 0.001 * np.eye(4, k=3), False),
    }
    for name, (clicks, path, holds) in cases.items():
        workspace = at_work(tmp_path / name, *clicks, path=path)
        (one,) = workspace.load_placements("egg").values()
        workspace.save_placements("egg", {"07": replace(one, residuals=(placed,))})
        assert (set(standing(workspace, "egg")) == {"07"}) is holds, name
        assert (fallen(workspace, "egg") == []) is holds
        assert len(fallen_lines(workspace, "egg")) == (0 if holds else 1)


def test_what_its_clicks_alone_leave_open_is_not_said_of_an_aligned_scene() -> None:
    badly = Statement("weak scene", (CLICK.click,), "scene 07: its clicks place the object badly")
    by_clicks = replace(
        PLACED,
        how="clicks",
        trajectory_sigma_m=0.002,
        statements=(SAID, badly),
        next_clicks=(NextClick("07", 3, 2, 4.0, 8.0),),
    )
    aligned = after_alignment(by_clicks, np.eye(4), PLACED.covariance_in_scene, (), "its print")
    assert (aligned.statements, aligned.next_clicks, aligned.how) == ((SAID,), (), "aligned")
    np.testing.assert_allclose(aligned.covariance_in_scene, np.tile(5e-6 * np.eye(3), (4, 1, 1)))


def test_clicks_of_a_scene_that_is_aligned_say_no_more_than_its_straying_path_lets_them() -> None:
    random = np.random.default_rng(1)
    observations = click_scene("07", CUBE, pose(random), cameras(2), random, noise_px=1.0)
    model = KeypointModel("cube", NAMES, CUBE)
    clicked = register_scene(model, observations, trajectory_sigma_m=0.005)
    whole = Solution(model, np.zeros((8, 3, 3)), {"00": np.eye(4)}, click_sigma_px=1.0, depth_sigma_ratio=1.0)
    clicks = joint_clicks(alone_in(whole, "07", clicked), observations, hold_points=True)
    assert (clicks.rays.strayed_m == 0.005).all()


def test_a_given_model_is_known_as_well_as_its_clicks_lie_on_it() -> None:
    """Root mean square distance in space, of which each axis has a third of the square."""
    random = np.random.default_rng(1)
    observations = click_scene(
        "00", CUBE, pose(random), cameras(3), random, depths=lambda k, f, z: [z + random.normal(0, 0.004)]
    )
    given = Annotation("cube", NAMES, (), known_points=tuple((x, y, z) for x, y, z in CUBE.tolist()))
    found = place_known(given, observations)
    errors_m = [residual.error_m for residual in found.residuals if residual.error_m is not None]
    off_m = np.sqrt(np.mean(np.square(errors_m)))
    assert len(errors_m) == 24 and 0.003 < off_m < 0.005
    np.testing.assert_allclose(np.sqrt(np.trace(found.covariance, axis1=1, axis2=2)), off_m)


def test_of_another_model_nothing_is_kept() -> None:
    model = replace(SOLUTION.model, points_object=1.3 * POINTS)
    found = with_placements(replace(SOLUTION, model=model), {"07": PLACED})
    assert set(found.scene_from_object) == {"00"}
    assert "scene 07 is not placed any more" in found.warnings[0]


def test_placements_survive_the_disk(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    assert workspace.load_placements("egg") == {}
    workspace.save_placements("egg", {"07": replace(PLACED, statements=(SAID,))})
    (again,) = workspace.load_placements("egg").values()
    np.testing.assert_array_equal(again.points_object, POINTS)
    np.testing.assert_allclose(again.scene_from_object, POSE)
    assert (again.residuals, again.how, again.checked) == ((CLICK,), "aligned", "its print")
    assert (again.path_key, again.statements) == ("path", (SAID,))


def clicked(place: str, *keypoints: int) -> list[Observation]:
    ray, depth = np.array([0, 0, 1.0]), np.array([0.5])
    made = [Click("egg", keypoint, place, 3, 10.0, 20.0) for keypoint in keypoints]
    return [Observation(each, ray, np.eye(4), depth, 0.01 * depth, 0.002) for each in made]


def test_an_instance_with_too_few_clicks_waits_and_the_rest_goes_on() -> None:
    rest = clicked("00", 0, 1, 2, 3) + clicked(
        "01", 0, 1
    )  # few clicks in a scene itself are refused elsewhere
    assert thin_instances(rest + clicked("00/2", 0, 1, 2)) == {}
    assert thin_instances(rest + clicked("00/2", 0) + clicked("02/@7", 1, 1)) == {"00/2": 1, "02/@7": 1}
    (line,) = thin_lines(rest + clicked("00/2", 0))
    assert line.startswith("scene 00/2: 1 keypoint of this instance is clicked that other places show too")
    assert thin_instances(clicked("00/2", 0, 1)) == {}  # nothing else would be left
