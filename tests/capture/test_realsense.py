"""Recordings of RealSense cameras, made by a software camera, whole and cut off."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyrealsense2 as rs
import pytest
from software_camera import FOCAL_PX, HEIGHT, WIDTH, color_pixels, depth_pixels, record

from rpl_data.capture.lens import intrinsics_of
from rpl_data.capture.playback import read_realsense
from rpl_data.formats.containers.rosbag import repair_bag
from rpl_data.geometry import project
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Recording

BAG = Path(__file__).parents[1] / "data" / "realsense.bag"
BAG_PAIRS = 120


def read(file: Path, **options: float) -> Recording:
    unpacked = file.parent / "unpacked"
    (recording,) = read_realsense(file, unpack=lambda name: unpacked / name, **options)
    assert not list(unpacked.rglob("repaired*"))
    return recording


@pytest.fixture(scope="module")
def db3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording") / "cup.db3", 30)


def test_a_recording_comes_back_exactly(db3: Path) -> None:
    recording = read(db3)
    scene = recording.scene
    assert (scene.name, scene.metres_per_unit, scene.registered) == ("cup", 0.001, True)
    lens = scene.intrinsics
    assert (lens.fx, lens.cx, lens.cy, lens.width, lens.height) == (FOCAL_PX, 31.5, 23.5, WIDTH, HEIGHT)
    assert lens.distortion == ()
    assert recording.skipped == ()
    assert len(scene.frames) == 30  # the pipeline would lose the first and give others twice
    for number, frame in enumerate(scene.frames):
        assert frame.timestamp_s == pytest.approx(1 + number / 30)
        np.testing.assert_array_equal(
            read_depth_m(scene, frame), depth_pixels(number).astype(np.float32) * np.float32(0.001)
        )
        assert np.abs(read_color(frame).astype(int) - color_pixels(number)).mean() < 4
    assert any("Software Camera" in note for note in recording.notes)
    assert "must be tracked" in recording.notes[0]


def test_the_depth_unit_is_the_files(tmp_path: Path) -> None:
    """A D405 counts tenths of a millimetre."""
    file = record(tmp_path / "d405.db3", 3, unit_m=0.0005)
    recording = read(file)
    assert recording.scene.metres_per_unit == 0.0005
    assert read(file, metres_per_unit=0.001).scene.metres_per_unit == 0.001


def test_depth_is_moved_onto_the_colour_pixels(tmp_path: Path) -> None:
    """The colour camera is 10 cm to the left: at 0.77 m everything lies 7.8 px further right."""
    plane = np.full((HEIGHT, WIDTH), 770, np.uint16)
    plane[10:20, 20:30] = 0
    recording = read(record(tmp_path / "wide.db3", 3, apart_m=0.1, depth=lambda number: plane))
    depth_m = read_depth_m(recording.scene, recording.scene.frames[0])
    assert not depth_m[:, :7].any()  # what only the colour camera sees
    assert not depth_m[11:19, 29:37].any()
    np.testing.assert_allclose(depth_m[25:, 9:], 0.77, atol=1e-6)
    np.testing.assert_allclose(depth_m[11:19, 39:], 0.77, atol=1e-6)


def test_the_lens_is_opencvs(tmp_path: Path) -> None:
    coeffs = (0.1, -0.2, 0.001, 0.002, 0.05)
    file = record(tmp_path / "lens.db3", 3, model=rs.distortion.brown_conrady, coeffs=coeffs)
    assert read(file).scene.intrinsics.distortion == pytest.approx(coeffs, abs=1e-7)


@pytest.mark.parametrize("name", ["brown_conrady", "inverse_brown_conrady", "modified_brown_conrady"])
def test_every_lens_model_projects_as_librealsense_does(name: str) -> None:
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = 640, 480, 610.0, 611.0, 322.0, 238.0
    lens.model, lens.coeffs = getattr(rs.distortion, name), [0.09, -0.18, 0.0008, -0.0005, 0.03]
    intrinsics, notes = intrinsics_of(lens)
    points = np.array([[0.2, 0.1, 1.0], [-0.4, 0.3, 1.1], [0.0, 0.0, 0.7], [0.35, -0.3, 0.9]])
    expected = [rs.rs2_project_point_to_pixel(lens, list(point)) for point in points]
    np.testing.assert_allclose(project(intrinsics, points), expected, atol=0.02)
    assert len(notes) == (name != "brown_conrady")


def test_a_recording_without_colour_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    file = record(tmp_path / "folder" / "depth.db3", 3, streams=("depth",))
    with pytest.raises(DataError, match="holds no colour stream; record depth and colour together"):
        read(file)


def test_a_db3_that_was_cut_off(db3: Path, tmp_path: Path) -> None:
    content = db3.read_bytes()
    file = tmp_path / "cut.db3"
    file.write_bytes(content[: len(content) * 6 // 10])
    recording = read(file)
    kept = len(recording.scene.frames)
    assert 10 <= kept < 25
    assert "cut.db3 was cut off: the first" in recording.skipped[0]
    for number, frame in enumerate(recording.scene.frames):
        raw = np.round(read_depth_m(recording.scene, frame) * 1000).astype(int)
        np.testing.assert_array_equal(raw, depth_pixels(number))


def test_an_old_bag(tmp_path: Path) -> None:
    shutil.copy(BAG, tmp_path / "old.bag")
    recording = read(tmp_path / "old.bag")
    assert len(recording.scene.frames) == BAG_PAIRS
    assert recording.skipped == ()
    assert recording.scene.metres_per_unit == 0.001
    raw = np.round(read_depth_m(recording.scene, recording.scene.frames[7]) * 1000)
    assert (raw == 700 + 7).all()


def test_a_bag_that_was_never_closed(tmp_path: Path) -> None:
    """The index at the end was not written, and the header does not point to one."""
    content = bytearray(BAG.read_bytes())
    at = content.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(content[at : at + 8], "little")
    content[at : at + 8] = bytes(8)
    file = tmp_path / "open.bag"
    file.write_bytes(content[:end])
    with pytest.raises(RuntimeError, match="unindexed|Bag"):
        rs.context().load_device(str(file))
    recording = read(file)
    assert len(recording.scene.frames) == BAG_PAIRS
    assert "open.bag was never closed or cut off" in recording.skipped[0]


def test_a_bag_cut_in_the_middle_of_a_chunk(tmp_path: Path) -> None:
    content = BAG.read_bytes()
    file = tmp_path / "cut.bag"
    second = content.index(b"compression=", content.index(b"compression=") + 1)
    file.write_bytes(content[: second + 5000])
    recording = read(file)
    kept = len(recording.scene.frames)
    assert BAG_PAIRS // 3 < kept < BAG_PAIRS
    assert "what is complete is read, its first" in recording.skipped[0]
    file.write_bytes(content[:4200])
    with pytest.raises(DataError, match="cut off before its first complete message"):
        read(file)


def test_a_whole_bag_survives_its_repair(tmp_path: Path) -> None:
    repair = repair_bag(BAG, tmp_path / "again.bag")
    assert repair.seconds > 0.1
    assert len(read(tmp_path / "again.bag").scene.frames) == BAG_PAIRS


@pytest.mark.parametrize("suffix", ["db3", "bag"])
def test_other_files_are_refused(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"text.{suffix}"
    file.write_text("no recording at all" * 100)
    with pytest.raises(DataError, match=r"is not a (ROS bag|recording)"):
        read(file)
    file.unlink()
    with pytest.raises(DataError, match="does not exist"):
        read(file)
    with pytest.raises(DataError, match=r"holds no .db3 or .bag file"):
        read_realsense(tmp_path, unpack=lambda name: tmp_path / name)


def test_a_folder_of_recordings(db3: Path, tmp_path: Path) -> None:
    for name in ("01", "00"):
        shutil.copy(db3, tmp_path / f"{name}.db3")
    found = open_scenes(tmp_path, "realsense", names=["01"], unpack=lambda name: tmp_path / "out" / name)
    assert [recording.scene.name for recording in found] == ["01"]
    with pytest.raises(DataError, match="It looks like `format: realsense`"):
        open_scenes(tmp_path, "rpl")
