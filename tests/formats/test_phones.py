"""Recordings of phones: axes, times, confidence, coarse depth; what is cut off; each format is recognised."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from phone_writers import (
    Film,
    write_nerfstudio,
    write_polycam,
    write_r3d,
    write_record3d_exr,
    write_scanner_app,
    write_stray,
)
from recordings import color_image, poses

from rpl_data.drift.reprojection import reprojection_over_gap
from rpl_data.formats.recordings.record3d import read_capture
from rpl_data.formats.recordings.stray import read_scan
from rpl_data.images import depth_reader, read_color, read_depth_m, read_depth_units, registered_units
from rpl_data.recordings.mend import Mend, mended
from rpl_data.recordings.open import likely_formats, open_recordings, open_scenes
from rpl_data.types import DataError, Recording, Trajectory
from rpl_data.workspace.depth_cache import cached_reader, pack
from rpl_data.workspace.workspace import Workspace

LENS = (50.0, 51.0, 31.5, 23.5)


def film(count: int = 6) -> Film:
    """Colour 64 x 48, depth 32 x 24; depth says which frame it is; the top rows are not to be trusted."""
    level = np.full((24, 32), 2, np.uint8)
    level[:8], level[8:16] = 0, 1
    depths = [np.full((24, 32), 0.7 + 0.01 * number, np.float32) for number in range(count)]
    colors = [color_image(number) for number in range(count)]
    return Film(colors, depths, poses(count), LENS, [level] * count)


def write_r3d_in(folder: Path, shot: Film) -> None:
    folder.mkdir(parents=True)
    write_r3d(folder / "a.r3d", shot)


WRITERS: dict[str, Callable[[Path, Film], None]] = {
    "stray": write_stray,
    "record3d": write_r3d_in,
    "record3d exr": write_record3d_exr,
    "polycam": write_polycam,
    "scanner_app": write_scanner_app,
    "nerfstudio": write_nerfstudio,
}
MARKED = [name for name in WRITERS if name not in ("record3d exr", "nerfstudio")]


def opened(folder: Path, name: str) -> Recording:
    """Read as `rpl` does: videos and packed depth in a process of their own."""
    (found,) = open_scenes(folder, name.split()[0], unpack=(folder.parent / "unpacked").joinpath)
    return found


def read(folder: Path, name: str) -> Recording:
    """Read in this process."""
    out = folder.parent / "unpacked/a"
    if name == "stray":
        return read_scan("a", folder, out, None, None)
    if name.startswith("record3d"):
        return read_capture("a", folder / ("EXR_RGBD" if "exr" in name else "a.r3d"), out, None, None)
    return opened(folder, name)


@pytest.mark.parametrize("name", WRITERS)
def test_what_the_twin_filmed(name: str, tiny_workspace: Workspace, tmp_path: Path) -> None:
    """Poses come back in OpenCV's axes, and depth of a fifth of the size agrees with them."""
    source = open_recordings(tiny_workspace.recording / "00")[0]
    scene, given = source.scene, source.trajectory
    assert given is not None
    camera = scene.intrinsics
    colors = [read_color(frame) for frame in scene.frames]
    depths = [read_depth_m(scene, frame)[2::5, 2::5] for frame in scene.frames]
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    WRITERS[name](tmp_path / "a", Film(colors, depths, given.scene_from_camera, lens))
    assert likely_formats(tmp_path / "a") == [name.split()[0]]
    found = opened(tmp_path / "a", name)
    assert found.trajectory is not None and found.scene.registered
    np.testing.assert_allclose(found.trajectory.scene_from_camera, given.scene_from_camera, atol=1e-5)

    def disagreement_m(poses: Trajectory) -> float:
        read = depth_reader(found.scene)
        return reprojection_over_gap(found.scene, poses, gap=2, read_depth=read).median_m

    turned = mended(found, Mend(opengl_cameras=True)).trajectory
    assert turned is not None
    assert disagreement_m(found.trajectory) < 0.004 < 5 * disagreement_m(found.trajectory)
    assert not disagreement_m(turned) < 5 * disagreement_m(found.trajectory)


@pytest.mark.parametrize("name", WRITERS)
def test_colour_depth_and_pose_of_a_frame_stay_together(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / "a", film())
    found = read(tmp_path / "a", name)
    assert found.trajectory is not None and len(found.scene.frames) == 6
    for number, frame in enumerate(found.scene.frames):
        depth_m = read_depth_m(found.scene, frame)
        assert depth_m.shape == (48, 64) and depth_m[40, 30] == pytest.approx(0.7 + 0.01 * number, abs=2e-4)
        assert read_color(frame)[24, 8].tolist() == pytest.approx([10 * number, 200, 0], abs=8)
        np.testing.assert_allclose(found.trajectory.at(frame.index), poses(6)[number], atol=1e-6)
    assert any("depth has 32 x 24 px, colour 64 x 48" in note for note in found.notes)


