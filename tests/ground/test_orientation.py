"""A tag that would turn an image never turns its pixels here, and never leaves with an export."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from rpl_data.formats.containers.klg import index_klg, klg_color, klg_image_size
from rpl_data.formats.recordings.depth_files import read_depth_file
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.images import read_color, read_grey, read_pixels
from rpl_data.orientation import orientation_of, without_orientation
from rpl_data.torch.image_files import read_image
from rpl_data.types import Frame

PIXELS = np.arange(24 * 40 * 3, dtype=np.uint32).reshape(24, 40, 3).astype(np.uint8)
XMP = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="%d"/></x:xmpmeta>'


def tagged(suffix: str, orientation: int, *, by: str = "exif") -> bytes:
    """An image whose tag asks to turn it."""
    file, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = orientation
    options = {"exif": exif} if by == "exif" else {"xmp": XMP % orientation}
    kind = {"jpg": "JPEG", "png": "PNG", "tif": "TIFF", "webp": "WEBP"}[suffix]
    if by == "exif" and suffix == "tif":
        options = {"tiffinfo": {0x0112: orientation}}  # type: ignore[dict-item]
    if suffix == "webp":
        options["lossless"] = True  # type: ignore[assignment]
    Image.fromarray(PIXELS).save(file, kind, **options)
    return file.getvalue()


CASES = [("jpg", "exif"), ("jpg", "xmp"), ("png", "exif"), ("tif", "exif"), ("webp", "exif"), ("webp", "xmp")]


@pytest.mark.parametrize(("suffix", "by"), CASES)
@pytest.mark.parametrize("orientation", [1, 2, 3, 6, 8])
def test_every_reader_sees_the_pixels_as_stored(
    tmp_path: Path, suffix: str, by: str, orientation: int
) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(tagged(suffix, orientation, by=by))
    assert orientation_of(path) == orientation
    frame = Frame(0, 0.0, path, None)
    header = probe(path)
    assert header is not None and (header.width, header.height) == (40, 24)
    stored = PIXELS if suffix != "jpg" else np.asarray(Image.open(path))
    np.testing.assert_allclose(read_color(frame).astype(int), stored, atol=4)
    np.testing.assert_array_equal(read_image(str(path)), read_color(frame))
    assert read_grey(frame, reduce=1).shape == (24, 40)
    assert read_pixels(path, reduce=2).shape == (12, 20, 3)  # type: ignore[union-attr]


@pytest.mark.parametrize(("suffix", "by"), CASES)
def test_without_its_tag_an_image_is_the_same_to_all(tmp_path: Path, suffix: str, by: str) -> None:
    from torchvision.io import decode_image

    path = tmp_path / f"a.{suffix}"
    path.write_bytes(tagged(suffix, 6, by=by))
    stored = PIXELS if suffix != "jpg" else np.asarray(Image.open(path))
    path.write_bytes(without_orientation(path.read_bytes()))
    assert orientation_of(path) == 1
    for image in (Image.open(path), ImageOps.exif_transpose(Image.open(path))):
        np.testing.assert_array_equal(np.asarray(image), stored)
    np.testing.assert_allclose(cv2.imread(str(path))[..., ::-1].astype(int), stored, atol=4)
    if suffix != "tif":
        turned = decode_image(str(path), apply_exif_orientation=True).permute(1, 2, 0).numpy()
        np.testing.assert_allclose(turned.astype(int), stored, atol=4)


def test_depth_in_a_tiff_is_not_turned_either(tmp_path: Path) -> None:
    depth = np.arange(24 * 40, dtype=np.uint16).reshape(24, 40)
    path = tmp_path / "a.tif"
    Image.fromarray(depth).save(path, tiffinfo={0x0112: 3})
    np.testing.assert_array_equal(read_depth_file(path), depth)


def test_an_image_without_a_tag_is_left_as_it_is() -> None:
    for suffix in ("jpg", "png", "tif", "webp"):
        content = tagged(suffix, 1)
        assert without_orientation(content) is content
    assert without_orientation(b"\xff\xd8\xff") == b"\xff\xd8\xff"


def test_imagemagicks_profile_in_a_png_is_found(tmp_path: Path) -> None:
    """Hexadecimal text in a packed chunk, as ImageMagick and older tools write it."""
    exif = Image.Exif()
    exif[0x0112] = 8
    block = exif.tobytes()
    text = f"\nexif\n{len(block):8d}\n{block.hex()}\n".encode()
    body = b"zTXtRaw profile type exif\0\0" + zlib.compress(text)
    chunk = (len(body) - 4).to_bytes(4) + body + zlib.crc32(body).to_bytes(4)
    plain = cv2.imencode(".png", PIXELS[..., ::-1])[1].tobytes()
    path = tmp_path / "a.png"
    path.write_bytes(plain[:33] + chunk + plain[33:])
    assert orientation_of(path) == 8
    np.testing.assert_array_equal(read_pixels(path), PIXELS)
    assert without_orientation(path.read_bytes()) == plain


def test_a_tagged_jpeg_in_a_log_is_not_turned(tmp_path: Path) -> None:
    depth, jpeg = np.full((24, 40), 700, "<u2").tobytes(), tagged("jpg", 6)
    header = struct.pack("<i", 1) + struct.pack("<qii", 0, len(depth), len(jpeg))
    (tmp_path / "a.klg").write_bytes(header + depth + jpeg)
    index = index_klg(tmp_path / "a.klg")
    assert klg_image_size(tmp_path / "a.klg", index) == (40, 24)
    with (tmp_path / "a.klg").open("rb") as file:
        color = klg_color(file, index.entries[0], (40, 24), bgr=True)
    assert isinstance(color, np.ndarray) and color.shape == (24, 40, 3)
