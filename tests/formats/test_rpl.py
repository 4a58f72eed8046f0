"""The reader and writer of the RapidPoseLabels tree."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from rpl_data.formats.recordings.camera_file import camera_text, write_camera
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.formats.recordings.rpl import read_rpl, write_associations, write_poses
from rpl_data.geometry import from_rotvec
from rpl_data.images import read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Intrinsics

CAMERA = Intrinsics(50.0, 51.0, 31.5, 23.5, 64, 48)
LENS = (50.0, 51.0, 31.5, 23.5)
TIMES = [10 + i / 30 for i in range(6)]


def poses(n: int) -> np.ndarray:
    return np.array([from_rotvec(np.array([0, 0.01 * i, 0]), np.array([0.1 * i, 0, 0])) for i in range(n)])


def make_tree(
    root: Path, scenes: tuple[str, ...] = ("00",), *, color_ext: str = "jpg", depth: int = 700
) -> Path:
    write_camera(root, CAMERA)
    for scene in scenes:
        colors = [f"rgb/{i:06d}.{color_ext}" for i in range(6)]
        depths = [f"depth/{i:06d}.png" for i in range(6)]
        for folder in ("rgb", "depth"):
            (root / scene / folder).mkdir(parents=True, exist_ok=True)
        for color_name, depth_name in zip(colors, depths, strict=True):
            cv2.imwrite(str(root / scene / color_name), np.full((48, 64, 3), 90, np.uint8))
            cv2.imwrite(str(root / scene / depth_name), np.full((48, 64), depth, np.uint16))
        write_associations(root / scene, TIMES, colors, depths)
        write_poses(root / scene, TIMES, poses(6))
    return root


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return make_tree(tmp_path / "set")


def swap_lines(path: Path) -> None:
    rows = [line.split() for line in path.read_text().splitlines()]
    path.write_text("".join(f"{b[2]} {b[3]} {b[0]} {b[1]}\n" for b in rows))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.parametrize("color_ext", ["jpg", "png", "bmp"])
def test_what_is_written_is_read(tmp_path: Path, color_ext: str) -> None:
    (recording,) = read_rpl(make_tree(tmp_path, color_ext=color_ext))
    assert recording.scene.intrinsics == CAMERA
    assert recording.scene.name == "00"
    assert recording.skipped == ()
    assert [frame.index for frame in recording.scene.frames] == list(range(6))
    np.testing.assert_allclose([f.timestamp_s for f in recording.scene.frames], TIMES, atol=1e-6)
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(6), atol=1e-8)


def test_the_images_decide_which_is_depth(tree: Path) -> None:
    (depth_first,) = read_rpl(tree)
    swap_lines(tree / "00/associations.txt")
    (rgb_first,) = read_rpl(tree)
    assert rgb_first.scene == depth_first.scene
    assert depth_first.scene.frames[0].color.parent.name == "rgb"


def test_the_assumed_depth_unit_is_said(tree: Path) -> None:
    assert "metres_per_unit not given, assumed 0.001" in read_rpl(tree)[0].notes[0]
    assert read_rpl(tree, metres_per_unit=0.002)[0].notes == ()


def test_scenes_are_sorted_and_chosen_by_name(tmp_path: Path) -> None:
    root = make_tree(tmp_path, ("10", "02", "01"))
    assert [r.scene.name for r in read_rpl(root)] == ["01", "02", "10"]
    assert [r.scene.name for r in read_rpl(root, names=["10", "01"])] == ["01", "10"]
    assert [r.scene.name for r in read_rpl(root / "02")] == ["02"]
    assert [r.scene.name for r in read_rpl(root / "02", names=["table"])] == ["table"]
    with pytest.raises(DataError, match=r"has no scene 11; it has 01, 02, 10"):
        read_rpl(root, names=["11"])


def test_poses_are_matched_by_time_not_by_row(tree: Path) -> None:
    """The tracker lost frames 1 and 5; its stamps are 3 ms off and unsorted."""
    kept = [4, 0, 2, 3]
    write_poses(tree / "00", [TIMES[i] + 0.003 for i in kept], poses(6)[kept])
    (recording,) = read_rpl(tree)
    assert recording.trajectory is not None
    assert recording.trajectory.frames.tolist() == [0, 2, 3, 4]
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(6)[[0, 2, 3, 4]], atol=1e-8)
    assert [frame.index for frame in recording.scene.frames] == [0, 2, 3, 4]
    assert recording.skipped == ("2 frames without a pose in camera.poses at their time: 1, 5",)
    assert recording.left_out == (1, 5), "the doctor would count them as lost by the recorder"


def test_poses_stamped_with_the_depth_time(tree: Path) -> None:
    """Colour is stamped half a frame after depth, the poses with depth's time: none may shift a row."""
    lines = [line.split() for line in (tree / "00/associations.txt").read_text().splitlines()]
    late = "".join(f"{t} {depth} {float(t) + 0.017:.6f} {color}\n" for t, depth, _, color in lines)
    (tree / "00/associations.txt").write_text(late)
    (recording,) = read_rpl(tree)
    assert recording.trajectory is not None
    np.testing.assert_allclose(recording.trajectory.scene_from_camera, poses(6), atol=1e-8)
    assert recording.scene.frames[0].timestamp_s == pytest.approx(TIMES[0] + 0.017, abs=1e-6)


