"""ROS bags of both generations: what drivers record, what recorders leave behind, and what is asked for."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from bags import ALIGNED, COLOR, OPTICAL, START_NS, Writing, bag, realsense, stamp
from recordings import color_image, depth_image

from rpl_data.formats.containers.ros_topics import db3_topics
from rpl_data.formats.recordings.ros import topics as naming
from rpl_data.formats.recordings.ros.bags import bags_at
from rpl_data.formats.recordings.ros.decode import color_of, depth_of
from rpl_data.formats.recordings.ros.read import read_bag
from rpl_data.formats.recordings.ros.topics import (
    ImageTopic,
    choose_color,
    choose_depth,
    is_aligned_by_name,
)
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.geometry import from_rotvec, transform
from rpl_data.images import read_color, read_depth_m
from rpl_data.recordings.open import likely_formats, open_scenes
from rpl_data.types import DataError, Recording

KINDS = ["a.bag", "a.db3", "a.mcap"]


def read(path: Path, **options: Any) -> Recording:
    """Read the one bag at a path, without the process of its own."""
    ((name, files),) = bags_at(path).items()
    topics = Topics(**options.pop("topics", {}))
    unpacked = path.parent / "unpacked"
    return read_bag(name, files, unpacked, options.pop("unit_m", None), options.pop("camera", None), topics)


def check_frames(recording: Recording, numbers: Iterator[int] | range) -> None:
    for frame, number in zip(recording.scene.frames, numbers, strict=True):
        np.testing.assert_allclose(
            read_depth_m(recording.scene, frame), depth_image(number) * np.float32(0.001), atol=2e-4
        )
        assert np.abs(read_color(frame).astype(int) - color_image(number)).mean() < 4


@pytest.mark.parametrize("kind", KINDS)
def test_what_realsense_ros_records(kind: str, tmp_path: Path) -> None:
    path = realsense(tmp_path / kind)
    assert likely_formats(path) == ["ros"]
    recording = read(path)
    scene = recording.scene
    assert (scene.name, scene.registered, scene.metres_per_unit, recording.skipped) == ("a", True, 0.001, ())
    assert (scene.intrinsics.fx, scene.intrinsics.cy, scene.intrinsics.distortion) == (50, 23.5, ())
    check_frames(recording, range(6))
    header_s = [stamp(number) * 1e-9 for number in range(6)]  # messages were recorded 5 ms later
    np.testing.assert_allclose([frame.timestamp_s for frame in scene.frames], header_s, atol=1e-6)
    assert recording.trajectory is None and "no topic of poses named" in recording.notes[0]


def test_a_bag_without_being_told_its_format(tmp_path: Path) -> None:
    path = realsense(tmp_path / "a.mcap")
    (recording,) = open_scenes(path, "ros", unpack=lambda name: tmp_path / "out" / name)
    assert len(recording.scene.frames) == 6 and recording.scene.source == f"ros: {path / 'a.mcap'}"
    with pytest.raises(DataError, match="It looks like `format: ros`"):
        open_scenes(path, "rpl")
    with pytest.raises(DataError, match="`topics` are for recordings of format ros"):
        open_scenes(path, "tum", topics=Topics())


def test_a_bag_without_images_is_told_so(tmp_path: Path) -> None:
    """As in ros2's own talker.db3."""
    with bag(tmp_path / "talker.db3") as writing:
        writing.send(
            "/topic", "std_msgs/msg/String", writing.new("std_msgs/msg/String", data="hello"), START_NS
        )
    with pytest.raises(
        DataError, match="holds no colour images: it holds no image topics at all; record colour"
    ):
        read(tmp_path / "talker")


# Files --------------------------------------------------------------------------------------------


