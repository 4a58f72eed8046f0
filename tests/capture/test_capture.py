"""`rpl capture` with a camera made of software: what it sends is on the disk, and what is lost is said."""

from __future__ import annotations

import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyrealsense2 as rs
import pytest
from software_camera import HEIGHT, WIDTH, SoftwareCamera, color_pixels, depth_pixels

from rpl_data.capture import live
from rpl_data.capture.camera import Shot, Wanted
from rpl_data.capture.disk import SceneWriter, write_shot
from rpl_data.capture.exposure import lock
from rpl_data.capture.live import Captured, CaptureOptions, capture
from rpl_data.capture.preview import Preview, side_by_side
from rpl_data.capture.realsense import RealSenseControls, choices_of, connected_camera, open_device
from rpl_data.cli.capture import next_scene, record_scene, stopped_by_ctrl_c
from rpl_data.cli.main import main
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError

QUICK = CaptureOptions(seconds=1.0, countdown_s=0, exposure="auto")
WANTED = Wanted((WIDTH, HEIGHT), 30)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "WARM_UP_S", 0.1)


@contextmanager
def filming(
    camera: SoftwareCamera,
    *,
    until: int = 10**9,
    skip: Callable[[int], bool] = lambda number: False,
    depth: Callable[[int], np.ndarray] = depth_pixels,
) -> Iterator[None]:
    """The camera sends pairs three times as fast as their timestamps say, until it is unplugged."""
    done = threading.Event()

    def run() -> None:
        number = 0
        while number < until and not done.wait(1 / 100):
            time_ms = 1000 + number * 100 / 3
            if not skip(number):
                camera.send("color", number + 1, time_ms, color_pixels(number % 50))
                camera.send("depth", number + 1, time_ms + 2, depth(number))
            number += 1

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def captured_of(camera: SoftwareCamera, out: Path, said: list[str] | None = None, **more: Any) -> Captured:
    options = replace(QUICK, **{key: more.pop(key) for key in ("seconds",) if key in more})
    with open_device(camera.device, WANTED) as streams:
        return capture(streams, out, more.pop("scene", "00"), options, say=(said or []).append, **more)


def test_what_the_camera_sends_comes_back_exactly(tmp_path: Path) -> None:
    camera = SoftwareCamera(
        unit_m=0.0005, model=rs.distortion.brown_conrady, coeffs=(0.1, -0.2, 0.001, 0.002, 0.05)
    )
    with filming(camera):
        captured = captured_of(camera, tmp_path / "cup")
    assert captured.losses == ()
    (recording,) = open_scenes(tmp_path / "cup", "rpl")
    scene = recording.scene
    assert (scene.name, scene.metres_per_unit, scene.registered) == ("00", 0.0005, True)
    assert scene.intrinsics.distortion == pytest.approx((0.1, -0.2, 0.001, 0.002, 0.05), abs=1e-7)
    assert len(scene.frames) == captured.frames == 30
    assert captured.seconds == pytest.approx(29 / 30, abs=1e-3)
    for frame in scene.frames:
        number = round((frame.timestamp_s - 1) * 30)
        raw = depth_pixels(number).astype(np.float32)
        np.testing.assert_array_equal(read_depth_m(scene, frame), raw * np.float32(0.0005))
        assert np.abs(read_color(frame).astype(int) - color_pixels(number % 50)).mean() < 4
    assert "recorded by Software Camera 0815" in (tmp_path / "cup/00/capture.txt").read_text()


