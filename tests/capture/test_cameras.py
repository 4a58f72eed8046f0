"""`rpl capture --camera ...` with a device made of software for each maker's package."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import software_k4a
import software_oak
import software_orbbec
import software_phone
from software_camera import HEIGHT, WIDTH, color_pixels, depth_pixels
from software_k4a import SoftwareKinect
from software_oak import SoftwareOak
from software_orbbec import SoftwareOrbbec
from software_phone import SoftwarePhone

from rpl_data.capture import CAMERAS, live
from rpl_data.capture.camera import Wanted
from rpl_data.capture.exposure import lock
from rpl_data.capture.k4a import KinectControls
from rpl_data.capture.live import Captured, CaptureOptions, capture
from rpl_data.capture.orbbec import OrbbecControls
from rpl_data.cli.main import main
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError


@dataclass(frozen=True)
class Maker:
    """What a test knows of a camera: how it is made, and what its recording must say."""

    software: Any
    size: tuple[int, int] | None
    lens: tuple[float, ...]
    distortion: tuple[float, ...]
    unit_m: float
    depth: Any
    told: str


BENT = (0.5, -2.5, 0.001, 0.002, 1.5, 0.25, -2.25, 1.25)
SMALL = (WIDTH, HEIGHT)
MAKERS = {
    "oak": Maker(SoftwareOak, SMALL, (60, 61, 31.25, 23.75), (), 0.001, depth_pixels, "OAK-D 14442C10D1"),
    "orbbec": Maker(
        SoftwareOrbbec, SMALL, (60, 61, 31.25, 23.75), BENT, 0.0005, depth_pixels, "Gemini CP0001"
    ),
    "k4a": Maker(
        SoftwareKinect,
        None,
        (605.5, 605.25, 638.25, 366.5),
        BENT,
        0.001,
        lambda number: software_k4a.depth_mm(number % 50),
        "Azure Kinect 000123",
    ),
}
PACKAGES = {"oak": "depthai", "orbbec": "pyorbbecsdk", "k4a": "pyk4a", "phone": "record3d"}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "WARM_UP_S", 0.05)
    monkeypatch.setattr(live, "PATIENCE_S", 0.5)
    monkeypatch.setattr("rpl_data.capture.camera.FIRST_SHOT_S", 0.5)


def plugged_in(monkeypatch: pytest.MonkeyPatch, device: Any) -> Any:
    """Make the module of a software device the one that is installed."""
    monkeypatch.setitem(sys.modules, device.module.__name__, device.module)
    return device


def recorded(camera: Any, out: Path, said: list[str], *, wanted: Wanted, seconds: float = 0.25) -> Captured:
    options = CaptureOptions(seconds=seconds, countdown_s=0, exposure="auto")
    with CAMERAS[camera](wanted) as streams:
        return capture(streams, out, "00", options, say=said.append)


@pytest.mark.parametrize("name", MAKERS)
def test_what_a_camera_sends_comes_back_exactly(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unit, intrinsics and distortion as the camera says, depth at the colour pixels, times on its clock."""
    maker = MAKERS[name]
    plugged_in(monkeypatch, maker.software())
    size = [] if maker.size is None else ["--width", str(maker.size[0]), "--height", str(maker.size[1])]
    out = tmp_path / "cup"
    asked = ["--seconds", "0.25", "--countdown", "0", "--exposure", "auto", "--camera", name, *size]
    assert main(["capture", str(out), *asked]) == 0
    (recording,) = open_scenes(out, "rpl")
    scene, lens = recording.scene, recording.scene.intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == maker.lens
    assert lens.distortion == maker.distortion
    assert (lens.width, lens.height) == (maker.size or software_k4a.SIZE)
    assert (scene.metres_per_unit, scene.depth_camera) == (maker.unit_m, None)
    assert len(scene.frames) == 8 and recording.skipped == ()
    for frame in scene.frames[::3]:
        number = round((frame.timestamp_s - 1) * 30)
        assert frame.timestamp_s == pytest.approx(1 + number / 30, abs=1e-5)
        raw = maker.depth(number).astype(np.float32)
        np.testing.assert_array_equal(read_depth_m(scene, frame), raw * np.float32(maker.unit_m))
        assert abs(read_color(frame)[..., 0].mean() - 5 * (number % 50)) < 4
    assert (out / "00/capture.txt").read_text().startswith(f"recorded by {maker.told}\n")