def test_truncated_and_missing_images_are_named_and_left_out(tree: Path) -> None:
    cut(tree / "00/depth/000000.png")
    cut(tree / "00/rgb/000002.jpg")
    (tree / "00/depth/000003.png").unlink()
    (tree / "00/rgb/000004.jpg").write_bytes(b"")
    (recording,) = read_rpl(tree)
    assert [frame.index for frame in recording.scene.frames] == [1, 5]
    assert set(recording.skipped) == {
        "1 frame with an unreadable or truncated depth image: 0",
        "2 frames with an unreadable or truncated colour image: 2, 4",
        "1 frame without depth (no such file): 3",
    }


def test_a_png_padded_with_zeros_is_truncated(tree: Path) -> None:
    """What a power cut leaves: the right size, the end never written."""
    path = tree / "00/depth/000001.png"
    path.write_bytes(path.read_bytes()[:-20] + bytes(20))
    assert "truncated depth image: 1" in read_rpl(tree)[0].skipped[0]


def test_without_poses_there_is_no_trajectory(tree: Path) -> None:
    (tree / "00/camera.poses").unlink()
    (recording,) = read_rpl(tree)
    assert recording.trajectory is None
    assert "must be tracked" in recording.notes[0]


def test_repeated_timestamps_are_left_out(tree: Path) -> None:
    lines = (tree / "00/associations.txt").read_text().splitlines()
    lines[3] = lines[2].replace("000002", "000003")
    (tree / "00/associations.txt").write_text("\n".join(lines))
    (recording,) = read_rpl(tree)
    assert recording.skipped == ("1 frame with the timestamp of an earlier frame: 3",)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("camera.txt", None, r"camera.txt is missing; write it with one line: fx fy cx cy"),
        ("camera.txt", "", r"expected one line: fx fy cx cy.*found ''"),
        ("camera.txt", "50 50 32", r"expected one line: fx fy cx cy.*found '50 50 32'"),
        ("camera.txt", "50 nan 32 24", r"must be finite and fx, fy positive; found '50 nan 32 24'"),
        ("camera.txt", "600 600 320 240", r"principal point at .* 64 x 48 px.*Write fx fy cx cy"),
        ("00/camera.poses", "", r"camera.poses is empty.*track the scene again"),
        ("00/camera.poses", "10.0 0 0 0 0 0 0\n", r"camera.poses line 1: expected 't tx ty tz qx qy qz qw'"),
        ("00/camera.poses", "# t\n10.0 0 nan 0 0 0 0 1\n", r"holds no pose, only lines of a lost tracker"),
        ("00/camera.poses", "10.0 0 0 0 0 0 0 0.5\n", r"camera.poses line 1: .* no unit quaternion"),
        ("00/camera.poses", "10000000 0 0 0 0 0 0 1\n", r"no pose .* is at the time of a frame"),
        ("00/associations.txt", None, r"associations.txt does not exist"),
        ("00/associations.txt", "", r"associations.txt is empty"),
        ("00/associations.txt", "1 rgb/0.png\n", r"associations.txt line 1: expected <t> depth/<file>"),
        ("00/associations.txt", "inf depth/0.png 0 rgb/0.png\n", r"line 1: numbers must be finite"),
        ("00/associations.txt", "0 depth/x.png 0 rgb/x.png\n", r"none of 1 frames has two readable images"),
        ("00/associations.txt", "0 rgb/000001.jpg 0 rgb/000000.jpg\n", r"one should be depth \(16 bit"),
    ],
)  # fmt: skip
def test_bad_files_are_refused(tree: Path, file: str, content: str | None, message: str) -> None:
    if content is None:
        (tree / file).unlink()
    else:
        (tree / file).write_text(content)
    with pytest.raises(DataError, match=message):
        read_rpl(tree)


def test_no_frame_left(tree: Path) -> None:
    for i in range(1, 6):
        cut(tree / f"00/depth/{i:06d}.png")
    write_poses(tree / "00", TIMES[1:], poses(5))
    with pytest.raises(DataError, match="no pose in .*camera.poses"):
        read_rpl(tree)
    cut(tree / "00/depth/000000.png")
    with pytest.raises(DataError, match="none of 6 frames has two readable images"):
        read_rpl(tree)


