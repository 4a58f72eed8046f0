"""The reader of TUM RGB-D sequences and of ICL-NUIM's variant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import LENS, cut, poses, write_color, write_depth

from rpl_data.formats.recordings.pose_lines import interpolated
from rpl_data.formats.recordings.tum import read_tum, write_tum
from rpl_data.geometry import from_rotvec, project, rotation_angle_rad, transform
from rpl_data.images import read_depth_m
from rpl_data.recordings.open import likely_formats
from rpl_data.types import DataError

TIMES = [100 + i / 30 for i in range(5)]


def make_sequence(folder: Path, *, depth_late_s: float = 0.004, poses_at: list[float] | None = None) -> Path:
    for i in range(5):
        write_color(folder / f"rgb/{i}.png", i)
        write_depth(folder / f"depth/{i}.png", i, unit=4000)
    stamps = TIMES if poses_at is None else poses_at
    write_tum(
        folder,
        [(t, f"rgb/{i}.png") for i, t in enumerate(TIMES)],
        [(t + depth_late_s, f"depth/{i}.png") for i, t in enumerate(TIMES)],
        (np.array(stamps), poses(len(stamps))),
    )
    (folder / "camera.txt").write_text("50 51 31.5 23.5\n")
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_sequence(tmp_path / "desk")


def test_what_is_written_is_read(folder: Path) -> None:
    (recording,) = read_tum(folder)
    scene = recording.scene
    assert (scene.name, scene.metres_per_unit, scene.registered) == ("desk", 1 / 5000, True)
    assert [frame.index for frame in scene.frames] == list(range(5))
    np.testing.assert_allclose([f.timestamp_s for f in scene.frames], TIMES, atol=1e-6)
    assert recording.skipped == ()
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(5), atol=1e-5)
    assert read_depth_m(scene, scene.frames[3])[0, 0] == pytest.approx(4003 / 5000)
    assert "assumed 0.0002: the median depth is then 0.81 m" in recording.notes[0]


def test_the_factor_is_5000_unless_given(folder: Path) -> None:
    (recording,) = read_tum(folder, metres_per_unit=0.001)
    assert read_depth_m(recording.scene, recording.scene.frames[0])[0, 0] == pytest.approx(4.0)
    assert recording.notes == ()


def test_images_are_paired_by_time_not_by_row(folder: Path) -> None:
    """Depth 1 was dropped, so row 1 of depth.txt belongs to colour 2."""
    lines = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join([lines[0], *lines[:0:-1]]).replace(lines[2], "# lost"))
    (recording,) = read_tum(folder)
    assert [frame.index for frame in recording.scene.frames] == [0, 2, 3, 4]
    assert [str(frame.depth)[-5] for frame in recording.scene.frames] == ["0", "2", "3", "4"]
    assert recording.skipped == ("1 colour image without a depth image within 0.02 s of their own",)


def test_images_too_far_apart_are_no_pair(tmp_path: Path) -> None:
    """At 21 ms the next colour image is nearer to a depth image than its own; none is used twice."""
    (recording,) = read_tum(make_sequence(tmp_path, depth_late_s=0.021))
    assert [frame.index for frame in recording.scene.frames] == [1, 2, 3, 4]
    assert [str(frame.depth)[-5] for frame in recording.scene.frames] == ["0", "1", "2", "3"]
    late = make_sequence(tmp_path / "late", depth_late_s=5.0)
    with pytest.raises(DataError, match=r"no image of rgb.txt is within 0.02 s"):
        read_tum(late)


def test_poses_are_interpolated_at_the_time_of_the_colour_image(tmp_path: Path) -> None:
    """Poses half a frame off: straight between the neighbours, half the turn; none outside their time."""
    shifted = [t + 1 / 60 for t in TIMES]
    (recording,) = read_tum(make_sequence(tmp_path / "a", poses_at=shifted))
    assert recording.trajectory is not None
    assert recording.trajectory.frames.tolist() == [1, 2, 3, 4]
    pose = recording.trajectory.at(1)
    np.testing.assert_allclose(pose[:3, 3], [0.05, 0, 0], atol=1e-5)
    assert rotation_angle_rad(pose[:3, :3]) == pytest.approx(0.05, abs=1e-5)
    assert recording.skipped == ("1 frame outside the time or in a gap of groundtruth.txt: 0",)


def test_a_gap_in_the_ground_truth_is_not_bridged(tmp_path: Path) -> None:
    (recording,) = read_tum(make_sequence(tmp_path, poses_at=[TIMES[0], TIMES[0] + 0.01, TIMES[4]]))
    assert [frame.index for frame in recording.scene.frames] == [0, 4]


def test_without_ground_truth_the_camera_must_be_tracked(folder: Path) -> None:
    (folder / "groundtruth.txt").unlink()
    (recording,) = read_tum(folder)
    assert recording.trajectory is None
    assert "no groundtruth.txt: the camera must be tracked" in recording.notes


def test_the_benchmarks_cameras_are_known_by_folder(tmp_path: Path) -> None:
    """The files do not hold them; 525 px would be the ROS default, 2 % off."""
    folder = make_sequence(tmp_path / "rgbd_dataset_freiburg3_long_office")
    (folder / "camera.txt").unlink()
    with pytest.raises(DataError, match="principal point .* is it for another resolution"):
        read_tum(folder)  # the image here is 64 x 48, the camera's 640 x 480
    unnamed = folder.rename(tmp_path / "office")
    with pytest.raises(DataError, match=r"does not hold its camera; give `camera: \[fx, fy, cx, cy\]`"):
        read_tum(unnamed)
    assert read_tum(unnamed, camera=LENS)[0].scene.intrinsics.fy == 51


def test_broken_images_are_named_and_left_out(folder: Path) -> None:
    cut(folder / "rgb/1.png")
    (folder / "depth/2.png").write_bytes(b"")
    (recording,) = read_tum(folder)
    assert [frame.index for frame in recording.scene.frames] == [0, 3, 4]


@pytest.mark.parametrize("depth_first", [True, False])
def test_icl_nuim(tmp_path: Path, depth_first: bool) -> None:
    """Frames are counted from 1, poses called *.gt.freiburg, the camera looks with y up (fy < 0).

    A point seen in two frames must land in one place, and in the pixel it came from.
    """
    sequence = make_sequence(tmp_path / "living room")
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        (sequence / name).unlink()
    columns = [("depth", "rgb"), ("rgb", "depth")][0 if depth_first else 1]
    rows = [" ".join(f"{i} {kind}/{i - 1}.png" for kind in columns) for i in range(1, 6)]
    (sequence / "associations.txt").write_text("\n".join(rows) + "\n")
    turned = from_rotvec(np.array([0.2, 0.3, -0.1]), np.array([0.5, -0.2, 0.1]))
    lines = ["1 0 0 0 0 0 0 1", *(f"{i} {_line(turned)}" for i in range(2, 6))]
    (sequence / "livingRoom0.gt.freiburg").write_text("\n".join(lines) + "\n")
    (recording,) = read_tum(sequence, camera=(50.0, -51.0, 31.5, 23.5))

    assert recording.scene.intrinsics.fy == 51
    assert recording.scene.frames[1].timestamp_s == pytest.approx(2 / 30)
    assert "frames are counted, not timed" in recording.notes[0]
    assert recording.trajectory is not None
    poses_here = recording.trajectory.scene_from_camera
    assert np.linalg.det(poses_here[1][:3, :3]) == pytest.approx(1)
    point_up = np.array([0.1, 0.3, 0.9])  # of the second camera, y up
    u, v = 31.5 + 50 * point_up[0] / point_up[2], 23.5 - 51 * point_up[1] / point_up[2]
    point_camera = point_up * [1, -1, 1]
    np.testing.assert_allclose(project(recording.scene.intrinsics, point_camera[None])[0], [u, v])
    in_scene = transform(poses_here[1], point_camera)
    np.testing.assert_allclose(in_scene, transform(turned, point_up) * [1, -1, 1], atol=1e-9)


def _line(pose: np.ndarray) -> str:
    from rpl_data.geometry import to_quaternion_xyzw

    return " ".join(f"{value:.12f}" for value in (*pose[:3, 3], *to_quaternion_xyzw(pose)))


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("rgb.txt", "", "rgb.txt is empty"),
        ("rgb.txt", "1.0 rgb/0.png 2.0\n", "rgb.txt line 1: expected <t> <file>, found"),
        ("depth.txt", "# t\nnan depth/0.png\n", "depth.txt line 2: numbers must be finite"),
        ("groundtruth.txt", "1 0 0 0 0 0 1\n", "groundtruth.txt line 1: expected 't tx ty tz"),
        ("groundtruth.txt", "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "all 5 frames are outside the time"),
    ],
)
def test_bad_files_are_refused(folder: Path, file: str, content: str, message: str) -> None:
    (folder / file).write_text(content)
    with pytest.raises(DataError, match=message):
        read_tum(folder)


def test_no_sequence(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"has no rgb.txt and depth.txt"):
        read_tum(tmp_path / "nowhere")


def test_camera_txt_says_the_unit_of_depth(folder: Path) -> None:
    """The layout's own 1/5000 m would make a scene in millimetres five times too small."""
    for i in range(5):
        write_depth(folder / f"depth/{i}.png", i, unit=800)
    (folder / "camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.001\n")
    (recording,) = read_tum(folder)
    assert recording.scene.metres_per_unit == 0.001
    assert not any("metres_per_unit" in note for note in recording.notes)
    with pytest.raises(DataError, match=r"camera.txt says 0.001 m .* the command says 0.0002; correct"):
        read_tum(folder, metres_per_unit=1 / 5000)
    (folder.parent / "camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.0002\n")
    with pytest.raises(DataError, match=r"camera.txt says 0.001 m .*camera.txt says 0.0002; correct"):
        read_tum(folder)