@pytest.mark.parametrize("name", MARKED)
def test_depth_of_low_confidence_is_left_out(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / "a", film())
    found = read(tmp_path / "a", name)
    depth_m = read_depth_m(found.scene, found.scene.frames[0])
    assert not depth_m[:14].any() and (depth_m[18:-1, 1:-1] > 0).all()  # 0 is dropped, 1 and 2 stay
    assert "depth of low confidence is left out" in found.notes


def test_coarse_depth_is_cached_as_it_is_and_exported_at_the_colour_pixels(tmp_path: Path) -> None:
    write_scanner_app(tmp_path / "a", film())
    scene = read(tmp_path / "a", "scanner_app").scene
    frame, expected = scene.frames[3], read_depth_m(scene, scene.frames[3])
    for _ in range(2):  # from the recording, then from the cache
        np.testing.assert_array_equal(cached_reader(tmp_path / "cache", scene, keep=True)(frame), expected)
    (cached,) = (tmp_path / "cache").iterdir()
    assert cached.read_bytes() == pack(read_depth_units(scene, frame))
    assert read_depth_units(scene, frame).shape == (24, 32)
    np.testing.assert_array_equal(registered_units(scene, frame), np.rint(expected / 0.001))


def test_times_are_those_of_the_app(tmp_path: Path) -> None:
    starts = {"stray": 100.0, "record3d": 5.0, "polycam": 99.9, "scanner_app": 40.0, "nerfstudio": 0.0}
    for name, start_s in starts.items():
        WRITERS[name](tmp_path / name / "a", film(3))
        first, second, _ = read(tmp_path / name / "a", name).scene.frames
        steps = {"polycam": 0.2, "nerfstudio": 1 / 30}
        assert first.timestamp_s == pytest.approx(start_s)
        assert second.timestamp_s - first.timestamp_s == pytest.approx(steps.get(name, 1 / 60), abs=2e-6)


# Stray Scanner ------------------------------------------------------------------------------------


def test_stray_columns_are_found_by_name_and_dropped_frames_said(tmp_path: Path) -> None:
    write_stray(tmp_path / "a", film())
    path = tmp_path / "a/odometry.csv"
    header, *rows = path.read_text().splitlines()
    newer = [f"{header}, fx, fy", *(f"{row}, 50, 51" for row in rows)]
    path.write_text("\n".join([*newer[:4], *newer[5:]])[:-30])  # frame 3 is lost, the last line cut off
    (tmp_path / "a/depth/000001.png").unlink()
    (tmp_path / "a/depth/000009.png").write_bytes((tmp_path / "a/depth/000002.png").read_bytes())
    (tmp_path / "a/confidence/000002.png").write_bytes(b"")
    found = read_scan("a", tmp_path / "a", tmp_path / "out", None, None)
    assert [frame.index for frame in found.scene.frames] == [0, 4]
    assert found.skipped == (
        "1 frame of the video without a depth image: 1",
        "1 frame with a damaged depth or confidence image: 2",
        "1 frame of the depth images beyond the end of the video: 9",
        "2 frames without a pose: 3, 5",
    )


def test_stray_without_its_columns_is_refused(tmp_path: Path) -> None:
    write_stray(tmp_path / "a", film())
    (tmp_path / "a/odometry.csv").write_text("t,px,py\n1,2,3\n")
    with pytest.raises(DataError, match="expected a first line with timestamp, frame, x, y, z"):
        read_scan("a", tmp_path / "a", tmp_path / "out", None, None)


@pytest.mark.parametrize("share", [0.4, 0.7, 0.97])
def test_a_video_that_was_cut_off(share: float, tmp_path: Path) -> None:
    """With its index first, what is whole is read; with its index last, as phones write, it is said."""
    noise = [np.random.default_rng(n).integers(0, 255, (48, 64, 3), np.uint8) for n in range(30)]
    shot = Film(noise, [np.full((24, 32), 0.7, np.float32)] * 30, poses(30), LENS)
    for first in (True, False):
        folder = tmp_path / f"{first}"
        write_stray(folder, shot, faststart=first)
        content = (folder / "rgb.mp4").read_bytes()
        (folder / "rgb.mp4").write_bytes(content[: int(len(content) * share)])
        if not first:
            with pytest.raises(DataError, match="its index is lost"):
                read_scan("a", folder, tmp_path / "out", None, None)
            continue
        found = read_scan("a", folder, tmp_path / "out", None, None)
        kept = len(found.scene.frames)
        assert 30 * (share - 0.35) < kept < 30
        assert [frame.index for frame in found.scene.frames] == list(range(kept))
        assert any(f"{30 - kept} frame" in line and "beyond the end" in line for line in found.skipped)