def test_no_scene_and_no_folder(tmp_path: Path) -> None:
    write_camera(tmp_path, CAMERA)
    with pytest.raises(DataError, match="has no scene"):
        read_rpl(tmp_path)
    with pytest.raises(DataError, match="is not a folder"):
        read_rpl(tmp_path / "nowhere")
    with pytest.raises(DataError, match=r"unknown format 'rlp' .* expected one of .*rpl"):
        open_scenes(tmp_path, "rlp")


@pytest.mark.parametrize(("raw", "likely"), [(12000, "0.0001"), (65, "0.001"), (20000, "0.0001")])
def test_an_impossible_depth_unit_is_refused(tmp_path: Path, raw: int, likely: str) -> None:
    root = make_tree(tmp_path, depth=raw)
    unit = 0.001 if likely == "0.0001" else 0.0001
    with pytest.raises(DataError, match=rf"expected 0.1 to 10 m. Set metres_per_unit, probably to {likely}"):
        read_rpl(root, metres_per_unit=unit)
    with pytest.raises(DataError, match="metres_per_unit must be positive"):
        read_rpl(root, metres_per_unit=0.0)


def test_no_unit_is_advised_that_is_set_already(tmp_path: Path) -> None:
    """Centimetres, which no camera stores."""
    with pytest.raises(DataError, match="Set metres_per_unit, though no usual unit puts it there"):
        read_rpl(make_tree(tmp_path, depth=70), metres_per_unit=0.001)


def _multiply_depth(root: Path, factor: int) -> None:
    for path in root.glob("*/depth/*.png"):
        slope = np.arange(64, dtype=np.uint16) - 32
        cv2.imwrite(str(path), (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) + slope) * factor)


def test_depth_far_off_as_its_bits_are_turned_is_read_for_the_doctor(tmp_path: Path) -> None:
    """21 m is no tabletop, but no unit would mend it: `mend: {depth_bits_turned: true}` does."""
    root = make_tree(tmp_path, depth=2664)
    _multiply_depth(root, 8)
    (recording,) = read_rpl(root, metres_per_unit=0.001)
    assert any("`mend: {depth_bits_turned: true}` turns them back" in note for note in recording.notes)


def test_depth_in_multiples_of_five_is_tums(tmp_path: Path) -> None:
    root = make_tree(tmp_path, depth=2500)
    _multiply_depth(root, 5)
    with pytest.raises(DataError, match=r"Set metres_per_unit, probably to 0.0002"):
        read_rpl(root, metres_per_unit=0.001)


def test_depth_without_depth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="hold no depth"):
        read_rpl(make_tree(tmp_path, depth=0))


def test_unregistered_depth_is_refused(tree: Path) -> None:
    cv2.imwrite(str(tree / "00/depth/000000.png"), np.full((24, 32), 700, np.uint16))
    with pytest.raises(DataError, match=r"differ in size \(32x24 and 64x48\): depth must be registered"):
        read_rpl(tree)


def test_depth_coarser_than_colour_is_kept_where_camera_txt_says_so(tree: Path) -> None:
    """As a phone sends it; it is looked up at the colour pixels."""
    for path in (tree / "00/depth").iterdir():
        cv2.imwrite(str(path), np.full((24, 32), 700, np.uint16))
    (tree / "camera.txt").write_text(camera_text(CAMERA, 0.001, (32, 24)))
    scene = read_rpl(tree)[0].scene
    assert scene.depth_size == (24, 32)
    assert scene.depth_intrinsics.fx == 25 and scene.depth_intrinsics.cx == (31.5 + 0.5) / 2 - 0.5
    np.testing.assert_allclose(read_depth_m(scene, scene.frames[0]), np.full((48, 64), 0.7), atol=1e-6)


def test_camera_txt_also_holds_distortion_and_the_depth_unit(tree: Path) -> None:
    """The original reads the first line only, which is as ever."""
    lens = (0.1, -0.2, 0.001, 0.002, 0.05)
    write_camera(tree, replace(CAMERA, distortion=lens), 0.0005)
    assert (tree / "camera.txt").read_text().splitlines()[0] == "50.0 51.0 31.5 23.5"
    scene = read_rpl(tree)[0].scene
    assert (scene.intrinsics.distortion, scene.metres_per_unit) == (lens, 0.0005)
    assert not any("metres_per_unit" in note for note in read_rpl(tree)[0].notes)
    given = read_rpl(tree, camera=LENS, metres_per_unit=0.0005)[0].scene
    assert (given.intrinsics.distortion, given.metres_per_unit) == ((), 0.0005)
    assert read_rpl(tree, camera=LENS)[0].scene.metres_per_unit == 0.0005
    with pytest.raises(DataError, match=r"camera.txt says 0.0005 m per unit .* the command says 0.001"):
        read_rpl(tree, metres_per_unit=0.001)


