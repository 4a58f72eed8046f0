"""Recordings that were cut off: in every format what is whole is kept and the loss is said."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import test_bop
import test_folders
import test_frames
import test_klg
import test_labelfusion
import test_rpl
import test_tum
import test_ycb_video
from phone_writers import write_nerfstudio, write_polycam, write_scanner_app
from recordings import LENS, poses
from software_camera import record
from test_phones import film

from rpl_data.formats.recordings.pose_lines import write_pose_lines
from rpl_data.recordings.open import READERS, UNPACKERS, open_scenes
from rpl_data.types import Recording

TIMES_S = [t * 1e-6 for t in test_klg.TIMES_US]
BAG = Path(__file__).parents[1] / "data" / "realsense.bag"


@dataclass(frozen=True)
class Case:
    """A small recording of a format.

    Attributes:
        make: writes it into an empty folder.
        pattern: of the colour images and of the depth images, below the folder.
        lists: files that list frames or poses, below the folder.
    """

    make: Callable[[Path], object]
    color: str
    depth: str
    lists: tuple[str, ...]
    camera: tuple[float, ...] | None = None


def make_folders(folder: Path) -> None:
    test_folders.make_folders(folder)
    np.savetxt(folder / "poses.txt", poses(6).reshape(-1, 16))


def make_rpl(folder: Path) -> None:
    test_rpl.make_tree(folder)


CASES = {
    "rpl": Case(make_rpl, "00/rgb/*", "00/depth/*", ("00/associations.txt", "00/camera.poses")),
    "frames": Case(test_frames.make_frames, "*.color.jpg", "*.depth.png", ("frame-000544.pose.txt",)),
    "tum": Case(
        test_tum.make_sequence, "rgb/*", "depth/*", ("rgb.txt", "depth.txt", "groundtruth.txt"), LENS
    ),
    "bop": Case(test_bop.make_scene, "rgb/*", "depth/*", ("scene_camera.json", "scene_gt.json")),
    "ycb_video": Case(test_ycb_video.make_sequence, "*-color.png", "*-depth.png", ("000004-meta.mat",)),
    "labelfusion": Case(
        test_labelfusion.make_log,
        "images/*_rgb.png",
        "images/*_depth.png",
        ("posegraph.posegraph", "images/0000000004_utime.txt"),
        LENS,
    ),
}
CASES |= {
    "folders": Case(make_folders, "rgb/*", "depth/*", ("poses.txt",)),
    "polycam": Case(
        partial(write_polycam, film=film(), start_us=10**8),
        "keyframes/corrected_images/*",
        "keyframes/depth/*",
        (),
    ),
    "scanner_app": Case(partial(write_scanner_app, film=film()), "frame_*.jpg", "depth_*.png", ()),
    "nerfstudio": Case(partial(write_nerfstudio, film=film()), "images/*", "depth/*", ()),
}
COLOR_ALONE_TELLS = ("frames", "ycb_video", "labelfusion", "scanner_app")
"""Formats in which nothing tells of a frame but its colour image."""
LISTS = [(name, path) for name, case in CASES.items() for path in case.lists]


def read(folder: Path, name: str) -> Recording:
    unpack = (folder.parent / "images").joinpath
    (recording,) = open_scenes(folder, name, camera=CASES[name].camera, unpack=unpack)
    return recording


def test_every_format_is_here() -> None:
    below = {"klg", "klg_bgr", "realsense"}
    elsewhere = {"ros", "kinect", "scannet", "zed", "record3d", "stray"}  # in the tests of their formats
    assert CASES.keys() | below | elsewhere == READERS.keys() | UNPACKERS.keys()


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("kind", ["color", "depth"])
@pytest.mark.parametrize("left", ["half", "nothing", "no file"])
def test_images_that_are_not_whole(name: str, kind: str, left: str, tmp_path: Path) -> None:
    case = CASES[name]
    case.make(tmp_path / "cut")
    before = read(tmp_path / "cut", name)
    images = sorted((tmp_path / "cut").glob(case.color if kind == "color" else case.depth))
    assert len(images) == len(before.scene.frames) > 3
    for image in images[-2:]:  # the last two: the one being written, and one the cache never wrote
        if left == "no file":
            image.unlink()
        else:
            image.write_bytes(image.read_bytes()[: image.stat().st_size // 2 if left == "half" else 0])
    recording = read(tmp_path / "cut", name)
    assert recording.scene.frames == before.scene.frames[:-2]
    assert before.trajectory is not None and recording.trajectory is not None
    np.testing.assert_array_equal(
        recording.trajectory.scene_from_camera, before.trajectory.scene_from_camera[:-2]
    )
    lost = [frame.index for frame in before.scene.frames[-2:]]
    if left == "no file" and kind == "color" and name in COLOR_ALONE_TELLS:
        return
    (line,) = recording.skipped
    assert line.startswith("2 frames with") and line.endswith(f": {lost[0]}, {lost[1]}")


@pytest.mark.parametrize(("name", "path"), LISTS, ids=lambda value: value)
def test_lists_that_end_in_the_middle_of_a_line(name: str, path: str, tmp_path: Path) -> None:
    """Wherever the file ends, what is read is right, at most the last two frames are lost, and it is said."""
    CASES[name].make(tmp_path / "cut")
    before = read(tmp_path / "cut", name)
    whole = (tmp_path / "cut" / path).read_bytes()
    assert before.trajectory is not None
    two_lines = len(b"".join(whole.splitlines(keepends=True)[-2:]))
    reach = 120 if path.endswith((".json", ".mat")) else min(two_lines, len(whole))
    for lost_bytes in range(1, reach, 5):
        (tmp_path / "cut" / path).write_bytes(whole[:-lost_bytes])
        after = read(tmp_path / "cut", name)
        assert len(after.scene.frames) >= len(before.scene.frames) - 2
        assert set(after.scene.frames) <= set(before.scene.frames)
        if len(after.scene.frames) < len(before.scene.frames):
            assert after.skipped or "was the list cut off?" in "".join(after.notes), f"{lost_bytes} bytes"
        if after.trajectory is None:  # the one file with poses is gone
            continue
        for index in after.trajectory.frames.tolist():
            np.testing.assert_allclose(after.trajectory.at(index), before.trajectory.at(index), atol=1e-6)


@pytest.mark.parametrize(
    "tail", [bytes(60), b"1.5 rgb/", b"\xff\xfe"], ids=["zeros", "half a line", "no text"]
)
def test_what_a_power_cut_leaves_behind_a_list(tail: bytes, tmp_path: Path) -> None:
    make_rpl(tmp_path)
    before = read(tmp_path, "rpl")
    path = tmp_path / "00/associations.txt"
    path.write_bytes(path.read_bytes() + tail)
    after = read(tmp_path, "rpl")
    assert after.scene.frames == before.scene.frames
    assert after.skipped == ("associations.txt was cut off in the middle of line 7, which is lost",)


def test_truth_that_is_cut_off_leaves_the_frames(tmp_path: Path) -> None:
    test_bop.make_scene(tmp_path)
    path = tmp_path / "scene_gt.json"
    path.write_text(path.read_text()[:-150])
    recording = read(tmp_path, "bop")
    assert len(recording.scene.frames) == 4 and len(recording.true_poses["obj_000005"]) == 3
    assert any("scene_gt.json was cut off or is damaged" in note for note in recording.notes)


# Recordings in one file ---------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.4, 0.7, 0.97])
@pytest.mark.parametrize("name", ["klg", "db3", "bag"])
def test_files_that_end_in_the_middle_of_a_frame(name: str, share: float, tmp_path: Path) -> None:
    whole = tmp_path / f"whole.{name}"
    if name == "klg":
        test_klg.make_log(whole)
        write_pose_lines(tmp_path / "cut.klg.freiburg", TIMES_S, poses(6))
    elif name == "db3":
        record(whole, 30)
    else:
        shutil.copy(BAG, whole)

    def unpack(scene: str) -> Path:
        return tmp_path / "images" / scene

    def frames_of(path: Path) -> Recording:
        format = "klg" if name == "klg" else "realsense"
        (recording,) = open_scenes(path, format, camera=LENS if name == "klg" else None, unpack=unpack)
        return recording

    before = frames_of(whole).scene.frames
    cut = tmp_path / f"cut.{name}"
    cut.write_bytes(whole.read_bytes()[: int(whole.stat().st_size * share)])
    after = frames_of(cut)
    kept = [frame.timestamp_s for frame in after.scene.frames]
    assert kept == [frame.timestamp_s for frame in before][: len(kept)]
    assert max(1, len(before) * (share - 0.35)) <= len(kept) < len(before) + (name == "bag")
    assert "cut off" in after.skipped[0]