def test_a_folder_without_metadata_and_in_parts(tmp_path: Path) -> None:
    """metadata.yaml is written on closing; parts follow one another by number."""
    for part, name in enumerate(("run_0", "run_1")):
        with bag(tmp_path / f"{name}.mcap") as writing:
            for number in range(3 * part, 3 * part + 3):
                writing.info(f"{COLOR}/camera_info", stamp(number))
                writing.image(f"{COLOR}/image_raw", stamp(number), color_image(number), "rgb8")
                writing.image(f"{ALIGNED}/image_raw", stamp(number), depth_image(number), "16UC1")
        (tmp_path / name / f"{name}.mcap").rename(tmp_path / f"{name}.mcap")
        (tmp_path / name / "metadata.yaml").unlink()
    assert {name: [file.name for file in files] for name, files in bags_at(tmp_path).items()} == {
        "run": ["run_0.mcap", "run_1.mcap"]
    }
    recording = read(tmp_path)
    check_frames(recording, range(6))
    assert "run_0.mcap, run_1.mcap are read as one recording" in recording.notes


@pytest.mark.parametrize(
    ("topic", "aligned"),
    [
        ("/camera/aligned_depth_to_color/image_raw", True),
        ("/depth_to_rgb/image_raw", True),
        ("/zed/zed_node/depth/depth_registered", True),
        ("/camera/depth_unregistered/image_raw", False),
        ("/camera/depth/image_rect_raw", False),
    ],
)
def test_which_names_say_that_depth_was_moved_onto_colour(topic: str, aligned: bool) -> None:
    assert is_aligned_by_name(topic) == aligned


def test_a_table_of_topics_that_never_ends_is_given_up(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as file:
        endless = "WITH RECURSIVE c(name) AS (SELECT 'a' UNION ALL SELECT name FROM c) SELECT name FROM c"
        file.execute(f"CREATE VIEW topics AS {endless} WHERE name = 'b'")
    assert db3_topics(path) is None


def test_which_files_are_parts_of_one_bag(tmp_path: Path) -> None:
    """A recorder counts its parts from 0 without a gap, 10 after 9; a person counts recordings."""
    for name in (
        *(f"a/run_{n}" for n in range(11)),
        "a/mug_1",
        "a/mug_2",
        "b/gap_0",
        "b/gap_2",
        "b/desk",
        "c/desk",
    ):
        file = tmp_path / f"{name}.mcap"
        file.parent.mkdir(exist_ok=True)
        file.touch()
    found = bags_at(tmp_path)
    assert [file.stem for file in found.pop("run")] == [f"run_{n}" for n in range(11)]
    assert {
        name: [file.relative_to(tmp_path).as_posix() for file in files] for name, files in found.items()
    } == {
        "mug_1": ["a/mug_1.mcap"],
        "mug_2": ["a/mug_2.mcap"],
        "gap_0": ["b/gap_0.mcap"],
        "gap_2": ["b/gap_2.mcap"],
        "b_desk": ["b/desk.mcap"],
        "c_desk": ["c/desk.mcap"],
    }


@pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
def test_bags_that_rosbag2_packed(mode: str, tmp_path: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer

    writer = Writer(tmp_path / "a", version=9)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        writing = Writing(writer, False)
        for number in range(3):
            writing.info(f"{COLOR}/camera_info", stamp(number))
            writing.image(f"{COLOR}/image_raw", stamp(number), color_image(number), "rgb8")
            writing.image(f"{ALIGNED}/image_raw", stamp(number), depth_image(number), "16UC1")
    check_frames(read(tmp_path / "a"), range(3))


# Images -------------------------------------------------------------------------------------------


def raw(pixels: np.ndarray, encoding: str, pad: int = 0) -> SimpleNamespace:
    height, width = pixels.shape[:2]
    rows = np.pad(np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1), [(0, 0), (0, pad)])
    big = int(pixels.dtype.byteorder == ">")
    return SimpleNamespace(
        height=height, width=width, encoding=encoding, step=rows.shape[1], is_bigendian=big, data=rows.ravel()
    )


RGB = np.array([[[200, 100, 50], [10, 20, 30]]], np.uint8)
OPAQUE = np.full((1, 2, 1), 255, np.uint8)


@pytest.mark.parametrize("pad", [0, 3])
@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[..., ::-1]),
        ("8UC3", RGB[..., ::-1]),
        ("rgba8", np.concatenate([RGB, OPAQUE], axis=2)),
        ("bgra8", np.concatenate([RGB[..., ::-1], OPAQUE], axis=2)),
    ],
)
def test_colours_in_every_order_and_rows_with_a_gap(encoding: str, pixels: np.ndarray, pad: int) -> None:
    np.testing.assert_array_equal(color_of(raw(pixels, encoding, pad)), RGB)


