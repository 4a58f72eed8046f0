"""The tag by which an image asks its viewer to turn it, found and taken out without touching a pixel.

A phone stores the rows as its sensor reads them, and a tag that says how it was held: EXIF's orientation,
1 to 8, where 1 means "as stored", or the same number in XMP. Some readers obey it (browsers, OpenCV), others
do not (PIL, torchvision), and depth images have none: this project never turns pixels, and exports no tag.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

AS_STORED = 1
_ORIENTATION_TAG = 0x0112
_JPEG, _PNG = b"\xff\xd8", b"\x89PNG\r\n\x1a\n"
_RIFF, _WEBP = b"RIFF", b"WEBP"
_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
_SCAN = 0xDA
_PNG_TEXTS = (b"tEXt", b"zTXt", b"iTXt")
_PNG_METADATA = re.compile(rb"(XML:com\.adobe\.xmp|Raw profile type (exif|APP1|xmp))\0")
_XMP_ORIENTATION = re.compile(rb"tiff:Orientation(?:=[\"']|>)([1-8])")
_TIFF = (b"II*\0", b"MM\0*")

_MOST_METADATA = 1 << 20
"""Bytes of unpacked metadata that are looked at: a small file may expand to gigabytes."""

Content = bytes | mmap.mmap


def orientation_of(path: Path) -> int:
    """Orientation that the tag of a JPEG, PNG, WebP or TIFF asks for, 1 to 8; 1 where there is none."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return orientation_in(content)
    except (OSError, ValueError):  # ValueError: the file is empty
        return AS_STORED


def orientation_in(content: Content) -> int:
    """Orientation as `orientation_of`, of the content of an image file."""
    if content[:4] in _TIFF:
        return _of_tiff(content) or AS_STORED
    blocks = [block for _, _, block in _metadata(content)]
    found = [_of_tiff(_exif_of(block)) for block in blocks] + [_of_xmp(block) for block in blocks]
    return next((asked for asked in found if asked), AS_STORED)


def without_orientation(content: bytes) -> bytes:
    """The same image without its tag: the metadata that hold it are left out, the pixels stay as they are.

    A TIFF's tag is set to 1. Formats without such a tag are returned unchanged.
    """
    if orientation_in(content) == AS_STORED:
        return content
    if content[:4] in _TIFF:
        return _untagged_tiff(content)
    kept, at = b"", 0
    for first, behind, _ in _metadata(content):
        kept, at = kept + content[at:first], behind
    kept += content[at:]
    return _webp_of_its_size(kept) if _is_webp(kept) else kept


def _metadata(content: Content) -> Iterator[tuple[int, int, bytes]]:
    """First byte, byte behind the end, and content of each block that may hold the tag."""
    if content[:2] == _JPEG:
        for at, behind, marker in _jpeg_segments(content):
            block = content[at + 4 : behind]
            if marker == 0xE1 and block.startswith((_EXIF, _XMP)):
                yield at, behind, block
    elif content[:8] == _PNG:
        for at, behind, kind in _png_chunks(content):
            block = content[at + 8 : behind - 4]
            if kind == b"eXIf" or (kind in _PNG_TEXTS and _PNG_METADATA.match(block)):
                yield at, behind, block
    elif _is_webp(content):
        for at, behind, kind in _webp_chunks(content):
            if kind in (b"EXIF", b"XMP "):
                yield at, behind, content[at + 8 : behind]


def _jpeg_segments(content: Content) -> Iterator[tuple[int, int, int]]:
    """First byte, byte behind the end, and marker of each segment in front of the pixels."""
    at = 2
    while at + 4 <= len(content) and content[at] == 0xFF:
        marker = content[at + 1]
        if marker == 0xFF:  # padding
            at += 1
            continue
        behind = at + 2 + int.from_bytes(content[at + 2 : at + 4])
        if marker == _SCAN or behind < at + 4:
            return
        yield at, behind, marker
        at = behind


def _png_chunks(content: Content) -> Iterator[tuple[int, int, bytes]]:
    at = len(_PNG)
    while at + 12 <= len(content):
        behind = at + 12 + int.from_bytes(content[at : at + 4])
        yield at, behind, content[at + 4 : at + 8]
        at = behind


def _is_webp(content: Content) -> bool:
    return content[:4] == _RIFF and content[8:12] == _WEBP


def _webp_chunks(content: Content) -> Iterator[tuple[int, int, bytes]]:
    at = 12
    while at + 8 <= len(content):
        size = int.from_bytes(content[at + 4 : at + 8], "little")
        behind = at + 8 + size + size % 2
        yield at, behind, content[at : at + 4]
        at = behind


def _webp_of_its_size(content: bytes) -> bytes:
    """A WebP file whose header says its size, and that it holds neither EXIF (bit 3) nor XMP (bit 2)."""
    header = content[:4] + (len(content) - 8).to_bytes(4, "little") + content[8:20]
    if content[12:16] != b"VP8X":
        return header + content[20:]
    return header + bytes([content[20] & ~0b1100]) + content[21:]


def _exif_of(block: bytes) -> bytes:
    """The TIFF block within a block of metadata: hexadecimal, mostly packed, where ImageMagick wrote it."""
    if not block.startswith(b"Raw profile"):
        return block.removeprefix(_EXIF)
    text = block.partition(b"\0")[2]
    try:
        text = zlib.decompressobj().decompress(text[1:], _MOST_METADATA) if text.startswith(b"\0") else text
        return bytes.fromhex("".join(text.decode("ascii").split()[2:])).removeprefix(_EXIF)
    except (ValueError, zlib.error):
        return b""


def _of_xmp(block: bytes) -> int:
    found = _XMP_ORIENTATION.search(block)
    return int(found[1]) if found else 0


def _of_tiff(block: Content) -> int:
    """Orientation in the first directory of a TIFF block; 0 where there is none."""
    at = _tag_at(block)
    if at is None:
        return 0
    value = struct.unpack_from(_order(block) + "H", block, at)[0]
    return int(value) if 1 <= value <= 8 else 0


def _tag_at(block: Content) -> int | None:
    """Where the value of the orientation tag stands in a TIFF block."""
    order = _order(block)
    try:
        (first,) = struct.unpack_from(order + "I", block, 4)
        (count,) = struct.unpack_from(order + "H", block, first)
        for entry in range(first + 2, first + 2 + 12 * count, 12):
            if struct.unpack_from(order + "H", block, entry)[0] == _ORIENTATION_TAG:
                struct.unpack_from(order + "H", block, entry + 8)
                return entry + 8
    except struct.error:
        pass
    return None


def _order(block: Content) -> str:
    return "<" if block[:2] == b"II" else ">"


def _untagged_tiff(content: bytes) -> bytes:
    at = _tag_at(content)
    if at is None:
        return content
    return content[:at] + struct.pack(_order(content) + "H", AS_STORED) + content[at + 2 :]
