"""Videos that were cut off: frames that are whole, in their order, and none in another's place."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from rpl_data.formats.containers.video import video_frames

COUNT = 24
_STORED = {"crf": "10", "x264-params": "bframes=3:b-adapt=0:scenecut=0"}


def write(path: Path) -> None:
    """A video that stores frames in another order than it shows them; brightness says which is which."""
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=30, options=_STORED)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.time_base = Fraction(1, 30)
        chance = np.random.default_rng(0)
        for number in range(COUNT):
            noise = chance.integers(0, 6, (48, 64, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noise + 10 * number, format="rgb24")))
        container.mux(stream.encode(None))


def shown(path: Path) -> list[int]:
    return [round((float(image.mean()) - 2.5) / 10) for _, image in video_frames(path)]


def test_frames_that_are_stored_in_another_order(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4")
    content = (tmp_path / "a.mp4").read_bytes()
    assert shown(tmp_path / "a.mp4") == list(range(COUNT))
    with av.open(str(tmp_path / "a.mp4")) as container:
        stored = [
            (packet.pts, packet.pos + packet.size) for packet in container.demux(video=0) if packet.size
        ]
    assert stored != sorted(stored), "the video has no frames in another order: the test tests nothing"
    for position, (_, end) in enumerate(stored[3:], 3):
        for more in (0, 5):
            (tmp_path / "cut.mp4").write_bytes(content[: end + more])
            there = sorted(pts for pts, _ in stored[: position + 1])
            order = sorted(pts for pts, _ in stored)
            whole = next((n for n, pts in enumerate(there) if pts != order[n]), len(there))
            found = shown(tmp_path / "cut.mp4")
            assert found == list(range(len(found))) and whole - 1 <= len(found) <= whole