# Record3D -----------------------------------------------------------------------------------------


def test_record3d_takes_the_median_of_a_lens_that_focuses(tmp_path: Path) -> None:
    shot = replace(film(), lens=(500.0, 510.0, 31.5, 23.5))
    write_r3d(tmp_path / "a.r3d", shot)
    found = read_capture("a", tmp_path / "a.r3d", tmp_path / "out", None, None)
    assert found.scene.intrinsics.fx == pytest.approx(500.05)
    assert not any("focus" in note for note in found.notes)  # it changes by less than a pixel


@pytest.mark.parametrize("share", [0.4, 0.7, 0.97])
def test_a_capture_that_was_cut_off(share: float, tmp_path: Path) -> None:
    noise = [np.random.default_rng(n).uniform(0.6, 0.8, (24, 32)).astype(np.float32) for n in range(20)]
    write_r3d(tmp_path / "a.r3d", Film([color_image(n) for n in range(20)], noise, poses(20), LENS))
    content = (tmp_path / "a.r3d").read_bytes()
    (tmp_path / "a.r3d").write_bytes(content[: int(len(content) * share)])
    found = read_capture("a", tmp_path / "a.r3d", tmp_path / "out", None, None)
    kept = [frame.index for frame in found.scene.frames]
    assert kept == list(range(len(kept))) and 20 * (share - 0.15) < len(kept) <= 20
    assert "a.r3d was cut off" in found.skipped[0]


def test_record3d_reads_the_folder_that_it_unpacks_to(tmp_path: Path) -> None:
    write_r3d(tmp_path / "b.r3d", film())
    shutil.unpack_archive(tmp_path / "b.r3d", tmp_path / "a", "zip")
    (tmp_path / "a/rgbd/3.depth").write_bytes(b"bvx2 and then nothing")
    assert likely_formats(tmp_path / "a") == ["record3d"]
    found = read_capture("a", tmp_path / "a", tmp_path / "out", None, None)
    assert [frame.index for frame in found.scene.frames] == [0, 1, 2, 4, 5]
    assert found.skipped == ("1 frame with a damaged colour, depth or confidence image: 3",)


def test_depth_that_claims_a_size_it_has_not_is_refused(tmp_path: Path) -> None:
    write_r3d_in(tmp_path / "a", film())
    shutil.unpack_archive(tmp_path / "a/a.r3d", tmp_path / "b", "zip")
    said = json.loads((tmp_path / "b/metadata").read_text())
    (tmp_path / "b/metadata").write_text(json.dumps(said | {"dw": 10**6, "dh": 10**6}))
    with pytest.raises(DataError, match="images of 1000000 x 1000000 px"):
        read_capture("b", tmp_path / "b", tmp_path / "out", None, None)
    (tmp_path / "b/metadata").write_text(json.dumps(said | {"dw": 33}))
    with pytest.raises(DataError, match="holds no frame"):
        read_capture("b", tmp_path / "b", tmp_path / "out", None, None)


# Polycam, 3D Scanner App, nerfstudio ---------------------------------------------------------------


@pytest.mark.parametrize("name", ["polycam", "stray"])
def test_an_empty_folder_of_confidence_marks_nothing(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / "a", film())
    whole = len(read(tmp_path / "a", name).scene.frames)
    for image in (tmp_path / "a").glob("**/confidence/*"):
        image.unlink()
    found = read(tmp_path / "a", name)
    assert len(found.scene.frames) == whole and not any("low confidence" in note for note in found.notes)


def test_polycam_prefers_what_it_corrected(tmp_path: Path) -> None:
    write_polycam(tmp_path / "a", replace(film(), lens=(40.0, 40.0, 31.5, 23.5)), prefix="")
    found = read(tmp_path / "a", "polycam")
    assert found.scene.intrinsics.fx == 40 and "uncorrected" in " ".join(found.notes)
    write_polycam(tmp_path / "a", film())
    (tmp_path / "a/keyframes/corrected_cameras/99900000.json").write_text('{"fx": 50')
    found = read(tmp_path / "a", "polycam")
    assert found.scene.intrinsics.fx == 50 and found.scene.frames[0].color.parent.name == "corrected_images"
    assert "1 frame with a camera file that is damaged: 0" in found.skipped


def test_scanner_app_has_images_of_some_frames_only(tmp_path: Path) -> None:
    write_scanner_app(tmp_path / "a", film())
    for number in (1, 2, 4):
        (tmp_path / f"a/frame_{number:05d}.jpg").unlink()
    found = read(tmp_path / "a", "scanner_app")
    assert [frame.index for frame in found.scene.frames] == [0, 3, 5]
    assert any(note.startswith("3 frames without a colour image") for note in found.notes)