def test_grey_yuv_and_bayer() -> None:
    grey = color_of(raw(RGB[..., 0], "mono8"))
    assert isinstance(grey, np.ndarray)
    assert grey.tolist() == [[[200] * 3, [10] * 3]]
    for encoding, order in (("yuv422", [1, 0]), ("yuv422_yuy2", [0, 1])):  # chroma 128 = grey, 235 = white
        yuv = np.full((1, 2, 2), 128, np.uint8)
        yuv[..., order.index(0)] = 235
        white = color_of(raw(yuv, encoding))
        assert isinstance(white, np.ndarray) and white.min() > 250
    mosaic = np.zeros((8, 8), np.uint8)
    mosaic[::2, ::2] = 250  # the first pixel is red
    red = color_of(raw(mosaic, "bayer_rggb8"))
    assert isinstance(red, np.ndarray) and red[4, 4].tolist() == [250, 0, 0]


def test_damaged_raw_images_are_none() -> None:
    for change in ({"step": 5}, {"height": 99}, {"width": 70_000}, {"encoding": "yuv777"}, {"height": 0}):
        assert color_of(SimpleNamespace(**vars(raw(RGB, "rgb8")) | change)) is None


def test_depth_of_either_byte_order_and_as_floats() -> None:
    units = np.array([[0, 700], [65535, 1234]])
    for order in "<>":
        found = depth_of(raw(units.astype(f"{order}u2"), "16UC1", pad=2))
        assert found is not None and found[1] and found[0].tolist() == units.tolist()
        floats = depth_of(raw(np.array([[np.nan, 0.7]], f"{order}f4"), "32FC1"))
        assert floats is not None and not floats[1]
        np.testing.assert_array_equal(floats[0], np.array([[np.nan, 0.7]], np.float32))


def packed(content: bytes, format: str) -> SimpleNamespace:
    return SimpleNamespace(format=format, data=np.frombuffer(content, np.uint8))


def test_compressed_depth_of_both_kinds() -> None:
    """Twelve bytes and a PNG; floats as A / z + B, cut to whole numbers, as its encoder does."""
    depth_m = np.array([[0.5, 2.0], [7.0, np.inf]], np.float32)
    a, limit = 100.0 * 101.0, 10.0
    b = 1 - a / limit
    inverse = np.where(depth_m < limit, a / depth_m + b, 0).astype(np.uint16)
    content = struct.pack("<iff", 0, a, b) + cv2.imencode(".png", inverse)[1].tobytes()
    found = depth_of(packed(content, "32FC1; compressedDepth png"))
    assert found is not None and not found[1]
    np.testing.assert_allclose(found[0][np.isfinite(found[0])], [0.5, 2.0, 7.0], rtol=0.005)
    assert np.isnan(found[0][1, 1])
    units = np.array([[0, 700]], np.uint16)
    content = bytes(12) + cv2.imencode(".png", units)[1].tobytes()
    whole = depth_of(packed(content, "16UC1; compressedDepth"))
    assert whole is not None and whole[1] and whole[0].tolist() == units.tolist()
    assert depth_of(packed(content[:40], "16UC1; compressedDepth")) is None


def test_a_jpeg_is_kept_and_one_with_red_for_blue_is_turned_back() -> None:
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[..., 0] = 200  # red, in the order RGB
    right = cv2.imencode(".jpg", pixels[..., ::-1])[1].tobytes()
    assert color_of(packed(right, "rgb8; jpeg compressed bgr8")) == right
    swapped = cv2.imencode(".jpg", pixels)[1].tobytes()
    found = color_of(packed(swapped, "rgb8; jpeg compressed rgb8"))
    assert isinstance(found, np.ndarray)
    np.testing.assert_allclose(found[8, 8], [200, 0, 0], atol=4)
    assert color_of(packed(b"H264 stream", "h264")) is None


