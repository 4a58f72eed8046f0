"""ElasticFusion's logs and trajectories."""

from __future__ import annotations

import resource
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from recordings import LENS, color_image, cut, depth_image, poses

from rpl_data.formats.containers.klg import index_klg, klg_color, klg_depth_mm, klg_image_size, write_klg
from rpl_data.formats.recordings.elasticfusion import read_klg
from rpl_data.formats.recordings.pose_lines import write_pose_lines
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Recording

TIMES_US = [1_500_000_000 + 33_333 * i for i in range(6)]
SIZE = (64, 48)


def make_log(path: Path, *, packed: bool = True, times: list[int] = TIMES_US) -> Path:
    write_klg(path, ((t, depth_image(i), color_image(i)) for i, t in enumerate(times)), packed=packed)
    return path


def read(log: Path, **options: object) -> Recording:
    options = {"camera": LENS} | options
    (recording,) = read_klg(log, unpack=lambda name: log.parent / "unpacked" / name, **options)  # type: ignore[arg-type]
    return recording


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return make_log(tmp_path / "cup.klg")


def test_what_is_written_is_read(log: Path) -> None:
    recording = read(log)
    scene = recording.scene
    assert (scene.name, scene.metres_per_unit, recording.skipped) == ("cup", 0.001, ())
    assert [frame.index for frame in scene.frames] == list(range(6))
    np.testing.assert_allclose([f.timestamp_s for f in scene.frames], np.array(TIMES_US) * 1e-6)
    for i, frame in enumerate(scene.frames):
        np.testing.assert_array_equal(read_depth_m(scene, frame), depth_image(i) * np.float32(0.001))
        assert np.abs(read_color(frame).astype(int) - color_image(i)).mean() < 4
    assert recording.trajectory is None
    assert "no cup.klg.freiburg: the camera must be tracked" in recording.notes


def test_a_jpeg_is_kept_as_it_is(log: Path) -> None:
    entry = index_klg(log).entries[2]
    with log.open("rb") as file:
        stored = klg_color(file, entry, SIZE)
    assert isinstance(stored, bytes)
    assert read(log).scene.frames[2].color.read_bytes() == stored


def test_by_hand(tmp_path: Path) -> None:
    """Two frames of 160 x 120: raw depth and colour; zlib depth and no colour, which is black."""
    import zlib

    depth = np.arange(160 * 120, dtype="<u2") % 500 + 600
    color = np.arange(3 * 160 * 120, dtype=np.uint32).astype(np.uint8)
    packed = zlib.compress(depth.tobytes())
    frames = struct.pack("<qii", 1_000_000, depth.nbytes, color.nbytes) + depth.tobytes() + color.tobytes()
    frames += struct.pack("<qii", 1_033_000, len(packed), 0) + packed
    (tmp_path / "a.klg").write_bytes(struct.pack("<i", 2) + frames)
    recording = read(tmp_path / "a.klg", camera=(150.0, 150.0, 79.5, 59.5))
    assert (recording.scene.intrinsics.width, recording.scene.intrinsics.height) == (160, 120)
    first, second = recording.scene.frames
    assert second.timestamp_s == pytest.approx(1.033)
    np.testing.assert_array_equal(read_color(first), color.reshape(120, 160, 3))
    assert not read_color(second).any()
    np.testing.assert_allclose(read_depth_m(recording.scene, second).ravel(), depth * 0.001, rtol=1e-6)


@pytest.mark.parametrize("packed", [True, False])
def test_colours_in_the_order_blue_green_red(tmp_path: Path, packed: bool) -> None:
    """What png_to_klg writes, and ElasticFusion's -f turns round."""
    size = (160, 120)
    swapped = np.full((120, 160, 3), (200, 100, 0), np.uint8)  # meant as blue 200, green 100
    depth = np.full((120, 160), 800, np.uint16)
    write_klg(tmp_path / "a.klg", [(0, depth, swapped), (33_000, depth, swapped)], packed=packed)
    unpack = tmp_path / "unpacked"
    (recording,) = open_scenes(
        tmp_path / "a.klg", "klg_bgr", camera=(150.0, 150.0, 79.5, 59.5), unpack=lambda name: unpack
    )
    assert klg_image_size(tmp_path / "a.klg", index_klg(tmp_path / "a.klg")) == size
    np.testing.assert_allclose(read_color(recording.scene.frames[0])[60, 80], [0, 100, 200], atol=3)


def test_poses_are_matched_by_time(log: Path) -> None:
    """Frame 2 was skipped and the last never processed, as ElasticFusion leaves it."""
    kept = [0, 1, 3, 4]
    write_pose_lines(Path(f"{log}.freiburg"), [TIMES_US[i] * 1e-6 for i in kept], poses(6)[kept])
    recording = read(log)
    assert recording.trajectory is not None
    assert recording.trajectory.frames.tolist() == kept
    np.testing.assert_allclose(recording.trajectory.at(3), poses(6)[3], atol=1e-8)
    assert recording.skipped == ("2 frames without a pose in cup.klg.freiburg at their time: 2, 5",)


