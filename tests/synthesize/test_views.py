"""From which sides objects are shown, and where they stand."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from cube_studio import CAMERA, CORNERS, HALF_M, cube_body, cube_studio

from rpl_data.directions import COMPARED, spread_directions
from rpl_data.geometry import transform
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.arrange import arrange, draw_pose
from rpl_data.synthesize.storage import load_studio
from rpl_data.synthesize.views import is_shown, looking, shown_directions, standing, view_weights

UNIT = np.array([0.36, 0.48, 0.8])


def test_an_object_shows_the_side_that_was_asked_for_upright() -> None:
    ray, up = np.array([0.1, -0.2, 1.0]), np.array([0.0, 0.0, 1.0])
    rotation = looking(UNIT, up, ray, 0.0)
    np.testing.assert_allclose(rotation @ UNIT, -ray / np.linalg.norm(ray), atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) > 0 and (rotation @ up)[1] < 0  # y points down
    turned = looking(UNIT, up, ray, 1.1)
    np.testing.assert_allclose(turned @ UNIT, rotation @ UNIT, atol=1e-12)
    assert np.arccos((np.trace(turned.T @ rotation) - 1) / 2) == pytest.approx(1.1)


def test_an_object_that_stands_keeps_its_upper_side() -> None:
    up = np.array([0.0, -0.6, -0.8])
    for turn in (0.0, 2.0):
        np.testing.assert_allclose(standing(UNIT, up, turn) @ UNIT, up, atol=1e-9)


def test_no_direction_shows_what_no_camera_saw() -> None:
    shown = shown_directions(cube_body(unseen=(4,)))  # the face towards -z
    directions = spread_directions(COMPARED)
    assert shown[directions[:, 2] > 0.1].all() and not shown[directions[:, 2] < -0.2].any()
    assert is_shown(np.array([0.0, 0, 1]), shown) and not is_shown(np.array([0.0, 0, -1]), shown)


def test_sides_that_the_recordings_lack_are_likelier() -> None:
    weights = view_weights(np.array([[0.0, 0, 1]]), np.ones(COMPARED, bool))
    directions = spread_directions(COMPARED)
    assert weights.sum() == pytest.approx(1)
    near, far = weights[directions[:, 2] > 0.99].mean(), weights[directions[:, 2] < 0.5].mean()
    assert far > 3 * near
    assert not view_weights(np.array([[0.0, 0, 1]]), np.zeros(COMPARED, bool)).any()


def test_objects_stand_on_the_table_at_recorded_distances(tmp_path: Path) -> None:
    studio = cube_studio(tmp_path / "studio")
    (plate,), subject, rng = studio.plates, studio.subjects["cube"], np.random.default_rng(0)
    poses = [pose for _ in range(40) if (pose := draw_pose(studio, subject, plate, rng)) is not None]
    assert len(poses) > 20
    for pose in poses:
        height = transform(pose, CORNERS) @ plate.table.normal - plate.table.offset_m
        assert height.min() == pytest.approx(0, abs=1e-9)
        assert 0.85 * 0.4 <= np.linalg.norm(pose[:3, 3]) <= 1.2 * 0.6


def test_objects_of_an_image_do_not_stand_in_one_another(tmp_path: Path) -> None:
    studio = cube_studio(tmp_path / "studio")
    found = arrange(
        studio, studio.plates[0], PixelTable.of(CAMERA), ["cube"] * 4, np.random.default_rng(1), Counter()
    )
    middles = [placed.camera_from_object[:3, 3] for _, placed, _ in found]
    assert found and all(seen.unseen == 0 for *_, seen in found)
    for number, one in enumerate(middles):
        assert all(np.linalg.norm(one - other) > np.sqrt(3) * HALF_M for other in middles[:number])


def test_a_studio_is_read_as_it_was_written(tmp_path: Path) -> None:
    studio, again = cube_studio(tmp_path / "studio"), load_studio(tmp_path / "studio")
    one, other = studio.subjects["cube"], again.subjects["cube"]
    for name in vars(one.body.painted):
        np.testing.assert_array_equal(getattr(one.body.painted, name), getattr(other.body.painted, name))
    np.testing.assert_array_equal(one.shown, other.shown)
    assert (one.keypoints, one.symmetries) == (other.keypoints, other.symmetries)
    plate, read = studio.plates[0], again.plates[0]
    assert (plate.color, plate.camera, plate.scene) == (read.color, read.camera, read.scene)
    np.testing.assert_array_equal(plate.table.normal, read.table.normal)
    assert (studio.scenes, studio.noise) == (again.scenes, again.noise)
