"""Colour topics of H.264 and H.265: every picture at its own time, and none before a key picture."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from bags import ALIGNED, COLOR, OPTICAL, Writing, bag, stamp
from recordings import depth_image
from rosbags.typesys import get_types_from_msg

from rpl_data.formats.recordings.ros.read import read_bag
from rpl_data.formats.recordings.ros.video import VIDEO_TYPES
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.images import read_color
from rpl_data.types import DataError, Recording

FOXGLOVE, FFMPEG = VIDEO_TYPES
COUNT, KEYS_APART = 12, 4


def packets(codec: str, more: str = "") -> list[tuple[int, bytes]]:
    """Grey pictures, each 15 brighter than the last: number and packet of each, in the encoder's order."""
    options = {"x264-params": f"keyint={KEYS_APART}:scenecut=0:annexb=1{more}", "crf": "5"}
    if codec == "libx265":
        options = {"x265-params": f"keyint={KEYS_APART}:scenecut=0:bframes=0:log-level=none:annexb=1"}
    encoder = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height, encoder.pix_fmt = 64, 48, "yuv420p"
    encoder.time_base, encoder.options = Fraction(1, 30), options
    found = []
    for number in range(COUNT):
        picture = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 30 + 15 * number, np.uint8), format="rgb24")
        picture.pts = number
        found += encoder.encode(picture)
    return [(packet.pts, bytes(packet)) for packet in [*found, *encoder.encode(None)]]


def send(writing: Writing, kind: str, number: int, content: bytes, codec: str) -> None:
    if kind not in writing.store.types:
        writing.store.register(get_types_from_msg(VIDEO_TYPES[kind], kind))
    data = np.frombuffer(content, np.uint8)
    header = writing.header(stamp(number), OPTICAL)
    if kind == FOXGLOVE:
        fields = {"timestamp": header.stamp, "frame_id": OPTICAL, "data": data, "format": codec}
        writing.send(f"{COLOR}/image_raw/foxglove", kind, writing.new(kind, **fields), stamp(number))
        return
    fields = {"header": header, "width": 64, "height": 48, "encoding": f"{codec};yuv420p;bgr8;bgr8"}
    fields |= {"pts": number, "flags": 0, "is_bigendian": False, "data": data}
    writing.send(f"{COLOR}/image_raw/ffmpeg", kind, writing.new(kind, **fields), stamp(number))


def record(path: Path, kind: str, video: list[tuple[int, bytes]], codec: str) -> Recording:
    with bag(path) as writing:
        for number in range(COUNT):
            writing.info(f"{COLOR}/camera_info", stamp(number))
            writing.image(f"{ALIGNED}/image_raw", stamp(number), depth_image(number), "16UC1")
        for number, content in video:
            send(writing, kind, number, content, codec)
    return read_bag("a", (path.with_suffix("") / path.name,), path.parent / "out", None, None, Topics())


def numbers(recording: Recording) -> list[tuple[int, int]]:
    """Of every frame, the number that its time and the one that its brightness tells."""
    start_s = stamp(0) * 1e-9
    return [
        (
            round((frame.timestamp_s - start_s) / 0.033),
            round((float(read_color(frame).mean()) - 30) / 15),
        )
        for frame in recording.scene.frames
    ]


@pytest.mark.parametrize(
    ("kind", "encoder", "codec", "more"),
    [
        (FOXGLOVE, "libx264", "h264", ":bframes=0"),
        (FOXGLOVE, "libx265", "h265", ""),
        (FFMPEG, "libx264", "libx264", ":bframes=2:b-adapt=0"),
    ],
)
def test_pictures_have_their_own_times(
    kind: str, encoder: str, codec: str, more: str, tmp_path: Path
) -> None:
    recording = record(tmp_path / "a.mcap", kind, packets(encoder, more), codec)
    assert numbers(recording) == [(number, number) for number in range(COUNT)]


def test_what_lacks_its_key_picture_is_left_out(tmp_path: Path) -> None:
    """The recording began after the first key picture, and a later packet is damaged."""
    video = packets("libx264", ":bframes=0")[1:]
    video[4] = (video[4][0], video[4][1][:4] + bytes(len(video[4][1]) - 4))  # picture 5
    recording = record(tmp_path / "a.mcap", FOXGLOVE, video, "h264")
    assert numbers(recording) == [(number, number) for number in (4, 8, 9, 10, 11)]
    assert any("damaged image in the bag" in line for line in recording.skipped)


def test_another_codec_is_no_colour(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no colour images.*foxglove \(av1\)"):
        record(tmp_path / "a.mcap", FOXGLOVE, packets("libx264", ":bframes=0"), "av1")