def test_poses_on_the_logs_own_clock(log: Path) -> None:
    """ElasticFusion -icl writes the numbers of the log instead of seconds."""
    write_pose_lines(Path(f"{log}.freiburg"), [float(t) for t in TIMES_US[:5]], poses(6)[:5])
    recording = read(log)
    assert recording.trajectory is not None and recording.trajectory.frames.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("per_s", "rate_hz", "start_s"),
    [
        (1000, 30, 0),
        (1000, 3, 1_700_000_000),
        (10**9, 30, 1_700_000_000),
        (10**9, 1, 0),
        (10**5, 30, 0),  # five decimals without their point
        (10**7, 30, 1_700_000_000),
        (10**6, 2, 0),
        (1, 1, 1_700_000_000),
    ],
)
@pytest.mark.parametrize("written", ["seconds", "as if microseconds", "unchanged"])
def test_times_in_other_units(
    per_s: int, rate_hz: float, start_s: float, written: str, tmp_path: Path
) -> None:
    """The step in seconds is found, and poses are matched whatever the program took the log's times for."""
    times = [round((start_s + i / rate_hz) * per_s) for i in range(6)]
    log = make_log(tmp_path / "a.klg", times=times)
    unit = {"seconds": 1 / per_s, "as if microseconds": 1e-6, "unchanged": 1.0}[written]
    write_pose_lines(tmp_path / "a.klg.freiburg", [t * unit for t in times], poses(6))
    recording = read(log)
    steps_s = np.diff([frame.timestamp_s for frame in recording.scene.frames])
    np.testing.assert_allclose(steps_s, 1 / rate_hz, rtol=0.03)
    assert any("times are not microseconds" in note for note in recording.notes) == (per_s != 10**6)
    assert recording.trajectory is not None and recording.trajectory.frames.tolist() == list(range(6))


def test_counted_frames_of_a_log(tmp_path: Path) -> None:
    recording = read(make_log(tmp_path / "a.klg", times=list(range(6))))
    np.testing.assert_allclose([frame.timestamp_s for frame in recording.scene.frames], np.arange(6) / 30)
    assert any("units of 0.03333 s assumed" in note for note in recording.notes)


def test_an_empty_trajectory_of_a_killed_run(log: Path) -> None:
    Path(f"{log}.freiburg").write_text("")
    with pytest.raises(DataError, match="is empty .as ElasticFusion leaves it when it is killed"):
        read(log)


def test_times_that_are_no_microseconds(tmp_path: Path) -> None:
    """png_to_klg takes the point out of 1305031102.1753: units of 0.1 ms."""
    times = [13050311021753 + 333 * i for i in range(6)]
    log = make_log(tmp_path / "a.klg", times=times)
    write_pose_lines(tmp_path / "a.klg.freiburg", [t * 1e-6 for t in times[:5]], poses(5))
    recording = read(log)
    steps_s = np.diff([frame.timestamp_s for frame in recording.scene.frames])
    np.testing.assert_allclose(steps_s, 0.0333, atol=1e-6)
    assert any("units of 0.0001 s assumed" in note for note in recording.notes)
    assert recording.trajectory is not None and recording.trajectory.frames.tolist() == [0, 1, 2, 3, 4]


def test_a_log_cut_in_the_middle_of_a_frame(log: Path) -> None:
    cut(log, 100)
    recording = read(log)
    assert len(recording.scene.frames) == 5
    assert recording.skipped == ("1 of 6 frames: the log was cut off after frame 4",)


def test_a_log_that_was_never_closed(log: Path) -> None:
    """The count is still 0; all that is whole is read."""
    content = log.read_bytes()
    log.write_bytes(struct.pack("<i", 0) + content[4:])
    assert len(read(log).scene.frames) == 6
    log.write_bytes(struct.pack("<i", 0) + content[4:-100])
    recording = read(log)
    assert len(recording.scene.frames) == 5
    assert "cut off in the middle of frame 5" in recording.skipped[0]


def test_a_broken_frame_is_counted(log: Path) -> None:
    entry = index_klg(log).entries[3]
    content = bytearray(log.read_bytes())
    content[entry.depth_at : entry.depth_at + 10] = bytes(10)
    log.write_bytes(content)
    with log.open("rb") as file:
        assert klg_depth_mm(file, entry, SIZE) is None
    recording = read(log)
    assert [frame.index for frame in recording.scene.frames] == [0, 1, 2, 4, 5]
    assert recording.skipped == ("1 frame with damaged data in the log: 3",)


def test_the_camera_beside_the_log(log: Path) -> None:
    with pytest.raises(DataError, match=r"does not hold its camera; give .*or write .* into cup.cal"):
        read(log, camera=None)
    log.with_name("camera.txt").write_text("50 51 31.5 23.5")
    assert read(log, camera=None).scene.intrinsics.fy == 51
    log.with_name("cup.cal").write_text("50 52 31.5 23.5")
    with pytest.raises(
        DataError, match=r"cup.cal says .* 52 .*camera.txt says .* 51 .*correct or delete one"
    ):
        read(log, camera=None)
    log.with_name("camera.txt").unlink()
    assert read(log, camera=None).scene.intrinsics.fy == 52


