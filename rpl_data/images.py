"""Read the images of a recording: colour, brightness, and depth aligned to the colour image."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from jaxtyping import UInt16

from rpl_data.registered import Registered, registered
from rpl_data.types import (
    ColorImage,
    DataError,
    DepthImage,
    DepthUnits,
    DepthWarp,
    Frame,
    GreyImage,
    ReadDepth,
    Scene,
)

REDUCED_GREY = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}


def read_color(frame: Frame) -> ColorImage:
    """Read the colour image as RGB; DataError when it is missing or damaged."""
    image = cv2.imread(str(frame.color), cv2.IMREAD_COLOR_RGB) if frame.color.is_file() else None
    if image is None:
        raise _no_color(frame)
    return image


def read_grey(frame: Frame, *, reduce: int) -> GreyImage:
    """Read the brightness of the colour image at `1 / reduce` (1, 2, 4, 8) of its size.

    DataError when it is missing or broken. A JPEG is decoded at the small size, which takes a fraction of
    the time.
    """
    image = cv2.imread(str(frame.color), REDUCED_GREY[reduce]) if frame.color.is_file() else None
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
    found: DepthUnits = np.rint(in_metres(scene, units) / scene.metres_per_unit).astype(np.uint16)
    return found


def read_depth_units(scene: Scene, frame: Frame) -> UInt16[np.ndarray, "height width"]:
    """Read the depth image as it is stored, its size included, 0 = none; DataError as `read_depth_m`."""
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
    units = raw.astype(np.uint16, copy=False)
    for value in scene.no_depth_units:
        units[units == value] = 0
    return units if scene.depth_warp is None else _warped(units, scene.depth_warp)


def _warped(raw: UInt16[np.ndarray, "height width"], warp: DepthWarp) -> UInt16[np.ndarray, "height width"]:
    """Move depth onto the colour image; each pixel takes the nearest value, 0 where there is none."""
    height, width = raw.shape
    offset = (1 - warp.zoom) * (np.array([width, height]) - 1) / 2 + warp.shift_px
    matrix = np.column_stack([warp.zoom * np.eye(2), offset])
    return np.asarray(cv2.warpAffine(raw, matrix, (width, height), flags=cv2.INTER_NEAREST), np.uint16)