def test_compressed_topics_and_float_depth_through_a_bag(tmp_path: Path) -> None:
    """JPEG colour; depth in metres with NaN, stored in units of 0.25 mm; a damaged message is counted."""
    with bag(tmp_path / "a.mcap") as writing:
        for number in range(4):
            jpeg = cv2.imencode(".jpg", color_image(number)[..., ::-1])[1].tobytes()
            content = jpeg if number != 2 else b"noise"
            writing.info("/zed/zed_node/rgb/camera_info", stamp(number))
            writing.compressed(
                "/zed/zed_node/rgb/image_rect_color/compressed",
                stamp(number),
                content,
                "bgra8; jpeg compressed bgr8",
            )
            depth_m = depth_image(number).astype(np.float32) / 1000
            depth_m[depth_m == 0] = np.nan
            writing.image("/zed/zed_node/depth/depth_registered", stamp(number), depth_m, "32FC1")
    recording = read(tmp_path / "a")
    assert [frame.index for frame in recording.scene.frames] == [0, 1, 3]
    assert recording.skipped == ("1 frame with a damaged image in the bag: 2",)
    check_frames(recording, iter([0, 1, 3]))
    assert recording.scene.metres_per_unit == 0.00025


def test_decimal_depth_in_millimetres_is_known_by_its_size(tmp_path: Path) -> None:
    with bag(tmp_path / "a.bag") as writing:
        for number in range(3):
            writing.image(f"{COLOR}/image_raw", stamp(number), color_image(number), "rgb8")
            writing.info(f"{COLOR}/camera_info", stamp(number))
            depth_mm = depth_image(number).astype(np.float32)
            writing.image(f"{ALIGNED}/image_raw", stamp(number), depth_mm, "32FC1")
    recording = read(tmp_path / "a.bag")
    check_frames(recording, range(3))
    assert "depth in decimal numbers: 0.001 m per unit" in recording.notes


def test_headers_without_stamps(tmp_path: Path) -> None:
    with bag(tmp_path / "a.db3") as writing:
        for number in range(3):
            for topic, pixels, encoding in (
                (f"{COLOR}/image_raw", color_image(number), "rgb8"),
                (f"{ALIGNED}/image_raw", depth_image(number), "16UC1"),
            ):
                writing.late_ns = stamp(number)
                writing.image(topic, 0, pixels, encoding)
            writing.info(f"{COLOR}/camera_info", 0)
    recording = read(tmp_path / "a")
    assert recording.scene.frames[2].timestamp_s == pytest.approx(stamp(2) * 1e-9)
    assert any("no stamps in its headers" in note for note in recording.notes)


def test_colour_without_depth_is_counted(tmp_path: Path) -> None:
    with bag(tmp_path / "a.bag") as writing:
        writing.info(f"{COLOR}/camera_info", START_NS)
        for number in range(6):
            writing.image(f"{COLOR}/image_raw", stamp(number), color_image(number), "rgb8")
            if number % 2 == 0:
                writing.image(f"{ALIGNED}/image_raw", stamp(number) + 4_000_000, depth_image(number), "16UC1")
    recording = read(tmp_path / "a.bag")
    assert [frame.index for frame in recording.scene.frames] == [0, 2, 4]
    assert recording.skipped == ("3 colour images without depth at the same time",)


# Topics -------------------------------------------------------------------------------------------


def images(**encodings: str) -> dict[str, ImageTopic]:
    names = {"/" + name.replace("__", "/"): encoding for name, encoding in encodings.items()}
    return {name: ImageTopic(name, None, encoding, "", [0], [0]) for name, encoding in names.items()}