def test_nerfstudio_units_scale_and_names_without_suffix(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path / "a", film())
    path = tmp_path / "a/transforms.json"
    said = json.loads(path.read_text())
    for frame in said["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".jpg")
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] *= 4
        frame["transform_matrix"] = matrix.tolist()
    del said["frames"][0]["depth_file_path"]
    path.write_text(json.dumps(said | {"applied_scale": 4.0, "depth_unit_scale_factor": 0.002}))
    found = read(tmp_path / "a", "nerfstudio")
    assert len(found.scene.frames) == 5 and found.scene.metres_per_unit == 0.002
    assert found.trajectory is not None
    np.testing.assert_allclose(found.trajectory.at(4), poses(6)[4], atol=1e-9)
    assert "1 frame of the list without depth_file_path" in found.skipped


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "camera model is OPENCV_FISHEYE"),
        ({"k4": 0.1}, "k4 of the lens cannot be read"),
        ({"frames": [{"file_path": "a"}]}, "names no depth image"),
        ({"frames": 3}, "export it again"),
        ({"w": 60, "h": 60}, "camera is for images of 60 x 60 px"),
    ],
)
def test_what_nerfstudio_files_may_not_say(change: dict[str, object], message: str, tmp_path: Path) -> None:
    write_nerfstudio(tmp_path / "a", film())
    path = tmp_path / "a/transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DataError, match=message):
        read(tmp_path / "a", "nerfstudio")


def test_a_camera_for_images_of_twice_the_size_is_halved(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path / "a", film())
    path = tmp_path / "a/transforms.json"
    bigger = {"fl_x": 100, "fl_y": 102, "cx": 64, "cy": 48, "w": 128, "h": 96}
    path.write_text(json.dumps(json.loads(path.read_text()) | bigger))
    camera = read(tmp_path / "a", "nerfstudio").scene.intrinsics
    assert (camera.fx, camera.cx, camera.width) == (50, 31.5, 64)


# One truth per fact -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["polycam", "scanner_app", "nerfstudio"])
def test_a_camera_file_beside_a_recording_says_the_unit(name: str, tmp_path: Path) -> None:
    """It is believed, also above the scene; where the recipe says something else, that is an error."""
    WRITERS[name](tmp_path / "scenes/a", film())
    (tmp_path / "scenes/camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.002\n")
    (found,) = open_recordings(tmp_path / "scenes/a", unpack=tmp_path / "images")
    assert found.scene.metres_per_unit == 0.002
    with pytest.raises(DataError, match=r"camera.txt says 0.002 m per unit of depth, but metres_per_unit of"):
        open_recordings(tmp_path / "scenes/a", unpack=tmp_path / "images", metres_per_unit=0.001)
    (tmp_path / "scenes/camera.txt").write_text("60 51 31.5 23.5\n")
    with pytest.raises(DataError, match=r"says fx fy cx cy = 50 51 31.5 23.5, but .*camera.txt says 60 51"):
        open_recordings(tmp_path / "scenes/a", unpack=tmp_path / "images")
    (found,) = open_recordings(tmp_path / "scenes/a", unpack=tmp_path / "images", camera=LENS)
    assert found.scene.intrinsics.fx == 50


def test_a_camera_file_beside_a_scan_or_a_capture(tmp_path: Path) -> None:
    write_stray(tmp_path / "a", film())
    (tmp_path / "camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.002\n")
    assert read_scan("a", tmp_path / "a", tmp_path / "out", None, None).scene.metres_per_unit == 0.002
    write_r3d(tmp_path / "a.r3d", film())  # whose depth is in metres
    with pytest.raises(DataError, match=r"says 1 m per unit of depth, but .*camera.txt says 0.002"):
        read_capture("a", tmp_path / "a.r3d", tmp_path / "out", None, None)
    (tmp_path / "camera.txt").write_text("50.1 51 31.5 23.5\nmetres_per_unit 1\n")
    read_capture("a", tmp_path / "a.r3d", tmp_path / "out", None, None)
    with pytest.raises(DataError, match=r"camera.txt says 1 m per unit of depth, but metres_per_unit of"):
        read_capture("a", tmp_path / "a.r3d", tmp_path / "out", 0.001, None)


def test_a_unit_in_transforms_json_and_another_in_the_camera_file(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path / "a", film())
    path = tmp_path / "a/transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"depth_unit_scale_factor": 0.002}))
    (tmp_path / "a/camera.txt").write_text("50 51 31.5 23.5\nmetres_per_unit 0.001\n")
    with pytest.raises(DataError, match=r"says 0.002 m per unit of depth, but .*camera.txt says 0.001"):
        open_recordings(tmp_path / "a", unpack=tmp_path / "images")
