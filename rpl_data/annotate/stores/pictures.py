"""Pictures for the page, no larger than it needs."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import UInt8

from rpl_data.annotate.stores.scenes import SceneStore
from rpl_data.images import read_color, read_pixels
from rpl_data.orientation import without_orientation
from rpl_data.types import ColorImage, DataError, DepthImage, Frame

WIDTHS = (96, 160, 320, 640, 960, 1280, 1920)
"""Available widths; a request is served the next larger one, so that pictures can be cached."""
LOOK_PX = 51
"""Side of the cut-out around a click that is shown in the panels."""
TILE_PX, MARGIN_PX = 128, 16
"""Side and margin of a tile of depth; the margin exceeds what is read around a position."""
KEPT_BYTES = 48 * 2**20
QUALITY = 90
JPEG_SUFFIXES = (".jpg", ".jpeg")
REDUCTIONS = (8, 4, 2)


class PictureStore:
    """JPEG files of frames; the most recently used are cached."""

    def __init__(self, scenes: SceneStore) -> None:
        self._scenes = scenes
        self._kept: OrderedDict[tuple[str | int | float, ...], bytes] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def jpeg(self, scene: str, frame: int, width_px: int) -> bytes:
        """The frame as JPEG, at least that wide (full size for 0); edges stay edges."""
        return self._keep((scene, frame, width_px), lambda: self._make(scene, frame, width_px))

    def _keep(self, key: tuple[str | int | float, ...], make: Callable[[], bytes]) -> bytes:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        content = make()
        with self._lock:
            if key not in self._kept:
                self._kept[key] = content
                self._bytes += len(content)
            while self._bytes > KEPT_BYTES:
                self._bytes -= len(self._kept.popitem(last=False)[1])
        return content

    def look(self, scene: str, frame: int, u_px: float, v_px: float) -> bytes:
        """Cut out a small JPEG with a position in its centre."""
        key = (scene, frame, u_px, v_px)
        return self._keep(key, lambda: self._cut_out(scene, frame, u_px, v_px))

    def _cut_out(self, scene: str, frame: int, u_px: float, v_px: float) -> bytes:
        image = read_color(self._scenes.get(scene).frame(frame))
        near = (min(max(u_px, 0.0), image.shape[1] - 1.0), min(max(v_px, 0.0), image.shape[0] - 1.0))
        return encoded(cv2.getRectSubPix(image, (LOOK_PX, LOOK_PX), near).astype(np.uint8))

    def _make(self, scene: str, frame: int, width_px: int) -> bytes:
        posed = self._scenes.get(scene)
        source, full_px = posed.frame(frame), posed.scene.intrinsics.width
        width = next((w for w in WIDTHS if w >= width_px), full_px) if width_px else full_px
        if width >= full_px and source.color.suffix.lower() in JPEG_SUFFIXES and source.color.is_file():
            return without_orientation(source.color.read_bytes())
        return encoded(resized(_read(source, full_px, width), width))

    def stamp(self, scene: str, frame: int) -> str:
        """A stamp that changes when the image file does."""
        path = self._scenes.get(scene).frame(frame).color
        try:
            status = path.stat()
        except OSError as error:
            raise DataError(f"cannot read {path}: {error.strerror}") from error
        return f'"{status.st_mtime_ns:x}-{status.st_size:x}"'


def _read(source: Frame, full_px: int, width_px: int) -> ColorImage:
    """Read the image; a JPEG is decoded at 1/2, 1/4 or 1/8 of its size if that is still wide enough."""
    if source.color.suffix.lower() in JPEG_SUFFIXES:
        for reduction in REDUCTIONS:
            if full_px // reduction >= width_px:
                image = read_pixels(source.color, reduce=reduction)
                if image is not None:
                    return image
    return read_color(source)


def resized(image: ColorImage, width_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """Shrink the image to that width; it is never enlarged."""
    if width_px >= image.shape[1]:
        return image
    height_px = max(1, round(image.shape[0] * width_px / image.shape[1]))
    return cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA).astype(np.uint8)


def encoded(image: ColorImage, suffix: str = ".jpg") -> bytes:
    """Encode the image as a file."""
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if suffix == ".jpg" else []
    _, content = cv2.imencode(suffix, image[:, :, ::-1], options)
    return content.tobytes()


def depth_tile(depth_m: DepthImage, metres_per_unit: float, column: int, row: int) -> bytes:
    """Cut out a tile of stored depth with a margin on every side: 16-bit little-endian rows, 0 = none.

    A page asks for the surroundings of its cursor; a full image is too large for a slow link.
    """
    side = TILE_PX + 2 * MARGIN_PX
    tile = np.zeros((side, side), dtype="<u2")
    top, left = row * TILE_PX - MARGIN_PX, column * TILE_PX - MARGIN_PX
    rows = slice(max(0, top), max(0, min(depth_m.shape[0], top + side)))
    columns = slice(max(0, left), max(0, min(depth_m.shape[1], left + side)))
    stored = np.rint(depth_m[rows, columns] / metres_per_unit).clip(0, 65535)
    if stored.size:
        y, x = rows.start - top, columns.start - left
        tile[y : y + stored.shape[0], x : x + stored.shape[1]] = stored
    return tile.tobytes()
