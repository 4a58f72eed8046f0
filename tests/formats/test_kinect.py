"""Azure Kinect recordings, in Matroska files made by hand: what k4arecorder writes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from kinect_writer import COLOR_LENS, JPEG, MODES, RED, WALL, calibration, recorded, write_mkv

from rpl_data.formats.containers.k4a_calibration import COLOR_MODES, DEPTH_MODES, k4a_calibration
from rpl_data.formats.containers.matroska import missing_bytes
from rpl_data.formats.recordings.kinect import read_mkv
from rpl_data.geometry import project, rays, transform
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import likely_formats, open_scenes
from rpl_data.types import DataError, Recording


def read(path: Path) -> Recording:
    return read_mkv(path.stem, path, path.parent / "unpacked", None, None)


def test_cameras_of_a_mode_are_those_of_the_makers_sdk() -> None:
    found = k4a_calibration(calibration(), DEPTH_MODES["NFOV_UNBINNED"], COLOR_MODES["1080P"], source="a")
    depth, color = found.depth, found.color
    np.testing.assert_allclose(
        [depth.cx, depth.cy, depth.fx, depth.fy], [332.064270, 325.880615, 503.927643, 503.978729], rtol=1e-6
    )
    np.testing.assert_allclose(
        [color.cx, color.cy, color.fx, color.fy], [953.284424, 555.142456, 904.141541, 903.521362], rtol=1e-6
    )
    np.testing.assert_allclose(depth.distortion[2:4], [0.000081, -0.000051], atol=1e-6)  # p1, p2
    assert color.distortion[4] == pytest.approx(1.632723) and (color.width, color.height) == (1920, 1080)


def test_the_sensor_of_16_by_9_lies_amid_that_of_4_by_3() -> None:
    lens = [
        *COLOR_LENS[:1],
        (COLOR_LENS[1] - 0.125) / 0.75,
        COLOR_LENS[2],
        COLOR_LENS[3] / 0.75,
        *COLOR_LENS[4:],
    ]
    early = calibration(lens, (4096, 2304))
    modes = DEPTH_MODES["NFOV_UNBINNED"], COLOR_MODES["720P"]
    assert k4a_calibration(early, *modes, source="a").color.cy == pytest.approx(
        k4a_calibration(calibration(), *modes, source="a").color.cy
    )


def test_colour_is_kept_and_depth_is_moved_onto_it(tmp_path: Path) -> None:
    path = recorded(tmp_path / "cup.mkv")
    assert likely_formats(path) == ["kinect"] and missing_bytes(path) == 0
    recording = read(path)
    scene = recording.scene
    assert (scene.name, scene.registered, recording.skipped) == ("cup", True, ())
    np.testing.assert_allclose([frame.timestamp_s for frame in scene.frames], [0, 0.033, 0.066])
    assert scene.frames[1].color.read_bytes() == JPEG
    depth_m = read_depth_m(scene, scene.frames[0])
    calibrated = k4a_calibration(
        calibration(), DEPTH_MODES["NFOV_2X2BINNED"], COLOR_MODES["720P"], source="a"
    )
    places = np.array([[20.0, 30.0], [160.0, 144.0], [290.0, 250.0]])
    points = transform(calibrated.color_from_depth, rays(calibrated.depth, places) * 0.8)
    for u, v in np.rint(project(calibrated.color, points)).astype(int):
        assert depth_m[v, u] == pytest.approx(0.804, abs=2e-4)  # the depth camera lies 4 mm before the other
    seen = depth_m[300:400, 500:800]
    assert (seen > 0).all(), "no gaps between pixels that are four times as large"
    assert depth_m[2, 2] == 0, "narrower than colour"


@pytest.mark.parametrize("format", ["NV12", "YUY2", "BGRA"])
def test_colour_that_is_not_packed(format: str, tmp_path: Path) -> None:
    if format == "BGRA":
        content = np.dstack([RED[..., ::-1], np.full(RED.shape[:2], 255, np.uint8)]).tobytes()
    else:
        y, cr, cb = cv2.cvtColor(RED[:1, :1], cv2.COLOR_RGB2YCrCb)[0, 0].astype(int)
        y = 16 + y * 219 // 255  # video range
        cb, cr = (128 + (value - 128) * 224 // 255 for value in (cb, cr))
        if format == "NV12":
            content = bytes([y]) * (1280 * 720) + bytes([cb, cr]) * (1280 * 720 // 4)
        else:
            content = bytes([y, cb, y, cr]) * (1280 * 720 // 2)
    recording = read(recorded(tmp_path / "a.mkv", 1, content, K4A_COLOR_MODE=f"{format}_720P"))
    np.testing.assert_allclose(read_color(recording.scene.frames[0])[100, 100], RED[0, 0], atol=6)


def test_pairs_by_time_and_the_delay_of_depth(tmp_path: Path) -> None:
    """Depth was taken 20 ms after colour on purpose; one of its images is missing, one is too short."""
    frames = [(33 * n, [(1, JPEG)]) for n in range(4)]
    depths = {0: WALL.tobytes(), 2: WALL.tobytes()[:-2], 3: WALL.tobytes()}
    frames += [(33 * n + 20, [(2, depth)]) for n, depth in depths.items()]
    frames.sort(key=lambda frame: frame[0])
    path = write_mkv(tmp_path / "a.mkv", frames, tags=MODES | {"K4A_DEPTH_DELAY_NS": "20000000"})
    recording = read(path)
    assert [frame.index for frame in recording.scene.frames] == [0, 3]
    assert recording.skipped == (
        "1 colour image without depth at the same time", "1 frame with a damaged image in the file: 2"
    )  # fmt: skip


def test_recordings_that_were_cut_off(tmp_path: Path) -> None:
    content = recorded(tmp_path / "whole.mkv", 4).read_bytes()
    kept = []
    for percent in (40, 70, 97):
        cut = tmp_path / f"cut{percent}.mkv"
        cut.write_bytes(content[: len(content) * percent // 100])
        recording = read(cut)
        kept.append(len(recording.scene.frames))
        assert "was cut off or never closed" in recording.skipped[0]
        for number, frame in enumerate(recording.scene.frames):
            assert read_depth_m(recording.scene, frame)[360, 640] == pytest.approx(
                0.804 + number / 1000, abs=2e-4
            )
    assert kept == [1, 2, 3]


def test_what_is_no_recording_of_a_kinect(tmp_path: Path) -> None:
    (tmp_path / "text.mkv").write_text("no video")
    with pytest.raises(DataError, match="is no Matroska file; expected a recording of an Azure Kinect"):
        read(tmp_path / "text.mkv")
    frames = [(0, [(1, JPEG), (2, WALL.tobytes())])]
    film = write_mkv(tmp_path / "film.mkv", frames, tags={}, names=("Main", "Other"))
    with pytest.raises(DataError, match="has the tracks MAIN, OTHER; expected COLOR and DEPTH"):
        read(film)
    lost = write_mkv(tmp_path / "lost.mkv", frames, tags=MODES, attached=b"")
    with pytest.raises(DataError, match="holds no calibration.json"):
        read(lost)
    spoilt = write_mkv(tmp_path / "spoilt.mkv", frames, tags=MODES, attached=b'{"CalibrationInformation": 3}')
    with pytest.raises(DataError, match=r"calibration.json is damaged or of another version"):
        read(spoilt)
    (recording,) = open_scenes(
        recorded(tmp_path / "good.mkv", 1),
        "kinect",
        unpack=lambda name: tmp_path / name,
        camera=(9e2, 9e2, 640.0, 360.0),
    )
    assert recording.scene.intrinsics.fx == 900