@pytest.mark.parametrize(
    ("bag_holds", "color", "depth"),
    [
        (
            {
                "camera__color__image_raw": "rgb8",
                "camera__color__image_raw__compressed": "rgb8; jpeg compressed bgr8",
                "camera__infra1__image_rect_raw": "mono8",
                "camera__depth__image_rect_raw": "16UC1",
                "camera__aligned_depth_to_color__image_raw": "16UC1",
                "camera__aligned_depth_to_color__image_raw__compressedDepth": "16UC1; compressedDepth png",
            },
            "/camera/color/image_raw",
            "/camera/aligned_depth_to_color/image_raw",
        ),
        (
            {
                "rgb__image_raw": "bgra8",
                "rgb_to_depth__image_raw": "bgra8",
                "depth__image_raw": "16UC1",
                "depth_to_rgb__image_raw": "16UC1",
                "ir__image_raw": "mono16",
            },
            "/rgb/image_raw",
            "/depth_to_rgb/image_raw",
        ),
        (
            {
                "camera__rgb__image_raw": "rgb8",
                "camera__rgb__image_rect_color": "rgb8",
                "camera__depth_registered__image": "32FC1",
                "camera__depth_registered__image_raw": "16UC1",
            },
            "/camera/rgb/image_rect_color",
            "/camera/depth_registered/image_raw",
        ),
        (
            {
                "zed__zed_node__left__image_rect_color": "bgra8",
                "zed__zed_node__rgb__image_rect_color": "bgra8",
                "zed__zed_node__rgb_raw__image_raw_color": "bgra8",
                "zed__zed_node__depth__depth_registered": "32FC1",
                "zed__zed_node__confidence__confidence_map": "32FC1",
            },
            "/zed/zed_node/rgb/image_rect_color",
            "/zed/zed_node/depth/depth_registered",
        ),
        (
            {
                "oak__rgb__image_raw__compressed": "jpeg",
                "oak__left__image_raw": "mono8",
                "oak__right__image_raw": "mono8",
                "oak__stereo__image_raw": "16UC1",
            },
            "/oak/rgb/image_raw/compressed",
            "/oak/stereo/image_raw",
        ),
    ],
)
def test_topics_of_known_drivers(bag_holds: dict[str, str], color: str, depth: str) -> None:
    """realsense-ros, Azure Kinect, OpenNI, ZED, depthai."""
    found = images(**bag_holds)
    chosen = choose_color(found, None)
    assert (chosen.name, choose_depth(found, chosen, None).name) == (color, depth)


def test_two_cameras_are_asked_for_and_each_has_its_own_depth() -> None:
    found = images(
        left__color__image_raw="rgb8",
        right__color__image_raw="rgb8",
        left__depth__image_raw="16UC1",
        right__depth__image_raw="16UC1",
    )
    with pytest.raises(
        DataError, match=r"equally likely: /left/color/image_raw, /right/color/image_raw; name one: `topics: "
    ):
        choose_color(found, None)
    right = choose_color(found, "right/color/image_raw")
    assert choose_depth(found, right, None).name == "/right/depth/image_raw"
    with pytest.raises(
        DataError, match=r"holds no images there; its image topics are /left/color/image_raw \(rgb8\)"
    ):
        choose_color(found, "/middle/color")
    assert not naming.ImageTopic("/ir/image_raw", None, "mono16", "", [], []).is_depth


# Cameras ------------------------------------------------------------------------------------------


def one_camera(path: Path, topic: str = f"{COLOR}/image_raw", **info: Any) -> Path:
    with bag(path) as writing:
        for number in range(2):
            writing.image(topic, stamp(number), color_image(number), "rgb8")
            writing.image(f"{ALIGNED}/image_raw", stamp(number), depth_image(number), "16UC1")
        writing.info(f"{topic.rpartition('/')[0]}/camera_info", START_NS, **info)
    return path if path.suffix == ".bag" else path.with_suffix("")


def test_lenses(tmp_path: Path) -> None:
    lens = (0.1, -0.2, 0.001, 0.002, 0.03, 0.1, 0.05, 0.01)
    assert read(one_camera(tmp_path / "a.bag", lens=lens[:5])).scene.intrinsics.distortion == lens[:5]
    rational = one_camera(tmp_path / "b.bag", lens=lens, model="rational_polynomial")
    assert read(rational).scene.intrinsics.distortion == lens
    with pytest.raises(
        DataError, match="a lens of model equidistant with 4 numbers cannot be read; record rectified"
    ):
        read(one_camera(tmp_path / "c.bag", lens=lens[:4], model="equidistant"))


def test_rectified_images_have_the_camera_p_and_no_lens(tmp_path: Path) -> None:
    topic = "/camera/rgb/image_rect_color"
    found = read(one_camera(tmp_path / "a.bag", topic, lens=(0.1, 0, 0, 0, 0), p=(47.0, 48.0, 30.0, 22.0)))
    assert found.scene.intrinsics.fx == 47 and found.scene.intrinsics.distortion == ()