def test_depth_is_aligned_to_colour_while_filming(tmp_path: Path) -> None:
    """The colour camera is 10 cm to the left: at 0.77 m everything lies 7.8 px further right."""

    def plane(number: int) -> np.ndarray:
        depth = np.full((HEIGHT, WIDTH), 770, np.uint16)
        depth[10:20, 20:30] = 0
        return depth

    camera = SoftwareCamera(apart_m=0.1)
    with filming(camera, depth=plane):
        captured = captured_of(camera, tmp_path)
    assert captured.frames == 30
    scene = open_scenes(tmp_path, "rpl")[0].scene
    for frame in (scene.frames[0], scene.frames[-1]):
        depth_m = read_depth_m(scene, frame)
        assert not depth_m[:, :7].any()  # what only the colour camera sees
        assert not depth_m[11:19, 29:37].any()
        np.testing.assert_allclose(depth_m[25:, 9:], 0.77, atol=1e-6)


def test_the_doctor_reads_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A near half and a far half, whose border is that of the colours."""

    def halves(number: int) -> np.ndarray:
        return depth_pixels(number) // 40 + np.where(np.arange(WIDTH) < WIDTH // 2, 700, 900).astype(
            np.uint16
        )

    camera = SoftwareCamera()
    with filming(camera, depth=halves):
        captured_of(camera, tmp_path)
    assert main(["check", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "depth unit, intrinsics and poses (no poses); no fault in the rest" in " ".join(out.split()), out


def test_a_camera_that_is_unplugged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "PATIENCE_S", 1.0)
    camera = SoftwareCamera()
    with filming(camera, until=60):
        captured = captured_of(camera, tmp_path, seconds=60.0)
    (loss,) = captured.losses
    assert "the camera was unplugged or hung after" in loss and "what came before is kept" in loss
    (recording,) = open_scenes(tmp_path, "rpl")
    assert recording.skipped == ()
    assert len(recording.scene.frames) == captured.frames > 20
    assert round((recording.scene.frames[-1].timestamp_s - 1) * 30) == 59


def test_a_camera_that_sends_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "PATIENCE_S", 0.3)
    with pytest.raises(DataError, match="sends no colour with depth .* plug it in again"):
        captured_of(SoftwareCamera(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_frames_lost_on_the_way_are_said_at_once_and_at_the_end(tmp_path: Path) -> None:
    camera, said = SoftwareCamera(), ["start"]
    with filming(camera, skip=lambda number: number % 10 in (3, 4)):
        captured = captured_of(camera, tmp_path, said)
    (loss,) = captured.losses
    lost = int(loss.split()[0])
    assert lost in (4, 6, 8) and "lost between camera and computer" in loss
    assert sum("losing frames" in line for line in said) >= 2
    assert loss in (tmp_path / "00/capture.txt").read_text()


def a_shot(number: int) -> Shot:
    return Shot(number, number / 30, color_pixels(number), depth_pixels(number))


def test_a_disk_that_is_too_slow_drops_and_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rpl_data.capture.disk.QUEUE_BYTES", 6)
    gate = threading.Event()

    def slow(folder: Path, index: int, shot: Shot) -> tuple[Path, Path]:
        gate.wait(10)
        return write_shot(folder, index, shot)

    with SceneWriter(tmp_path / "00", frame_bytes=1, write=slow) as writer:
        kept = [writer.add(a_shot(number)) for number in range(10)]
        assert (tmp_path / "00/associations.txt").read_text() == ""
        gate.set()
    assert kept == [True] * 6 + [False] * 4
    assert (writer.listed, writer.dropped) == (6, 4)
    lines = (tmp_path / "00/associations.txt").read_text().splitlines()
    assert [float(line.split()[0]) for line in lines] == pytest.approx([n / 30 for n in range(6)], abs=1e-6)
    assert lines[5].endswith("depth/000005.png 0.166667 rgb/000005.jpg")


def test_a_full_disk_ends_the_recording_and_keeps_what_is_whole(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    """The list of frames grows until it does not fit any more, in the middle of a line."""
    camera = SoftwareCamera()
    with filming(camera), full_disk(7000):
        captured = captured_of(camera, tmp_path, seconds=60.0)
    (loss,) = captured.losses
    assert loss.startswith("recording ended early: cannot write") and "associations.txt" in loss
    (recording,) = open_scenes(tmp_path, "rpl")
    assert len(recording.scene.frames) == captured.frames > 100
    assert recording.skipped == ()


def test_ctrl_c_ends_a_recording_well(tmp_path: Path) -> None:
    import signal

    camera = SoftwareCamera()
    before = signal.getsignal(signal.SIGINT)

    def press(shot: Shot, word: str) -> None:
        if word.startswith("recording") and word.endswith(" 9 frames"):
            signal.raise_signal(signal.SIGINT)

    with filming(camera), stopped_by_ctrl_c() as stop:
        captured = captured_of(camera, tmp_path, seconds=None, show=press, stop=stop)
    assert captured.frames == 9 and captured.losses == ()
    assert signal.getsignal(signal.SIGINT) is before


def test_scenes_share_one_camera(tmp_path: Path) -> None:
    camera = SoftwareCamera()
    with filming(camera):
        record_scene(open_device(camera.device, WANTED), tmp_path, None, QUICK, preview_port=None)
        assert next_scene(tmp_path) == "01"
        captured_of(camera, tmp_path, scene="01")
        with pytest.raises(DataError, match="01 already exists; choose another --scene"):
            captured_of(camera, tmp_path, scene="01")
    assert [found.scene.name for found in open_scenes(tmp_path, "rpl")] == ["00", "01"]
    other = SoftwareCamera(unit_m=0.0001)
    with filming(other), pytest.raises(DataError, match="camera.txt is of another camera or image size"):
        captured_of(other, tmp_path, scene="02")
    assert not (tmp_path / "02").exists()


def test_no_camera_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert rs.context().query_devices().size() == 0
    assert main(["capture", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "no RealSense camera is connected; plug it into a USB 3 port" in error
    assert not (tmp_path / "out").exists()
    with pytest.raises(DataError, match="no RealSense camera"):
        connected_camera("0815")


def test_a_size_the_camera_does_not_have() -> None:
    with pytest.raises(DataError, match=r"does not give 640x480 .* at 30 Hz; it has 64x48 at 30"):
        choices_of(SoftwareCamera().device, 640, 480, 30)


# Exposure -----------------------------------------------------------------------------------------


class Sensor:
    """A colour sensor whose images are as bright as exposure and gain make them; it hides its automatic."""

    limits = {
        rs.option.enable_auto_exposure: (0, 1, 1),
        rs.option.exposure: (1, 10000, 1), rs.option.gain: (0, 128, 1),
        rs.option.enable_auto_white_balance: (0, 1, 1), rs.option.white_balance: (2800, 6500, 10),
    }  # fmt: skip

    def __init__(self, light: float, found_k: float = 3600) -> None:
        self.light, self.found_k = light, found_k
        self.values = {rs.option.exposure: 156.0, rs.option.gain: 64.0, rs.option.white_balance: 4600.0}
        self.values |= {rs.option.enable_auto_exposure: 1.0, rs.option.enable_auto_white_balance: 1.0}

    def supports(self, option: Any) -> bool:
        return option in self.values

    def get_option(self, option: Any) -> float:
        return self.values[option]

    def set_option(self, option: Any, value: float) -> None:
        low, high, _ = self.limits[option]
        assert low <= value <= high
        self.values[option] = value

    def get_option_range(self, option: Any) -> Any:
        found = rs.option_range()
        found.min, found.max, found.step = self.limits[option]
        return found

    def mean_color(self) -> np.ndarray:
        energy = self.values[rs.option.exposure] * (1 + self.values[rs.option.gain] / 16) * self.light
        automatic = self.values[rs.option.enable_auto_exposure]
        mean = 110.0 if automatic else min(255.0, 110 * energy ** (1 / 2.2))
        fixed_k = self.values[rs.option.white_balance]
        kelvin = self.found_k if self.values[rs.option.enable_auto_white_balance] else fixed_k
        return mean * np.array([kelvin / 4600, 1.0, 4600 / kelvin])


@pytest.mark.parametrize("light", [1 / 30, 1 / 800, 1 / 2500], ids=["bright", "room", "dim"])
def test_a_locked_exposure_is_as_bright_as_the_automatic(light: float) -> None:
    sensor = Sensor(light)
    before = sensor.mean_color()
    exposure, balance = lock(RealSenseControls(sensor), sensor.mean_color, rate_hz=30)
    assert sensor.values[rs.option.enable_auto_exposure] == 0
    assert sensor.values[rs.option.exposure] <= 333  # 1/30 s, else frames come more slowly
    np.testing.assert_allclose(sensor.mean_color(), before, rtol=0.1)
    assert exposure.startswith("locked exposure")
    assert balance == f"locked white balance {sensor.values[rs.option.white_balance]:g} K"
    assert sensor.values[rs.option.white_balance] == pytest.approx(3600, abs=60)


def test_an_exposure_that_cannot_be_matched_stays_automatic() -> None:
    sensor = Sensor(light=1 / 60_000)
    lines = lock(RealSenseControls(sensor), sensor.mean_color, rate_hz=30)
    assert "stays automatic" in lines[0] and "more light helps" in lines[0]
    assert sensor.values[rs.option.enable_auto_exposure] == 1


def test_a_camera_that_refuses_films_on() -> None:
    class Refusing(Sensor):
        def set_option(self, option: Any, value: float) -> None:
            if option == rs.option.white_balance:
                raise RuntimeError("hwmon command failed")
            super().set_option(option, value)

    sensor = Refusing(light=1 / 800)
    (line,) = lock(RealSenseControls(sensor), sensor.mean_color, rate_hz=30)
    assert line == "the camera refused to hold exposure or white balance: hwmon command failed"


def test_the_exposure_is_locked_while_the_camera_films(tmp_path: Path) -> None:
    """The software camera has neither option: that is said, and it films on."""
    camera, said = SoftwareCamera(), ["start"]
    options = replace(QUICK, exposure="lock", countdown_s=1)
    with filming(camera), open_device(camera.device, WANTED) as streams:
        capture(streams, tmp_path, "00", options, say=said.append)
    assert "exposure cannot be locked on this camera" in said
    assert said.index("recording in 1") < said.index(f"recording to {tmp_path / '00'}")


# Preview ------------------------------------------------------------------------------------------


def test_the_preview_shows_colour_and_depth() -> None:
    import socket

    import cv2

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with Preview(port) as page:
        with pytest.raises(DataError, match=f"port {port}: .*; choose another --port"), Preview(port):
            pass
        page.show(a_shot(3), "recording 0.1 s")
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            try:
                assert "/stream" in urllib.request.urlopen(page.url).read().decode()
                break
            except OSError:
                time.sleep(0.05)
        assert urllib.request.urlopen(page.url + "word").read() == b"recording 0.1 s"
        with urllib.request.urlopen(page.url + "stream") as stream:
            content = b""
            while b"\xff\xd9" not in content:
                content += stream.read1()
        jpeg = np.frombuffer(content[content.index(b"\xff\xd8") :], np.uint8)
        assert cv2.imdecode(jpeg, cv2.IMREAD_COLOR).shape == (360, 960, 3)
        foreign = urllib.request.Request(page.url, headers={"Host": "evil.example"})
        with pytest.raises(urllib.error.HTTPError, match="400"):
            urllib.request.urlopen(foreign)


def test_near_is_red_far_is_blue_and_none_is_black() -> None:
    depth = np.full((HEIGHT, WIDTH), 300, np.uint16)
    depth[:, 20:40], depth[:, 40:] = 1900, 0
    painted = side_by_side(np.zeros((HEIGHT, WIDTH, 3), np.uint8), depth, 0.001)[:, 480:].astype(int)
    near, far = painted[100, 50], painted[100, 220]
    assert near[0] > near[2] + 50 and far[2] > far[0]
    assert not painted[100, 400].any()
