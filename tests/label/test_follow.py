"""An object that is moved, followed on its own surface: a cube drawn with a known print."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, invert, rotation_angle_rad, transform
from rpl_data.label.alone import Body, SceneObject, object_alone
from rpl_data.label.follow import Followed, follow
from rpl_data.label.label import label_frames
from rpl_data.label.occlusion import FAR_M
from rpl_data.raycast import PixelTable
from rpl_data.types import Frame, Intrinsics, KeypointModel, Mesh, Scene, Trajectory

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float) * 0.05
FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
TRIANGLES = np.array([t for a, b, c, d in FACES for t in ([a, b, c], [a, c, d])], dtype=np.int64)
WAVES = np.random.default_rng(3).normal(size=(12, 3)) * 150
CUBE = SceneObject(
    KeypointModel("cube", tuple("01234567"), CORNERS),
    np.tile(np.eye(3) * 1e-6, (8, 1, 1)),
    Mesh(CORNERS, TRIANGLES),
    np.eye(4),
)
TRUE = from_rotvec(np.array([0.5, 0.6, 0.1]), np.array([0.0, 0.0, 0.4]))
FRAMES = tuple(Frame(i, i / 10, Path("c.png"), Path("d.png")) for i in range(5))
POSES = [
    TRUE @ from_rotvec(k * np.array([0.02, -0.05, 0.03]), np.array([0.008, 0.004, 0]) * k) for k in range(5)
]
CLICKED = from_rotvec(np.array([0.0, 0.01, 0.01]), np.array([0.003, -0.002, 0.004]))
"""By how much clicks are off."""
TABLE_M = 0.6


class Filmed:
    """A camera that stands still before a table and a cube that is moved; nothing else is there."""

    def __init__(self) -> None:
        self.table = PixelTable.of(CAMERA)
        self.body = Body.of(CUBE)
        self.images = [self.drawn(pose) for pose in POSES]

    def drawn(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth and brightness with the cube at a pose."""
        alone = object_alone(self.table, self.body, pose)
        assert alone is not None
        depth_m = np.full((CAMERA.height, CAMERA.width), TABLE_M, np.float32)
        depth_m[alone.window] = np.where(alone.depth_m < FAR_M, alone.depth_m, TABLE_M)
        points = transform(invert(pose), self.table.directions.astype(float) * depth_m[..., None])
        shown = 120 + 18 * np.sin(points @ WAVES.T).sum(axis=-1)
        grey = np.where(depth_m < TABLE_M, shown, 40).clip(0, 255).astype(np.uint8)
        return depth_m, grey

    def followed(self, *clicked: int) -> Followed:
        """Followed from clicked frames."""
        return follow(
            self.table,
            self.body,
            FRAMES,
            {frame: CLICKED @ POSES[frame] for frame in clicked},
            lambda frame: self.images[frame.index][0],
            lambda frame: self.images[frame.index][1],
        )


def off(found: Followed, frame: int) -> tuple[float, float]:
    """Millimetres and degrees between a found pose and the true one."""
    error = invert(POSES[frame]) @ found.camera_from_object[frame]
    return 1e3 * float(np.linalg.norm(error[:3, 3])), float(np.rad2deg(rotation_angle_rad(error[:3, :3])))


def test_a_moved_object_is_followed_both_ways_from_one_clicked_frame() -> None:
    found = Filmed().followed(2)
    assert found.lost == {} and found.camera_from_object.keys() == set(range(5))
    for frame in range(5):
        millimetres, degrees = off(found, frame)
        assert millimetres < 1.0 and degrees < 0.5


def test_a_hand_before_half_of_it_does_not_draw_it_away() -> None:
    film = Filmed()
    depth_m, grey = film.images[1]
    depth_m[:, :150], grey[:, :150] = 0.25, 200
    found = film.followed(0)
    millimetres, degrees = off(found, 1)
    assert found.lost == {} and millimetres < 1.0 and degrees < 0.5


def test_where_it_is_not_seen_it_is_lost_and_found_again() -> None:
    film = Filmed()
    film.images[2] = (np.full_like(film.images[2][0], TABLE_M), film.images[2][1])
    found = film.followed(0)
    assert found.lost == {2: "depth does not show the object's shape where it should be"}
    assert max(off(found, frame)[0] for frame in (3, 4)) < 1.0


def test_a_wrong_click_follows_nothing() -> None:
    film = Filmed()
    film.images = [(np.full_like(depth, TABLE_M), grey) for depth, grey in film.images]
    found = film.followed(1, 4)
    assert not found.camera_from_object and found.lost.keys() == set(range(5))
    assert found.lost[3] == "the object was found in no clicked frame"


@pytest.mark.parametrize("moved", [False, True])
def test_a_path_of_its_own_labels_as_a_path_of_the_camera_does(moved: bool) -> None:
    film, scene = Filmed(), Scene("s", CAMERA, 0.001, FRAMES)
    still = Trajectory(np.arange(5), np.array([invert(POSES[0])] * 5))
    path = Trajectory(np.arange(5), np.array([invert(pose) for pose in POSES]))
    item = replace(CUBE, path=path) if moved else CUBE
    labels = label_frames(
        scene, still if moved else path, [item], FRAMES, lambda frame: film.images[frame.index][0]
    )
    for label, pose in zip(labels, POSES, strict=True):
        (found,) = label.instances
        np.testing.assert_allclose(found.camera_from_object, pose, atol=1e-12)
        assert found.visib_fract == 1.0 and found.quality > 0.5