def test_cameras_that_are_missing_or_do_not_fit(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"says that the camera is not calibrated; give `camera: "):
        read(one_camera(tmp_path / "a.bag", k=(0.0, 0.0, 0.0, 0.0)))
    with pytest.raises(DataError, match=r"is for images of 128 x 96 px, those of .* have 64 x 48"):
        read(one_camera(tmp_path / "b.bag", size=(128, 96)))
    with bag(tmp_path / "c.bag") as writing:
        writing.image(f"{COLOR}/image_raw", START_NS, color_image(0), "rgb8")
        writing.image(f"{ALIGNED}/image_raw", START_NS, depth_image(0), "16UC1")
    with pytest.raises(
        DataError, match=r"holds no camera_info for /camera/camera/color/image_raw; name its topic"
    ):
        read(tmp_path / "c.bag")
    assert read(tmp_path / "c.bag", camera=(60.0, 60.0, 31.5, 23.5)).scene.intrinsics.fx == 60


def two_cameras(path: Path, link: str) -> Path:
    """Depth of 32 x 24 px from a camera 20 mm to the left that looks straight at a wall 0.8 m away."""
    with bag(path) as writing:
        for number in range(2):
            at = stamp(number)
            writing.info("/camera/color/camera_info", at)
            writing.image("/camera/color/image_raw", at, color_image(number), "rgb8")
            wall = np.full((24, 32), 800, np.uint16)
            writing.image("/camera/depth/image_rect_raw", at, wall, "16UC1", frame="depth_optical")
            writing.info(
                "/camera/depth/camera_info", at, (30.0, 30.0, 15.5, 11.5), (32, 24), frame="depth_optical"
            )
        if link == "tf_static":  # both below one frame, as realsense-ros has them
            writing.tf("/tf_static", START_NS, "camera_link", "depth_optical", (0.0, 0, 0))
            writing.tf("/tf_static", START_NS, "camera_link", OPTICAL, (0.02, 0, 0))
        elif link == "tf":  # ROS 1 repeats fixed transforms on /tf, and frames began with a slash
            for number in range(2):
                writing.tf("/tf", stamp(number), "/depth_optical", f"/{OPTICAL}", (0.02, 0, 0))
        elif link == "extrinsics":
            writing.extrinsics("/camera/extrinsics/depth_to_color", np.eye(3), (-0.02, 0, 0))
    return path


@pytest.mark.parametrize("link", ["tf_static", "tf", "extrinsics"])
def test_depth_of_its_own_camera_is_moved_onto_colour(link: str, tmp_path: Path) -> None:
    recording = read(two_cameras(tmp_path / "a.bag", link))
    assert recording.scene.registered
    assert any("depth has 32 x 24 px, colour 64 x 48: it is looked up" in note for note in recording.notes)
    depth_m = read_depth_m(recording.scene, recording.scene.frames[0])
    seen = np.flatnonzero(depth_m[24])
    # Depth sees x from -15.5 / 30 * 0.8 m on; the colour camera is 20 mm to the right of it.
    left_px = (-16 / 30 * 0.8 - 0.02) / 0.8 * 50 + 31.5
    assert seen[0] == pytest.approx(left_px, abs=1.7)  # a depth pixel has 1.7 colour pixels
    assert (np.diff(seen) == 1).all(), "no gaps"
    np.testing.assert_allclose(depth_m[24, seen], 0.8, atol=1e-6)


def test_the_extrinsics_of_realsense_are_stored_column_by_column(tmp_path: Path) -> None:
    from rpl_data.formats.recordings.ros.cameras import from_extrinsics

    turn = from_rotvec(np.array([0, 0, 0.5]), np.array([0.1, 0, 0]))
    message = SimpleNamespace(rotation=turn[:3, :3].ravel(order="F"), translation=turn[:3, 3])
    found = from_extrinsics(message)
    assert found is not None
    np.testing.assert_allclose(transform(found, np.array([1.0, 0, 0])), [np.cos(0.5) + 0.1, np.sin(0.5), 0])


