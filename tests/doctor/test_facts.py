"""What the doctor says of depth units, bits, rays, tags and times, on the smallest input that shows it."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_floor import CAMERA, pose, shoot
from PIL import Image

from rpl_data.doctor.consistency import ComparedImages, Geometry, choose_pairs
from rpl_data.doctor.corrections import faults, usual_factor
from rpl_data.doctor.depth_unit import by_the_numbers, with_turned_bits
from rpl_data.doctor.examine import _after_mending
from rpl_data.doctor.findings import Diagnosis, Finding
from rpl_data.doctor.tags import orientation_tags
from rpl_data.doctor.text import describe
from rpl_data.doctor.timing import odd_times, pose_jumps
from rpl_data.geometry import rays
from rpl_data.recordings.mend import Mend
from rpl_data.types import Frame, Intrinsics, Scene, Trajectory

POSES = np.array([pose(n) for n in range(0, 24, 2)])
SCENE = Scene("00", CAMERA, 0.001, tuple(Frame(n, n / 30, Path(f"{n}.png"), None) for n in range(12)))


@pytest.fixture(scope="module")
def depths_mm() -> np.ndarray:
    return np.array([np.rint(shoot(at)[1] * 1000) for at in POSES])


def compared(depths_mm: np.ndarray) -> ComparedImages:
    depths_m = (depths_mm * 0.001).astype(np.float32)
    return choose_pairs(depths_m, [(0, len(depths_m))], most_pairs=14)


def judged(depths_mm: np.ndarray, camera: Intrinsics = CAMERA) -> list[Finding]:
    return faults(compared(depths_mm), Geometry(camera, POSES), most=1)[0]


def test_depth_along_the_ray_is_no_other_focal_length(depths_mm: np.ndarray) -> None:
    """Far from the axis the ray is 20 % longer than the depth: the nearest focal length explains little."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    lengths = np.linalg.norm(rays(CAMERA, np.column_stack([u.ravel(), v.ravel()]).astype(float)), axis=1)
    (found,) = judged(np.rint(depths_mm * lengths.reshape(u.shape)))
    assert (found.kind, found.mend) == ("ray length", Mend(depth_along_ray=True))
    assert "mend: {depth_along_ray: true}" in found.todo and found.sure >= 0.9


def test_a_wrong_focal_length_is_not_taken_for_rays(depths_mm: np.ndarray) -> None:
    (found,) = judged(depths_mm, replace(CAMERA, fx=375.0, fy=375.0))
    assert found.kind == "intrinsics"


@pytest.mark.parametrize("factor", [4.0, 5.0, 10.0])
def test_the_unit_by_the_poses_has_its_remedy(depths_mm: np.ndarray, factor: float) -> None:
    (found,) = judged(depths_mm * factor)
    assert (found.kind, found.mend) == ("depth scale", Mend(depth_factor=1 / factor))


def test_a_scale_that_no_unit_of_depth_explains_may_be_that_of_the_poses(depths_mm: np.ndarray) -> None:
    """As of COLMAP's poses: 2.7 times the world, and between the steps of a coarse search."""
    (found,), _ = faults(compared(depths_mm / 2.7), Geometry(CAMERA, POSES))
    assert (found.kind, found.mend) == ("depth scale", None) and found.sure >= 0.9
    assert "mend: {pose_factor: 0.36" in found.todo and "mend: {depth_factor: 2.7" in found.todo


def turned(depths_mm: np.ndarray) -> np.ndarray:
    units = depths_mm.astype(np.uint16)
    return ((units << 3) | (units >> 13)).astype(float)


def test_turned_bits_by_the_poses(depths_mm: np.ndarray) -> None:
    stored = turned(depths_mm)
    found = with_turned_bits(SCENE, (stored * 0.001).astype(np.float32), judged(stored))
    assert [(one.kind, one.mend) for one in found] == [("turned bits", Mend(depth_bits_turned=True))]
    others = judged(depths_mm * 8 + 1)
    assert with_turned_bits(SCENE, ((depths_mm * 8 + 1) * 0.001).astype(np.float32), others) == others


def numbers(depths_mm: np.ndarray, unit_m: float = 0.001) -> list[Finding]:
    return by_the_numbers(replace(SCENE, metres_per_unit=unit_m), (depths_mm * unit_m).astype(np.float32))


def test_turned_bits_by_the_numbers_alone(depths_mm: np.ndarray) -> None:
    (found,) = numbers(turned(depths_mm))
    assert (found.kind, found.mend) == ("turned bits", Mend(depth_bits_turned=True))
    assert "100% of the depths are multiples of 8" in found.what
    assert numbers(turned(depths_mm), 0.000125) == []  # in eighths of a millimetre that is what it should be