def test_the_unit_of_depth_beside_the_log(log: Path) -> None:
    """By the format millimetres; but a log has what its recorder wrote, and camera.txt may know better."""
    log.with_name("camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.002\n")
    assert read(log, camera=None).scene.metres_per_unit == 0.002
    with pytest.raises(DataError, match=r"camera.txt says 0.002 m per unit"):
        read(log, metres_per_unit=0.001)


def test_wrong_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.klg").write_text("no log at all, but long enough for a header")
    with pytest.raises(DataError, match="is not an ElasticFusion log"):
        read(tmp_path / "text.klg")
    with pytest.raises(DataError, match="nothing.klg does not exist"):
        read(tmp_path / "nothing.klg")
    with pytest.raises(DataError, match=r"has no scene b; it has text"):
        read(tmp_path, names=["b"])
    raw = make_log(tmp_path / "raw.klg", packed=False)
    with pytest.raises(DataError, match=r"size .* is unknown.* 3072 depth pixels are none of 640x480"):
        read(raw)
    with pytest.raises(DataError, match="are unpacked; say where to: `unpack`"):
        open_scenes(raw, "klg")
    with pytest.raises(DataError, match=r"It looks like `format: klg`"):
        open_scenes(tmp_path, "rpl")


def test_nine_thousand_frames_are_indexed_not_loaded(tmp_path: Path) -> None:
    """A sparse file as large as a recording of five minutes; its index takes little time and memory."""
    import tracemalloc

    depth_bytes, color_bytes, count = 200_000, 60_000, 9_000
    with (tmp_path / "long.klg").open("wb") as file:
        file.write(struct.pack("<i", count))
        for i in range(count):
            file.write(struct.pack("<qii", 33_333 * i, depth_bytes, color_bytes))
            file.seek(depth_bytes + color_bytes, 1)
        file.truncate(file.tell())
    tracemalloc.start()
    index = index_klg(tmp_path / "long.klg")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(index.entries) == count and index.lost_bytes == 0
    assert peak < 5_000_000


def test_two_logs_of_one_name_are_refused_before_the_second_is_unpacked(tmp_path: Path) -> None:
    from rpl_data.pipeline.recipe import SceneSource
    from rpl_data.pipeline.sources import recordings_of

    logs = []
    for folder in (tmp_path / "monday", tmp_path / "friday"):
        folder.mkdir()
        logs.append(make_log(folder / "cup.klg"))
        write_pose_lines(Path(f"{logs[-1]}.freiburg"), [t * 1e-6 for t in TIMES_US], poses(6))
    asked: list[str] = []

    def unpack(name: str) -> Path:
        asked.append(name)
        return tmp_path / "unpacked" / name

    with pytest.raises(DataError, match="two scenes are called cup: .*monday.*friday.*rename"):
        recordings_of([SceneSource(log, "klg", camera=LENS) for log in logs], unpack=unpack)
    assert asked == ["cup"]


def test_a_recipe_unpacks_into_the_workspace(tmp_path: Path) -> None:
    from rpl_data.pipeline.recipe_file import parse_recipe
    from rpl_data.pipeline.sources import recordings_of
    from rpl_data.workspace.workspace import Workspace

    log = make_log(tmp_path / "cup.klg")
    write_pose_lines(Path(f"{log}.freiburg"), [t * 1e-6 for t in TIMES_US], poses(6))
    scene = {"format": "klg", "path": str(log), "camera": list(LENS)}
    recipe = parse_recipe(
        {"name": "a", "scenes": [scene], "objects": [{"name": "o", "keypoints": 3}]}, source=""
    )
    workspace = Workspace(tmp_path / "workspace")
    (recording,) = recordings_of(recipe.scenes, unpack=workspace.images)
    workspace.save_recording(recording)
    loaded = workspace.load_scene("cup")
    assert loaded == recording.scene
    assert loaded.frames[0].color.is_relative_to(workspace.root / "scenes/cup")
    assert read_depth_m(loaded, loaded.frames[5])[0, 0] == pytest.approx(0.705)


def test_depth_that_would_unpack_to_hundreds_of_megabytes_is_broken_and_takes_no_memory(
    tmp_path: Path,
) -> None:
    packing = zlib.compressobj(9)
    bomb = b"".join(packing.compress(bytes(2**20)) for _ in range(300)) + packing.flush()
    (tmp_path / "a.klg").write_bytes(struct.pack("<iqii", 1, 0, len(bomb), 0) + bomb)
    index = index_klg(tmp_path / "a.klg")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with (tmp_path / "a.klg").open("rb") as file:
        assert klg_depth_mm(file, index.entries[0], (640, 480)) is None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000, "kilobytes"