def test_depth_without_a_way_to_colour(tmp_path: Path) -> None:
    with pytest.raises(
        DataError, match="depth is in frame depth_optical, colour in .* the bag holds no transform"
    ):
        read(two_cameras(tmp_path / "a.bag", "none"))
    with bag(tmp_path / "b.bag") as writing:
        for number in range(2):
            writing.info(f"{COLOR}/camera_info", stamp(number))
            writing.image(f"{COLOR}/image_raw", stamp(number), color_image(number), "rgb8")
            writing.image("/camera/camera/depth/image", stamp(number), depth_image(number), "16UC1", "depth")
    recording = read(tmp_path / "b.bag")
    assert not recording.scene.registered
    assert any("not registered; set `registered: true`" in note for note in recording.notes)


# Poses --------------------------------------------------------------------------------------------


def along(number: float) -> tuple[float, float, float]:
    return (0.1 * number, 0.0, 0.0)


def posed(path: Path, link: bool = True) -> Path:
    """The base moves along x by 0.1 m a frame; the camera sits 0.5 m above it."""

    def more(writing: Writing) -> None:
        for half in range(11):
            at = START_NS + half * 33_000_000 // 2
            writing.tf("/tf", at, "odom", "base", along(half / 2))
            writing.odometry("/odom", at, "odom", "base", along(half / 2))
        writing.tf("/tf", START_NS, "map", "odom", (0, 7, 0))
        if link:
            writing.tf("/tf_static", START_NS, "base", OPTICAL, (0, 0, 0.5))
        stamps = [stamp(number) for number in range(5)]
        writing.poses("/slam/pose", stamps, [along(n) for n in range(5)], path=False)
        writing.poses("/slam/path", stamps, [along(n) for n in range(5)], path=True)

    return realsense(path, more=more)


@pytest.mark.parametrize("kind", ["a.bag", "a.mcap"])
def test_poses_by_name_of_their_topic(kind: str, tmp_path: Path) -> None:
    path = posed(tmp_path / kind)
    assert read(path).trajectory is None
    expected = {
        "/tf": (0.2, 7, 0.5),
        "/odom": (0.2, 0, 0.5),
        "/slam/pose": (0.2, 0, 0),
        "/slam/path": (0.2, 0, 0),
    }
    for topic, place in expected.items():
        recording = read(path, topics={"poses": topic})
        assert recording.trajectory is not None
        np.testing.assert_allclose(recording.trajectory.at(2)[:3, 3], place, atol=1e-6)
    assert recording.trajectory is not None and recording.trajectory.frames.tolist() == [0, 1, 2, 3, 4]
    assert recording.skipped == ("1 frame without a pose in /slam/path at their time: 5",)
    in_odom = read(path, topics={"poses": "/tf", "frame": "odom"}).trajectory
    assert in_odom is not None
    np.testing.assert_allclose(in_odom.at(3)[:3, 3], (0.3, 0, 0.5), atol=1e-6)


def test_poses_that_cannot_be_had(tmp_path: Path) -> None:
    path = posed(tmp_path / "a.bag", link=False)
    with pytest.raises(
        DataError, match=r"holds no poses there; topics with poses are /tf, /odom, /slam/pose"
    ):
        read(path, topics={"poses": "/camera/camera/color/image_raw"})
    with pytest.raises(
        DataError, match=r"/odom holds poses of base, and no fixed transform of /tf_static leads"
    ):
        read(path, topics={"poses": "/odom"})
    with pytest.raises(DataError, match=r"/tf does not say where camera_color_optical_frame .* is"):
        read(path, topics={"poses": "/tf"})