@pytest.mark.parametrize(
    "line", ["metres_per_unit: 0.0005", "metres_per_unit=0.0005", "Meters_per_unit 0.0005"]
)
def test_camera_txt_says_the_depth_unit_in_any_spelling(tree: Path, line: str) -> None:
    (tree / "camera.txt").write_text(f"50 51 31.5 23.5\n{line}\n")
    assert read_rpl(tree)[0].scene.metres_per_unit == 0.0005


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("depth_scale: 1000", "'depth_scale: 1000' is not understood; write .* `metres_per_unit 0.001`"),
        ("Depth unit = mm", "'Depth unit = mm' is not understood"),
        ("distortion 0.1 0.2", "expected 4 or 5 or 8 numbers after distortion"),
        ("depth_px 32", "expected 2 numbers after depth_px"),
        ("metres_per_unit mm", "could not convert .* repair or delete the line"),
    ],
)
def test_what_camera_txt_says_wrongly(tree: Path, line: str, message: str) -> None:
    (tree / "camera.txt").write_text(f"50 51 31.5 23.5\na line of another tool\n{line}\n")
    with pytest.raises(DataError, match=message):
        read_rpl(tree)


def _retimed(path: Path, columns: tuple[int, ...], factor: float) -> None:
    rows = [line.split() for line in path.read_text().splitlines()]
    for row in rows:
        for column in columns:
            row[column] = f"{float(row[column]) * factor:.4f}"
    path.write_text("".join(" ".join(row) + "\n" for row in rows))


@pytest.mark.parametrize(("images", "tracker"), [(1e3, 1e3), (1e9, 1.0), (1.0, 1e6)])
def test_the_unit_of_times_is_found_and_said(tree: Path, images: float, tracker: float) -> None:
    _retimed(tree / "00/associations.txt", (0, 2), images)
    _retimed(tree / "00/camera.poses", (0,), tracker)
    (recording,) = read_rpl(tree)
    np.testing.assert_allclose([frame.timestamp_s for frame in recording.scene.frames], TIMES, atol=1e-3)
    assert recording.trajectory is not None and len(recording.trajectory.frames) == 6
    assert any(note.startswith("the times of ") for note in recording.notes)


def test_how_long_frames_took_is_no_time(tree: Path) -> None:
    lines = [line.split() for line in (tree / "00/associations.txt").read_text().splitlines()]
    took = (0.033, 0.036, 0.030, 0.037, 0.031, 0.035)
    rows = (f"{t} {one} {t} {two}\n" for t, (_, one, _, two) in zip(took, lines, strict=True))
    (tree / "00/associations.txt").write_text("".join(rows))
    with pytest.raises(DataError, match=r"associations.txt: its times jump back and forth"):
        read_rpl(tree)


def test_two_camera_files_must_agree(tree: Path) -> None:
    (tree / "00/camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.0005\n")
    assert read_rpl(tree)[0].scene.metres_per_unit == 0.0005
    (tree / "00/camera.txt").write_text("75 76 31.5 23.5\n")
    with pytest.raises(
        DataError, match=r"camera.txt says .* = 75 76 .*camera.txt says 50 51 .*correct or delete"
    ):
        read_rpl(tree)
    assert read_rpl(tree, camera=LENS)[0].scene.intrinsics.fx == 50


def test_probe_agrees_with_the_decoder(tmp_path: Path) -> None:
    """A JPEG with an EXIF block and a 16-bit colour PNG, which is no depth."""
    image = np.zeros((30, 40, 3), np.uint8)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    exif = b"\xff\xe1" + struct.pack(">H", 5002) + bytes(5000)
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + exif + jpeg[2:] + bytes(10))
    header = probe(tmp_path / "a.jpg")
    assert header is not None and (header.width, header.height, header.is_depth) == (40, 30, False)
    cv2.imwrite(str(tmp_path / "b.png"), image.astype(np.uint16))
    header = probe(tmp_path / "b.png")
    assert header is not None and not header.is_depth
    assert zlib.crc32(b"IEND") == 0xAE426082  # the end mark the reader looks for
    (tmp_path / "c.png").write_text("no image")
    assert probe(tmp_path / "c.png") is None


def test_the_desk(real_data: Path) -> None:
    recordings = read_rpl(real_data / "desk")
    assert [(r.scene.name, len(r.scene.frames)) for r in recordings] == [("00", 25), ("01", 25)]
    assert recordings[0].scene.intrinsics.width == 640
    assert all(r.trajectory is not None and len(r.trajectory.frames) == 25 for r in recordings)
    assert all(r.skipped == () for r in recordings)