def test_distances_that_suit_a_table_are_believed(depths_mm: np.ndarray) -> None:
    assert numbers(depths_mm) == numbers(depths_mm * 5, 0.0002) == numbers(0 * depths_mm) == []


@pytest.mark.parametrize(
    ("stored", "unit_m", "factor"), [(5, 0.001, 0.2), (10, 0.001, 0.1), (16, 0.0005, 1 / 8), (1, 0.0002, 5.0)]
)
def test_distances_that_suit_no_table_are_a_warning(
    depths_mm: np.ndarray, stored: int, unit_m: float, factor: float
) -> None:
    """Multiples of 5 are millimetres in TUM's 1/5000 m; of 16, millimetres in the upper 12 of 16 bits."""
    (found,) = numbers(depths_mm * stored, unit_m)
    assert (found.kind, found.mend) == ("depth scale", Mend(depth_factor=factor))
    assert found.sure < 0.9 and "nothing else to judge the unit by" in found.what


def test_a_factor_near_a_usual_one_is_that() -> None:
    assert [usual_factor(factor) for factor in (0.203, 4.9, 0.333)] == [0.2, 5.0, 0.333]


def tagged(path: Path, orientation: int) -> Path:
    exif, file = Image.Exif(), io.BytesIO()
    exif[0x0112] = orientation
    Image.new("RGB", (8, 6)).save(file, "JPEG", exif=exif)
    path.write_bytes(file.getvalue())
    return path


def test_tags_that_would_turn_images_are_said(tmp_path: Path) -> None:
    def scene(*tags: int) -> Scene:
        frames = (Frame(n, n / 30, tagged(tmp_path / f"{n}.jpg", tag), None) for n, tag in enumerate(tags))
        return replace(SCENE, frames=tuple(frames))

    assert orientation_tags(scene(1, 1)) == []
    (found,) = orientation_tags(scene(6, 6, 6))
    assert "3 of 3 colour images examined" in found.what and "differ" not in found.what
    (mixed,) = orientation_tags(scene(1, 6, 8))
    assert "(EXIF orientation 6 in 1, 8 in 1)" in mixed.what and "the tags differ" in mixed.what


@pytest.mark.parametrize(("step_s", "odd"), [(1 / 30, False), (1.9, False), (33.3, True), (3.3e-5, True)])
def test_an_interval_that_no_camera_has_is_said(step_s: float, odd: bool) -> None:
    frames = tuple(replace(frame, timestamp_s=frame.index * step_s) for frame in SCENE.frames)
    assert [found.kind for found in odd_times(replace(SCENE, frames=frames))] == ["times"] * odd


def test_the_headline_says_what_is_wrong_and_what_was_not_judged() -> None:
    finding = Finding("blur", "blurred", 1.0, "slowly")
    heads = [
        describe(Diagnosis("a", (), findings, unjudged)).splitlines()[0]
        for findings in ((), (finding,))
        for unjudged in ((), ("lag (no edges)", "unit (no poses)"))
    ]
    assert heads == [
        "scene a: nothing wrong was found",
        "scene a: not judged: lag (no edges); unit (no poses); no fault in the rest",
        "scene a: 1 thing wrong",
        "scene a: 1 thing wrong; not judged: lag (no edges); unit (no poses)",
    ]


def test_key_frames_far_apart_are_no_jumps_but_one_step_among_them_is() -> None:
    """Nerfstudio's and Polycam's frames are chosen so, and the former have no times."""
    moved = np.tile(np.eye(4), (12, 1, 1))
    moved[:, 0, 3] = 0.15 * np.arange(12)
    trajectory = Trajectory(np.arange(12), moved)
    assert pose_jumps(SCENE, trajectory) == []
    moved[7:, 1, 3] = 0.9
    (found,) = pose_jumps(SCENE, Trajectory(np.arange(12), moved))
    assert found.what == "the camera jumps 1 time, by 0.91 m at most, after frame 6"


def test_intrinsics_are_no_certain_fault_while_depth_has_another_field_of_view() -> None:
    zoomed = Finding("registration", "", 1.0, "", Mend(depth_zoom=1.25))
    others = [Finding("intrinsics", "", 1.0, "ask"), Finding("depth scale", "", 1.0, "")]
    unsure, kept = _after_mending([zoomed], others)
    assert unsure.sure == 0.5 and unsure.todo.startswith("mend the registration first") and kept == others[1]
    moved = replace(zoomed, mend=Mend(depth_shift_px=(9.0, 0.0)))
    assert _after_mending([moved], others) == _after_mending([], others) == others