# Recorders that were killed -----------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_bags_that_were_cut_off(kind: str, tmp_path: Path) -> None:
    """What is complete is read, at any length; 97 % keeps nearly all."""
    (tmp_path / "whole").mkdir()
    whole = realsense(tmp_path / "whole" / kind if kind == "a.bag" else tmp_path / kind, 12)
    content = (whole if kind == "a.bag" else whole / kind).read_bytes()
    kept = []
    for percent in (40, 70, 97):
        folder = tmp_path / f"cut{percent}"
        folder.mkdir()
        (folder / kind).write_bytes(content[: len(content) * percent // 100])
        assert likely_formats(folder) == ["ros"]
        recording = read(folder / kind)
        kept.append(len(recording.scene.frames))
        check_frames(recording, range(kept[-1]))
        assert "was never closed or cut off" in recording.skipped[0]
        assert not list((folder / "unpacked").glob("repaired*"))
    assert kept[0] >= 2 and kept[0] < kept[1] < kept[2] >= 9


def test_a_packed_chunk_of_an_mcap_is_unpacked_up_to_the_cut(tmp_path: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    chance = np.random.default_rng(0)
    writer = Writer(tmp_path / "a", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        writing = Writing(writer, False)
        writing.info(f"{COLOR}/camera_info", START_NS, (250.0, 250.0, 159.5, 119.5), (320, 240))
        for number in range(8):  # a chunk of about a megabyte, of noise, so that it does not shrink
            pixels = chance.integers(0, 255, (240, 320, 3), np.uint8)
            writing.image(f"{COLOR}/image_raw", stamp(number), pixels, "rgb8")
            writing.image(f"{ALIGNED}/image_raw", stamp(number), np.full((240, 320), 700, np.uint16), "16UC1")
    file = tmp_path / "a" / "a.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert len(read(file).scene.frames) >= 2
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(DataError, match="holds no colour images"):
        read(file)


def test_what_is_no_bag_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"not at all")
    with pytest.raises(DataError, match="is not an MCAP file; expected a ROS 2 recording"):
        read(tmp_path / "a.mcap")
    with pytest.raises(DataError, match=r"holds no ROS bag \(.bag, .db3, .mcap\)"):
        open_scenes(tmp_path / "nothing", "ros", unpack=lambda name: tmp_path)


def test_a_ros1_recording_in_mcap_as_depthai_writes_it(tmp_path: Path) -> None:
    """Topics without namespace, depth as mono16, no camera, a channel of another kind; a damaged chunk."""
    import lz4.frame

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    def text(*words: str) -> bytes:
        return b"".join(struct.pack("<I", len(word)) + word.encode() for word in words)

    class Collect:
        messages: list[tuple[str, bytes]] = []  # noqa: RUF012

        def add_connection(self, topic: str, kind: str, typestore: object) -> str:
            return topic

        def write(self, topic: str, bag_ns: int, raw: bytes) -> None:
            self.messages.append((topic, bytes(raw)))

    collect = Collect()
    writing = Writing(collect, True)
    for number in range(3):
        jpeg = cv2.imencode(".jpg", color_image(number)[..., ::-1])[1].tobytes()
        writing.compressed("/color/compressed", stamp(number), jpeg, "jpeg", frame=str(number))
        writing.image("/depth/raw", stamp(number), depth_image(number), "mono16", frame=str(number))
    heads = record(3, struct.pack("<H", 1) + text("sensor_msgs/CompressedImage", "ros1msg", ""))
    heads += record(3, struct.pack("<H", 2) + text("sensor_msgs/Image", "ros1msg", ""))
    for number, name in ((1, "/color/compressed"), (2, "/depth/raw")):
        heads += record(4, struct.pack("<HH", number, number) + text(name, "ros1") + bytes(4))
    heads += record(4, struct.pack("<HH", 3, 0) + text("/imu", "json") + bytes(4))
    content = b"\x89MCAP0\r\n" + record(1, text("ros1", "test"))
    for number in range(3):
        inner = heads + b"".join(
            record(5, struct.pack("<HIQQ", 1 + (topic == "/depth/raw"), 0, 0, 0) + raw)
            for topic, raw in collect.messages[2 * number : 2 * number + 2]
        )
        packed = lz4.frame.compress(inner) if number != 1 else b"damaged"
        size = struct.pack("<QQQI", 0, 0, len(inner), 0) + text("lz4") + struct.pack("<Q", len(packed))
        content += record(6, size + packed)
    (tmp_path / "recordings.mcap").write_bytes(
        content + record(15, bytes(4)) + record(2, bytes(20)) + content[:8]
    )
    recording = read(tmp_path / "recordings.mcap", camera=(50.0, 51.0, 31.5, 23.5))
    check_frames(recording, iter([0, 2]))
    assert recording.skipped == ("1 chunk of recordings.mcap damaged, with all messages in it",)
    assert not recording.scene.registered, "nothing in the file says that depth is aligned"