def _retimed(path: Path, factor: float) -> None:
    rows = [line.split(" ", 1) for line in path.read_text().splitlines() if not line.startswith("#")]
    path.write_text("".join(f"{float(t) * factor:.6f} {rest}\n" for t, rest in rows))


@pytest.mark.parametrize("factors", [(1e3, 1e3, 1e3), (1e6, 1e6, 1.0), (1.0, 1e9, 1e3)])
def test_each_list_has_its_own_unit_of_time(folder: Path, factors: tuple[float, float, float]) -> None:
    for name, factor in zip(("rgb.txt", "depth.txt", "groundtruth.txt"), factors, strict=True):
        _retimed(folder / name, factor)
    (recording,) = read_tum(folder)
    np.testing.assert_allclose([f.timestamp_s for f in recording.scene.frames], TIMES, atol=1e-5)
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(5), atol=1e-3)
    assert any("the times of " in note for note in recording.notes)


def test_how_long_frames_took_is_no_time(folder: Path) -> None:
    took = (0.033, 0.035, 0.031, 0.036, 0.030)
    for kind in ("rgb", "depth"):
        lines = [f"{t} {kind}/{i}.png" for i, t in enumerate(took)]
        (folder / f"{kind}.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(DataError, match=r"rgb.txt: its times jump back and forth.*how long each frame took"):
        read_tum(folder)


def test_lost_rows_of_the_poses_are_counted(folder: Path) -> None:
    lines = (folder / "groundtruth.txt").read_text().splitlines()
    lines[2] = f"{lines[2].split()[0]} nan nan nan nan nan nan nan"
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    (recording,) = read_tum(folder)
    assert "1 line of groundtruth.txt left out: not finite, or a quaternion of zeros" in recording.skipped


def test_a_folder_of_sequences_is_known_for_what_it_holds(tmp_path: Path) -> None:
    """Its parts look like plain folders too, which have neither times nor poses."""
    for name in ("a", "b"):
        (tmp_path / name / "rgb").mkdir(parents=True)
        (tmp_path / name / "depth").mkdir()
        for file in ("rgb", "depth"):
            (tmp_path / name / f"{file}.txt").write_text(f"0.1 {file}/1.png\n")
            (tmp_path / name / file / "1.png").write_bytes(b"x")
    assert likely_formats(tmp_path) == likely_formats(tmp_path / "a") == ["tum"]


def test_poses_far_apart_hold_at_their_own_times() -> None:
    """A slow recording with a pose per frame, whose times were rounded to milliseconds."""
    times_s, moved = np.arange(4) / 3, np.tile(np.eye(4), (4, 1, 1))
    moved[:, 0, 3] = range(4)
    wanted_s = np.array([*np.round(times_s, 3), 0.5, 1.002])
    found = interpolated(times_s, moved, wanted_s, max_gap_s=0.1)
    assert [None if pose is None else round(pose[0, 3], 2) for pose in found] == [0, 1, 2, 3, None, None]
