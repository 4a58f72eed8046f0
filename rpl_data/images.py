"""Read the images of a recording: colour, brightness, and depth aligned to the colour image."""

from __future__ import annotations

from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt16

from rpl_data.files import read_bytes
from rpl_data.geometry import rays
from rpl_data.orientation import without_orientation
from rpl_data.registered import Registered, registered
from rpl_data.types import (
    ColorImage,
    DataError,
    DepthImage,
    DepthUnits,
    DepthWarp,
    Frame,
    GreyImage,
    Intrinsics,
    ReadDepth,
    Scene,
)

AS_STORED = cv2.IMREAD_IGNORE_ORIENTATION
"""A tag may ask viewers to turn an image; depth has no such tag, so pixels stay where they are stored."""

MOST_UNITS = np.iinfo(np.uint16).max
"""What 16 bits hold; a Kinect writes it where it measured nothing."""

REDUCED_GREY = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}

REDUCED_RGB = {
    1: cv2.IMREAD_COLOR_RGB,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2 | cv2.IMREAD_COLOR_RGB,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4 | cv2.IMREAD_COLOR_RGB,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8 | cv2.IMREAD_COLOR_RGB,
}
"""The colours come from the RGB flag, the size from the other."""


def read_pixels(path: str | Path, *, reduce: int = 1) -> ColorImage | None:
    """Decode an image file as RGB at `1 / reduce` (1, 2, 4, 8) of its size; None where it cannot be read.

    The one decoder of colour: whatever looks at an image of a recording or an export sees these pixels.
    """
    return _decoded(Path(path), REDUCED_RGB[reduce])


def _decoded(path: Path, flags: int) -> np.ndarray | None:
    if not path.is_file():
        return None
    if path.suffix.lower() in (".tif", ".tiff"):  # whose decoder turns them, whatever the flags say
        content = np.frombuffer(without_orientation(read_bytes(path)), np.uint8)
        return cv2.imdecode(content, flags | AS_STORED) if len(content) else None
    return cv2.imread(str(path), flags | AS_STORED)


def decode_pixels(content: bytes) -> ColorImage | None:
    """Decode the bytes of an image file as `read_pixels` does."""
    flags = cv2.IMREAD_COLOR_RGB | AS_STORED
    image: ColorImage | None = cv2.imdecode(np.frombuffer(without_orientation(content), np.uint8), flags)
    return image


def read_color(frame: Frame) -> ColorImage:
    """Read the colour image as RGB; DataError when it is missing or damaged."""
    image = read_pixels(frame.color)
    if image is None:
        raise _no_color(frame)
    return image


def read_grey(frame: Frame, *, reduce: int) -> GreyImage:
    """Read the brightness of the colour image at `1 / reduce` (1, 2, 4, 8) of its size.

    DataError when it is missing or broken. A JPEG is decoded at the small size, which takes a fraction of
    the time.
    """
    image = _decoded(frame.color, REDUCED_GREY[reduce])
    if image is None:
        raise _no_color(frame)
    return image


def _no_color(frame: Frame) -> DataError:
    return DataError(
        f"frame {frame.index}: cannot read the colour image {frame.color}; it is missing or broken"
    )


def read_depth_m(scene: Scene, frame: Frame) -> DepthImage:
    """Read the depth image in metres, 0 = none; DataError when it is missing, damaged or of another size."""
    return in_metres(scene, read_depth_units(scene, frame))


def depth_reader(scene: Scene) -> ReadDepth:
    """Read the depth images of a scene from its recording, without a cache."""
    return partial(read_depth_m, scene)


def in_metres(scene: Scene, units: DepthUnits) -> Registered:
    """Convert stored depth to float32 metres at the pixels of the colour image."""
    depth_m = units.astype(np.float32) * np.float32(scene.metres_per_unit)
    camera = scene.depth_camera
    if camera is None:
        return depth_m
    return registered(depth_m, camera.intrinsics, scene.intrinsics, camera.matrix)


