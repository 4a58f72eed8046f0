"""EXR images, written by FFmpeg and by hand: the values come back, damage is refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from exr_writer import exr_bytes

from rpl_data.formats.containers.exr import read_exr
from rpl_data.types import DataError

DEPTH = np.random.default_rng(0).uniform(0.2, 5, (37, 52)).astype(np.float32).round(3)


@pytest.mark.parametrize("channel", ["R", "Z", "A", "depth.V"])
@pytest.mark.parametrize("compression", [0, 2, 3])
@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_one_channel(channel: str, compression: int, kind: type, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    path.write_bytes(exr_bytes(DEPTH.astype(kind), channel=channel, compression=compression))
    np.testing.assert_array_equal(read_exr(path), DEPTH.astype(kind).astype(np.float32))


@pytest.mark.parametrize("compression", ["none", "rle", "zip1", "zip16"])
def test_what_ffmpeg_writes(compression: str, tmp_path: Path) -> None:
    import av

    path = tmp_path / "a.exr"
    with av.open(str(path), "w", format="image2", options={"update": "1"}) as container:
        stream = container.add_stream("exr", rate=1, options={"compression": compression})
        stream.width, stream.height, stream.pix_fmt = DEPTH.shape[1], DEPTH.shape[0], "gbrpf32le"
        frame = av.VideoFrame.from_ndarray(np.dstack([DEPTH] * 3), format="gbrpf32le")
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    np.testing.assert_array_equal(read_exr(path), DEPTH)


def test_wherever_it_was_cut_off_it_is_refused(tmp_path: Path) -> None:
    content = exr_bytes(DEPTH)
    path = tmp_path / "a.exr"
    for end in [*range(0, 400, 7), *range(400, len(content), 997)]:
        path.write_bytes(content[:end])
        with pytest.raises(DataError, match="is not an EXR image that can be read"):
            read_exr(path)


def test_a_wavelet_compression_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    path.write_bytes(
        exr_bytes(DEPTH, compression=0).replace(b"compression\0\x01\0\0\0\0", b"compression\0\x01\0\0\0\4")
    )
    with pytest.raises(DataError, match="its compression is PIZ"):
        read_exr(path)


def test_a_few_bytes_that_promise_a_line_of_gigabytes_are_refused(tmp_path: Path) -> None:
    """Before any memory is taken: 16 lines of 4 million pixels would be unpacked at once."""
    narrow, wide = (struct.pack("<4i", 0, 0, right, 0) for right in (51, 2**22 - 1))
    path = tmp_path / "a.exr"
    path.write_bytes(exr_bytes(DEPTH[:1]).replace(narrow, wide))
    with pytest.raises(DataError, match="1 channel of 4194304 pixels per line"):
        read_exr(path)