@pytest.mark.parametrize("name", MAKERS)
def test_lost_images_are_said(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    maker, said = MAKERS[name], ["start"]
    plugged_in(monkeypatch, maker.software(lost=lambda number: number % 10 in (3, 4)))
    captured = recorded(name, tmp_path, said, wanted=Wanted(maker.size), seconds=1.0)
    (loss,) = captured.losses
    assert int(loss.split()[0]) in (4, 6) and "lost between camera and computer" in loss
    assert any("losing frames" in line for line in said)


@pytest.mark.parametrize("name", [*MAKERS, "phone"])
def test_unplugging_keeps_what_came_before(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    software = SoftwarePhone if name == "phone" else MAKERS[name].software
    plugged_in(monkeypatch, software(until=45))
    wanted = Wanted(None if name == "phone" else MAKERS[name].size)
    captured = recorded(name, tmp_path, [], wanted=wanted, seconds=60.0)
    assert captured.losses[0].startswith("the camera was unplugged or hung after")
    (recording,) = open_scenes(tmp_path, "rpl")
    assert recording.skipped == () and len(recording.scene.frames) == captured.frames > 5


@pytest.mark.parametrize("name", [*MAKERS, "phone"])
def test_a_package_that_is_not_installed_is_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Missing:
        def find_spec(self, found: str, path: object = None, target: object = None) -> None:
            if found == PACKAGES[name]:
                raise ModuleNotFoundError(f"No module named {found!r}", name=found)

    monkeypatch.delitem(sys.modules, PACKAGES[name], raising=False)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    assert main(["capture", str(tmp_path / "out"), "--camera", name]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"need the package {PACKAGES[name]}, which is not installed" in error
    assert "pip install" in error and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", [*MAKERS, "phone"])
def test_the_right_camera_is_chosen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    software = SoftwarePhone if name == "phone" else MAKERS[name].software
    wanted = Wanted(None if name == "phone" else MAKERS[name].size)
    for serials, serial, message in (
        ((), None, "is connected; "),
        (("A", "B"), None, "2 cameras are connected; choose one with --serial: A, B"),
        (("A", "B"), "C", "has serial number C; connected: A, B"),
    ):
        plugged_in(monkeypatch, software(serials=serials))
        asked = Wanted(wanted.size_px, wanted.rate_hz, serial)
        with pytest.raises(DataError, match=message), CAMERAS[name](asked):  # type: ignore[index]
            pass


@pytest.mark.parametrize("name", [*MAKERS, "phone"])
def test_the_software_answers_by_the_names_of_the_package(name: str) -> None:
    """Runs where a maker's package is installed: each name that is imitated must be there."""
    package = pytest.importorskip(PACKAGES[name])
    modules = {"oak": software_oak, "orbbec": software_orbbec, "k4a": software_k4a, "phone": software_phone}

    def there(names: str) -> bool:
        try:
            reduce(getattr, names.split("."), package)
        except AttributeError:
            return False
        return True

    assert [names for names in modules[name].NAMES if not there(names)] == []


def test_a_package_that_cannot_be_loaded_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        def find_spec(self, found: str, path: object = None, target: object = None) -> None:
            if found == "pyk4a":
                raise ImportError("libk4a.so.1.4: cannot open shared object file", name="k4a_module")

    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    with (
        pytest.raises(DataError, match=r"pyk4a cannot be loaded: libk4a.so.*Sensor SDK"),
        CAMERAS["k4a"](Wanted()),
    ):
        pass


# OAK ----------------------------------------------------------------------------------------------


def test_the_newer_oak_aligns_by_its_own_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, SoftwareOak(platform="RVC4"))
    recorded("oak", tmp_path, [], wanted=Wanted(SMALL))
    scene = open_scenes(tmp_path, "rpl")[0].scene
    number = round((scene.frames[0].timestamp_s - 1) * 30)
    np.testing.assert_allclose(read_depth_m(scene, scene.frames[0]), depth_pixels(number) / 1000, atol=1e-6)


def test_an_oak_holds_exposure_and_focus_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    oak = plugged_in(monkeypatch, SoftwareOak())
    with CAMERAS["oak"](Wanted(SMALL)) as streams:
        (line,) = streams.lock_exposure(lambda: np.full(3, 117.0))
        assert line == "locked exposure and white balance, brightness 117 of 255"
    (command,) = oak.cameras[0].inputControl.sent
    assert command.exposure and command.balance
    assert oak.cameras[0].initialControl.focus == 130  # where it was calibrated
    assert oak.closed and not oak.running


def test_an_oak_that_does_not_straighten_its_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One calibrated in an early format ignores that it was asked to; its distortion is then recorded."""
    plugged_in(monkeypatch, SoftwareOak(old_calibration=True))
    said: list[str] = []
    recorded("oak", tmp_path, said, wanted=Wanted(SMALL))
    lens = open_scenes(tmp_path, "rpl")[0].scene.intrinsics
    assert lens.distortion == pytest.approx((0.1, -0.2, 0.001, 0.002, 0.05))
    assert any("leaves the lens distortion in its colour images" in line for line in said)
    plugged_in(monkeypatch, SoftwareOak(old_calibration=True, prism=0.01))
    with (
        pytest.raises(DataError, match="only the first eight of OpenCV's coefficients"),
        CAMERAS["oak"](Wanted(SMALL)),
    ):
        pass


# Orbbec -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["BGR", "YUYV", "UYVY", "MJPG"])
def test_every_format_of_colour_becomes_rgb(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, SoftwareOrbbec(form=form))
    with CAMERAS["orbbec"](Wanted(SMALL)) as streams:
        shot = next(streams.shots(patience_s=1.0))
    off = np.abs(shot.color.astype(int) - color_pixels(shot.number % 50))
    assert off.mean() < (0.01 if form == "BGR" else 4)


def test_an_orbbec_without_such_a_stream_or_lens_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, SoftwareOrbbec())
    expected = r"does not give 640x480 .* at 30 Hz; it has 64x48 at 30, 128x96 at 15; choose with --width"
    with pytest.raises(DataError, match=expected), CAMERAS["orbbec"](Wanted((640, 480))):
        pass
    plugged_in(monkeypatch, SoftwareOrbbec(model="BROWN_CONRADY"))
    with CAMERAS["orbbec"](Wanted(SMALL)) as streams:
        assert streams.camera.intrinsics.distortion == BENT[:5]
    plugged_in(monkeypatch, SoftwareOrbbec(model="KANNALA_BRANDT4"))
    with (
        pytest.raises(DataError, match="in the model KANNALA_BRANDT4, which"),
        CAMERAS["orbbec"](Wanted(SMALL)),
    ):
        pass


def mean_color(exposure: float, gain: float, kelvin: float, *, light: float) -> np.ndarray:
    mean = min(255.0, 110 * (exposure * (1 + gain / 16) * light) ** (1 / 2.2))
    return mean * np.array([kelvin / 4600, 1.0, 4600 / kelvin])


def test_an_orbbec_holds_its_exposure(monkeypatch: pytest.MonkeyPatch) -> None:
    software = plugged_in(monkeypatch, SoftwareOrbbec())
    values = software.values

    def seen() -> np.ndarray:
        automatic = (
            values["OB_PROP_COLOR_AUTO_EXPOSURE_BOOL"],
            values["OB_PROP_COLOR_AUTO_WHITE_BALANCE_BOOL"],
        )
        exposure = 156 if automatic[0] else values["OB_PROP_COLOR_EXPOSURE_INT"]
        gain = 0 if automatic[0] else values["OB_PROP_COLOR_GAIN_INT"]
        kelvin = 3600 if automatic[1] else values["OB_PROP_COLOR_WHITE_BALANCE_INT"]
        return mean_color(exposure, gain, kelvin, light=1 / 156)

    before = seen()
    lines = lock(OrbbecControls(software.module, software.device), seen, rate_hz=30)
    assert not values["OB_PROP_COLOR_AUTO_EXPOSURE_BOOL"]
    assert lines[0].startswith("locked exposure") and lines[1].startswith("locked white balance")
    np.testing.assert_allclose(seen(), before, rtol=0.1)
    values.pop("OB_PROP_COLOR_EXPOSURE_INT")
    assert not OrbbecControls(software.module, software.device).supports("exposure")


def test_a_damaged_image_of_an_orbbec_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, SoftwareOrbbec(form="MJPG", damaged=tuple(range(0, 999, 5)), until=60))
    captured = recorded("orbbec", tmp_path, [], wanted=Wanted(SMALL), seconds=60.0)
    assert any("without depth at the same time" in line for line in captured.losses[1:])
    assert captured.frames > 5


# Azure Kinect -------------------------------------------------------------------------------------


def test_an_azure_kinect_holds_what_its_automatic_chose(monkeypatch: pytest.MonkeyPatch) -> None:
    software = plugged_in(monkeypatch, SoftwareKinect())
    with CAMERAS["k4a"](Wanted()) as streams:
        (kinect,) = software.devices

        def seen() -> np.ndarray:
            exposure = 8330 if kinect.exposure_mode_auto else kinect.exposure
            kelvin = 3600 if kinect.whitebalance_mode_auto else kinect.whitebalance
            return mean_color(exposure, kinect.gain, kelvin, light=1 / 8330 / 5)

        before = seen()
        lines = lock(KinectControls(streams), seen, rate_hz=30)  # type: ignore[arg-type]
    assert lines[0].startswith("locked exposure 8330, gain 64") and not kinect.exposure_mode_auto
    assert kinect.whitebalance == pytest.approx(3600, abs=60)
    np.testing.assert_allclose(seen(), before, rtol=0.1)
    assert not kinect.opened


def test_an_azure_kinect_in_use_or_asked_for_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    software = plugged_in(monkeypatch, SoftwareKinect(serials=("busy", "A")))
    with CAMERAS["k4a"](Wanted()) as streams:
        assert streams.camera.name == "Azure Kinect A"
    assert not any(device.opened for device in software.devices)
    software = plugged_in(monkeypatch, SoftwareKinect(serials=("without power",)))
    with (
        pytest.raises(DataError, match="the SDK does not say why; .*both its cables"),
        CAMERAS["k4a"](Wanted()),
    ):
        pass
    assert not software.devices[0].opened
    for wanted in (Wanted((640, 480)), Wanted((4096, 3072)), Wanted(rate_hz=25)):
        with (
            pytest.raises(DataError, match=r"does not give .* at .* Hz; it has 1280x720, 1920x1080"),
            CAMERAS["k4a"](wanted),
        ):
            pass


# Phone --------------------------------------------------------------------------------------------


def test_a_phone_keeps_its_coarse_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Depth stays at its size, in a unit finer than it can measure; doubtful and missing depth is none."""
    phone = plugged_in(monkeypatch, SoftwarePhone())
    captured = recorded("phone", tmp_path, [], wanted=Wanted())
    assert phone.failure is None and captured.losses == ()
    (recording,) = open_scenes(tmp_path, "rpl")
    scene = recording.scene
    assert (scene.intrinsics.fx, scene.intrinsics.fy) == (100, 101)
    assert (scene.intrinsics.cx, scene.intrinsics.cy) == (47.5, 63.25)
    assert scene.depth_size == (32, 24) and scene.metres_per_unit == 0.00025
    assert scene.depth_intrinsics.fx == 25
    from PIL import Image

    for frame in (scene.frames[0], scene.frames[-1]):
        number = round(float(read_color(frame)[..., 0].mean()) / 5)
        assert frame.depth is not None
        stored_m = np.asarray(Image.open(frame.depth)) * 0.00025
        there = np.ones(stored_m.shape, bool)
        there[3, 4] = there[10, 11] = False
        np.testing.assert_allclose(stored_m[there], software_phone.depth_m(number)[there], atol=0.000126)
        assert not stored_m[~there].any()
        assert read_depth_m(scene, frame).shape == (128, 96)
    assert "no times" in (tmp_path / "00/capture.txt").read_text()


def test_each_scene_of_a_phone_has_its_own_lens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, SoftwarePhone(refocus_px=3.0))
    recorded("phone", tmp_path, [], wanted=Wanted())
    assert not (tmp_path / "camera.txt").exists()
    assert open_scenes(tmp_path, "rpl")[0].scene.intrinsics.fx == 100
    notes = (tmp_path / "00/capture.txt").read_text()
    assert "intrinsics change by up to 3.0 px between frames (focus); their median is used" in notes


def test_a_phone_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    for software, wanted, message in (
        (SoftwarePhone(), Wanted(SMALL), "chooses the size of its images itself; leave out"),
        (SoftwarePhone(streams=False), Wanted(), "does not stream; open Record3D on it"),
        (SoftwarePhone(until=0), Wanted(), "sends no colour with depth"),
        (SoftwarePhone(depth_px=(32, 24)), Wanted(), "do not show the same view"),
    ):
        plugged_in(monkeypatch, software)
        with pytest.raises(DataError, match=message), CAMERAS["phone"](wanted):
            pass
        assert software.failure is None


def test_damaged_images_of_a_phone_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    phone = plugged_in(monkeypatch, SoftwarePhone(lost=lambda number: number % 10 == 7))
    captured = recorded("phone", tmp_path, [], wanted=Wanted())
    assert phone.failure is None
    assert any("without depth at the same time" in line for line in captured.losses)


def test_the_front_camera_of_a_phone_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    plugged_in(monkeypatch, SoftwarePhone(device_type=0))
    with CAMERAS["phone"](Wanted()) as streams:
        assert any("may send mirrored images" in note for note in streams.camera.notes)