def registered_units(scene: Scene, frame: Frame) -> DepthUnits:
    """The depth image in the scene's unit at the pixels of the colour image; DataError as `read_depth_m`."""
    units = read_depth_units(scene, frame)
    if scene.depth_camera is None:
        return units
    found = np.rint(in_metres(scene, units) / scene.metres_per_unit)
    return np.where(found < MOST_UNITS, found, 0).astype(np.uint16)


def marks_no_depth(scene: Scene, frame: Frame) -> bool:
    """Whether numbers other than 0 stand for "no depth" in an image that can be read.

    Other readers would take them for depth.
    """
    if not scene.no_depth_units:
        return False
    try:
        raw = _stored_depth(scene, frame)
    except DataError:
        return False
    return any(bool((raw == value).any()) for value in scene.no_depth_units)


def read_depth_units(scene: Scene, frame: Frame) -> UInt16[np.ndarray, "height width"]:
    """Read the depth image as it is stored, its size included, 0 = none; DataError as `read_depth_m`."""
    units = _stored_depth(scene, frame)
    for value in scene.no_depth_units:
        units[units == value] = 0
    if scene.depth_coding.bits_turned:
        units = turned_back(units)
    if scene.depth_coding.along_ray:
        units = np.rint(units / _ray_lengths(scene.depth_intrinsics)).astype(np.uint16)
    if scene.depth_warp is None:
        return units
    own, color = scene.depth_intrinsics, scene.intrinsics
    return _warped(units, scene.depth_warp, (own.fx / color.fx, own.fy / color.fy))


def _stored_depth(scene: Scene, frame: Frame) -> UInt16[np.ndarray, "height width"]:
    """The numbers in the depth image; DataError as `read_depth_m`."""
    if frame.depth is None:
        raise DataError(f"scene {scene.name}, frame {frame.index} has no depth image")
    raw = cv2.imread(str(frame.depth), cv2.IMREAD_UNCHANGED) if frame.depth.is_file() else None
    expected = scene.depth_size
    if raw is None or raw.dtype != np.uint16 or raw.shape != expected:
        found = "nothing readable" if raw is None else f"{raw.dtype} {raw.shape}"
        raise DataError(
            f"scene {scene.name}, frame {frame.index}: {frame.depth} should be a 16-bit image of "
            f"{expected[1]} x {expected[0]} px, found {found}; record it again or delete it"
        )
    stored: UInt16[np.ndarray, "height width"] = raw.astype(np.uint16, copy=False)
    return stored


def turned_back(units: DepthUnits) -> DepthUnits:
    """Turn the 16 bits of each number right by 3, as SUN3D's own reader does."""
    return (units >> 3) | (units << 13)


@lru_cache(maxsize=4)
def _ray_lengths(camera: Intrinsics) -> Float64[np.ndarray, "height width"]:
    """Length of the ray through each pixel up to 1 m along the optical axis."""
    v, u = np.mgrid[: camera.height, : camera.width]
    directions = rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    lengths: Float64[np.ndarray, "height width"] = np.linalg.norm(directions, axis=1).reshape(u.shape)
    return lengths


def _warped(
    raw: UInt16[np.ndarray, "height width"], warp: DepthWarp, depth_per_color: tuple[float, float]
) -> UInt16[np.ndarray, "height width"]:
    """Move depth onto the colour image; each pixel takes the nearest value, 0 where there is none.

    Args:
        depth_per_color: pixels of the depth image per pixel of the colour image, right and down.
    """
    height, width = raw.shape
    shift_px = np.array(warp.shift_px) * depth_per_color
    offset = (1 - warp.zoom) * (np.array([width, height]) - 1) / 2 + shift_px
    matrix = np.column_stack([warp.zoom * np.eye(2), offset])
    return np.asarray(cv2.warpAffine(raw, matrix, (width, height), flags=cv2.INTER_NEAREST), np.uint16)
