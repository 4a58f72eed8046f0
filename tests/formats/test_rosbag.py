"""ROS bags that end in the middle of a chunk: every whole message is kept."""

from __future__ import annotations

import bz2
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from bags import START_NS, Writing
from rosbags.rosbag1 import Reader, Writer

from rpl_data.formats.containers.lz4 import unpack_lz4
from rpl_data.formats.containers.rosbag import repair_bag
from rpl_data.types import DataError

COUNT = 12


def write(path: Path, compression: str, chunk_bytes: int) -> list[bytes]:
    """Write images of noise, which do not shrink, and return their pixels."""
    images = [np.random.default_rng(n).integers(0, 255, (24, 32), np.uint8) for n in range(COUNT)]
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk_bytes
    with writer:
        writing = Writing(writer, True)
        for number, image in enumerate(images):
            writing.image(f"/camera/{number % 3}", START_NS + number, image, "mono8")
    return [image.tobytes() for image in images]


def unpacked(content: bytes, path: Path, compression: str) -> bytes:
    """What the compression's own decoder gets out of the chunks of a bag that was cut off."""
    with Reader(path) as whole:
        chunks = sorted(chunk[:2] for chunk in whole.chunks.values())
    out = b""
    for size, at in sorted(chunks, key=lambda chunk: chunk[1]):
        packed = content[at : at + size]
        if compression == "bz2":
            packed = bz2.BZ2Decompressor().decompress(packed) if packed else b""
        elif compression == "lz4":
            packed = lz4.frame.LZ4FrameDecompressor().decompress(packed) if packed else b""
        out += packed
    return out


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
@pytest.mark.parametrize("chunk_bytes", [2000, 10**6], ids=["many chunks", "one chunk"])
def test_a_bag_that_was_cut_off_gives_all_that_is_whole(
    compression: str, chunk_bytes: int, tmp_path: Path
) -> None:
    images = write(tmp_path / "a.bag", compression, chunk_bytes)
    content = (tmp_path / "a.bag").read_bytes()
    kept = []
    for share in (0.4, 0.7, 0.8, 0.97):
        (tmp_path / "cut.bag").write_bytes(content[: int(len(content) * share)])
        out = unpacked(content[: int(len(content) * share)], tmp_path / "a.bag", compression)
        whole = sum(image in out for image in images)
        if whole == 0 and compression == "bz2":  # which packs 900 kB at a time
            with pytest.raises(DataError, match="cut off before its first complete message"):
                repair_bag(tmp_path / "cut.bag", tmp_path / "repaired.bag")
            continue
        repair = repair_bag(tmp_path / "cut.bag", tmp_path / "repaired.bag")
        with Reader(tmp_path / "repaired.bag") as reader:
            found = [(connection.topic, raw[-768:]) for connection, _, raw in reader.messages()]
        assert len(found) == repair.messages >= whole  # of LZ4 we unpack blocks that are not complete, too
        assert found == [(f"/camera/{n % 3}", image) for n, image in enumerate(images[: len(found)])]
        kept.append(len(found))
    assert kept == sorted(kept)


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_wherever_a_bag_ends_its_repair_can_be_read(compression: str, tmp_path: Path) -> None:
    """Also within the index of a chunk, where some of its topics are listed and others not yet."""
    images = write(tmp_path / "a.bag", compression, 2000)
    content = (tmp_path / "a.bag").read_bytes()
    last = 0
    for end in range(6000, len(content) - 600, 307):
        (tmp_path / "cut.bag").write_bytes(content[:end])
        repair = repair_bag(tmp_path / "cut.bag", tmp_path / "repaired.bag")
        with Reader(tmp_path / "repaired.bag") as reader:
            found = [raw[-768:] for _, _, raw in reader.messages()]
        assert found == images[: len(found)]
        assert len(found) == repair.messages >= last
        last = len(found)
    assert last == COUNT


def test_lz4_is_unpacked_up_to_the_cut() -> None:
    """Whole, it is what its maker's package unpacks; cut anywhere, it is the start of that."""
    text = b"".join(b"%d bottles of beer, " % (number * number) for number in range(4000))
    packed = lz4.frame.compress(text, block_linked=True)
    assert unpack_lz4(packed) == text
    for end in range(7, len(packed) - 4, 997):
        start = unpack_lz4(packed[:end], is_cut=True)
        assert text.startswith(start) and len(start) >= len(
            lz4.frame.LZ4FrameDecompressor().decompress(packed[:end])
        )
        with pytest.raises(ValueError, match="cut off"):
            unpack_lz4(packed[:end])
    assert unpack_lz4(packed, most_bytes=1000) == text[:1000]
