"""A printed box found on a table by shape and print; refused where another one stands there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, invert, rotation_angle_rad, transform
from rpl_data.meshes import joined, select
from rpl_data.place.decide import click_to_ask, decide, off_px
from rpl_data.place.place import candidates_in
from rpl_data.place.shape import orientations
from rpl_data.place.things import things_on_support, windows
from rpl_data.place.verify import Candidate
from rpl_data.types import Click, Intrinsics, KeypointModel, Observation, PointCloud, Trajectory

SIZE_M = np.array([0.05, 0.08, 0.06])
CAMERA = np.array([[0.3, -0.4, 0.5], [-0.3, -0.4, 0.5]])
TRUE = from_rotvec(np.array([0, 0, 0.7]), np.array([0.02, 0.01, SIZE_M[2] / 2]))
"""The box stands on the table z = 0 of the scene."""


def box(*, seed: int = 0) -> PointCloud:
    """A box about the origin, with a coloured print of waves of 1 to 3 cm on its faces."""
    rng = np.random.default_rng(seed)
    points, normals = [], []
    for axis in range(3):
        for side in (-1, 1):
            face = np.mgrid[-0.5:0.5:0.04, -0.5:0.5:0.04].reshape(2, -1).T
            face = np.insert(face, axis, 0.5 * side, axis=1) * SIZE_M
            points.append(face)
            normals.append(np.tile(side * np.eye(3)[axis], (len(face), 1)))
    at = np.concatenate(points)
    waves = []
    for _ in range(3):
        directions = rng.normal(size=(8, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.01, 0.03, (8, 1))
        waves.append(np.cos(2 * np.pi * at @ directions.T + rng.uniform(0, 6, 8)).sum(axis=1))
    colors = (128 + 25 * np.column_stack(waves)).clip(0, 255).astype(np.uint8)
    return PointCloud(at, np.concatenate(normals), colors)


def on_table(thing: PointCloud) -> PointCloud:
    """A table with a thing on it, of which the cameras see what faces them."""
    standing = PointCloud(transform(TRUE, thing.points), thing.normals @ TRUE[:3, :3].T, thing.colors)
    to_camera = CAMERA[:, None] - standing.points
    faced = ((to_camera * standing.normals).sum(axis=2) > 0).any(axis=0)
    ground = np.mgrid[-0.2:0.2:0.005, -0.2:0.2:0.005].reshape(2, -1).T
    table = np.column_stack([ground, np.zeros(len(ground))])
    grey = np.full(table.shape, 90, np.uint8)
    return joined([PointCloud(table, np.tile([0.0, 0, 1], (len(table), 1)), grey), select(standing, faced)])


def test_a_box_is_found_and_its_print_tells_how_it_stands() -> None:
    found = candidates_in(box(), on_table(box()), CAMERA, ())
    decision = decide(found)
    assert decision.sure, decision.words
    off = invert(TRUE) @ found[0].scene_from_object
    assert np.linalg.norm(off[:3, 3]) < 0.002
    assert np.degrees(rotation_angle_rad(off[:3, :3])) < 1.5


def test_a_box_with_another_print_is_refused() -> None:
    decision = decide(candidates_in(box(), on_table(box(seed=1)), CAMERA, ()))
    assert not decision.sure


def test_an_empty_table_has_no_candidates() -> None:
    empty = select(on_table(box()), np.arange(6400))
    assert candidates_in(box(), empty, CAMERA, ()) == []


def test_things_that_touch_are_looked_at_in_windows() -> None:
    row = joined([replace(box(), points=box().points + [0.08 * n, 0, 0.04]) for n in range(3)])
    table = select(on_table(box()), np.arange(6400))
    things = things_on_support(joined([table, row]), CAMERA)
    assert things is not None and things.plane.normal[2] > 0.999
    assert all(np.ptp(part.points, axis=0).max() < 0.12 for part in windows(things.clouds[0], 0.11))


def test_orientations_leave_no_gap() -> None:
    some = orientations(700)
    for turn in ([3.0, 0.0, 0.1], [0.0, 1.0, 2.0], [0.1, 0.1, 0.1]):
        rotation = from_rotvec(np.array(turn), np.zeros(3))[:3, :3]
        nearest = min(rotation_angle_rad(rotation.T @ one) for one in some)
        assert np.degrees(nearest) < 25


# What is believed -----------------------------------------------------------------------------------


def candidate(likeness: float, *, pose: np.ndarray = TRUE, free: float = 0.0, seen: float = 0.4) -> Candidate:
    return Candidate(0, pose, 1.0, free, seen, likeness, np.eye(6))


@pytest.mark.parametrize(
    ("candidates", "sure", "said"),
    [
        ([candidate(0.6)], True, "score 0.60"),
        ([candidate(0.3)], False, "not good enough"),
        ([candidate(0.6, free=0.04)], False, "not good enough"),
        ([candidate(0.6, seen=0.1)], False, "not good enough"),
        ([candidate(0.6), candidate(0.55)], False, "nearly as good"),
        ([], False, "no pose"),
    ],
)
def test_only_a_clear_answer_is_believed(candidates: list[Candidate], sure: bool, said: str) -> None:
    decision = decide(candidates)
    assert (decision.sure, said in decision.words) == (sure, True)


def test_the_click_asked_for_tells_two_poses_apart() -> None:
    camera = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
    down = from_rotvec(np.array([np.pi, 0, 0]), np.array([0.0, 0, 0.6]))  # above the table, looking down
    points = np.array([[0.0, 0, 0.03], [0.025, 0, 0.03], [0.0, 0.04, 0.03], [0, 0, -0.03]])
    model = KeypointModel("box", ("middle", "near", "far", "below"), points)
    turned = TRUE @ from_rotvec(np.array([0, 0, np.pi]), np.zeros(3))
    rivals = [candidate(0.6), candidate(0.6, pose=turned)]
    path = Trajectory(np.array([4]), down[None])
    ask = click_to_ask(rivals, model, box(), camera, path)
    # 40 mm from the axis on either side are 80 mm apart, 0.54 m below the camera.
    assert ask is not None and (ask.frame, ask.keypoint) == (4, 2)
    assert ask.apart_px == pytest.approx(600 * 0.08 / 0.54)
    point = transform(invert(down) @ TRUE, points[2:3])[0]
    click = Observation(
        Click("box", 2, "00", 4, 0.0, 0.0), point / point[2], down, np.empty(0), np.empty(0), 1 / 600
    )
    assert off_px(TRUE, model, click) == pytest.approx(0, abs=1e-6)
    assert off_px(turned, model, click) == pytest.approx(ask.apart_px)
