"""Single frames corrected by what is printed on the object, on a cube drawn with a known print."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, invert, project, transform
from rpl_data.label.alone import Body, ObjectAlone, SceneObject, object_alone
from rpl_data.label.frame_correction import FrameCorrector, frame_corrector
from rpl_data.label.label import label_frames
from rpl_data.label.occlusion import FAR_M
from rpl_data.label.prints import MOST_POINTS, look_at, print_of
from rpl_data.raycast import PixelTable
from rpl_data.types import Frame, FrameLabel, Intrinsics, KeypointModel, Mesh, Scene, Trajectory

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
OFF = from_rotvec(np.array([0.0, 0.01, 0.0]), np.array([0.004, 0.0, 0.0]))
"""A turn about the camera and a shift: each moves what is 0.4 m away by 4 mm, which is 3 px."""
SLIGHTLY_OFF = from_rotvec(np.zeros(3), np.array([0.002, 0.0, 0.0]))  # 1.5 px


def brightness(points_object: np.ndarray, *, contrast: float = 1.0) -> np.ndarray:
    """The print on the cube: a sum of waves."""
    return 120 + contrast * 18 * np.sin(points_object @ WAVES.T).sum(axis=-1)


class Filmed:
    """A camera that stands still before a cube; the path that is given has faults."""

    def __init__(self, faults: dict[int, np.ndarray], *, number: int = 6, contrast: float = 1.0) -> None:
        self.frames = tuple(Frame(i, i / 30, Path("c.png"), Path("d.png")) for i in range(number))
        self.scene = Scene("s", CAMERA, 0.001, self.frames)
        poses = [invert(faults.get(i, np.eye(4)) @ TRUE) for i in range(number)]
        self.trajectory = Trajectory(np.arange(number), np.array(poses))
        camera = PixelTable.of(CAMERA)
        alone = object_alone(camera, Body.of(CUBE), TRUE)
        assert alone is not None
        self.depth_m = np.zeros((240, 320), np.float32)
        self.depth_m[alone.window] = np.where(alone.depth_m < FAR_M, alone.depth_m, 0)
        points = transform(invert(TRUE), camera.directions.astype(float) * self.depth_m[..., None])
        shown = brightness(points, contrast=contrast)
        self.grey = np.where(self.depth_m > 0, shown, 40).clip(0, 255).astype(np.uint8)
        self.other_grey: dict[int, np.ndarray] = {}

    def image(self, frame: Frame) -> np.ndarray:
        """The brightness of a frame."""
        return self.other_grey.get(frame.index, self.grey)

    def corrector(self, *, unproven: bool = False) -> FrameCorrector:
        """Prepared for all frames."""
        depth = lambda frame: self.depth_m  # noqa: E731
        return frame_corrector(
            self.scene, self.trajectory, [CUBE], self.frames, depth, self.image, unproven=unproven
        )

    def labels(self, *, unproven: bool = False) -> list[FrameLabel]:
        """All frames, labelled and corrected."""
        found = label_frames(
            self.scene,
            self.trajectory,
            [CUBE],
            self.frames,
            lambda frame: self.depth_m,
            read_grey=self.image,
            corrector=self.corrector(unproven=unproven),
        )
        return list(found)


def errors_px(labels: list[FrameLabel]) -> list[float]:
    """Mean error of each label."""
    true_px = project(CAMERA, transform(TRUE, CORNERS))
    return [float(np.linalg.norm(x.instances[0].keypoints_px - true_px, axis=1).mean()) for x in labels]


def test_a_fault_of_one_frame_is_undone_and_the_others_stay() -> None:
    labels = Filmed({3: OFF}).labels()
    errors = errors_px(labels)
    assert errors[3] < 0.3
    assert max(errors[:3] + errors[4:]) < 1e-6
    moved = [label.instances[0].corrected_px for label in labels]
    assert moved[3] == pytest.approx(6.0, abs=0.5)
    assert [one for number, one in enumerate(moved) if number != 3] == [None] * 5


def test_a_reference_stands_where_its_neighbours_see_it() -> None:
    film = Filmed({0: SLIGHTLY_OFF})
    film.frames = (replace(film.frames[0], timestamp_s=-5.0), *film.frames[1:])
    film.scene = replace(film.scene, frames=film.frames)  # before a gap: its speed is unknown, taken for 0
    assert film.corrector().references["cube", ""][0].frame == 0
    assert max(errors_px(film.labels())) < 0.3


def test_another_print_moves_nothing() -> None:
    film = Filmed({3: OFF})
    film.other_grey[3] = film.grey[::-1, ::-1].copy()
    assert film.labels()[3].instances[0].corrected_px is None


def test_an_object_without_a_print_is_not_corrected() -> None:
    labels = Filmed({3: OFF}, contrast=0.0).labels()
    assert [label.instances[0].corrected_px for label in labels] == [None] * 6


def test_small_corrections_are_left_unless_all_are_wanted() -> None:
    small = from_rotvec(np.zeros(3), np.array([0.0004, 0.0, 0.0]))  # 0.3 px
    film = Filmed({3: small})
    assert film.labels()[3].instances[0].corrected_px is None
    assert film.labels(unproven=True)[3].instances[0].corrected_px == pytest.approx(0.3, abs=0.1)


def test_a_print_of_a_large_object_is_read_and_one_of_a_thin_object_is_empty() -> None:
    rows, columns = 200, 200
    camera = PixelTable.of(CAMERA)
    grey = np.random.default_rng(0).integers(0, 255, (240, 320)).astype(np.uint8)
    window = np.s_[10 : 10 + rows, 20 : 20 + columns]
    depth_m = np.full((rows, columns), 0.4, np.float32)
    everywhere = np.ones((rows, columns), dtype=bool)
    alone = ObjectAlone(Body.of(CUBE), np.eye(4), np.zeros((8, 2)), window, depth_m, everywhere)
    look = look_at(grey, alone, everywhere)
    v, u = (grid.ravel() for grid in np.mgrid[10 : 10 + rows, 20 : 20 + columns])
    read = look.at(look.levels[0][0], np.column_stack([u, v]).astype(float))
    np.testing.assert_allclose(read, look.levels[0][0][v - look.corner[1], u - look.corner[0]], atol=1e-3)
    assert len(print_of(camera, look, everywhere, np.eye(4)).points) == MOST_POINTS
    thin = everywhere & (np.arange(columns) < 5)
    assert len(print_of(camera, look, thin, np.eye(4)).points) == 0
