"""Draw labels on the images they belong to."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping
from zlib import crc32

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from rpl_data.types import Box, ColorImage, FrameLabel, InstanceLabel, Intrinsics, KeypointModel, Rle

Rgb = tuple[int, int, int]

OBJECT_COLORS: tuple[Rgb, ...] = (
    (46, 196, 182),
    (255, 159, 28),
    (156, 106, 222),
    (90, 170, 255),
    (240, 98, 146),
)
"""Colours of the first, second, ... object; they repeat."""
SMALLEST_VIEW_PX = 160.0
"""Smallest width of the part of an image that is shown: a smaller part would be magnified to coarse
pixels."""
SHIFT_BITS = 4
"""OpenCV draws at 1/16 px with this: rounding to pixels would hide half-pixel errors."""


def keypoint_color(keypoint: int, count: int) -> Rgb:
    """Bright colour of a keypoint; keypoints with neighbouring numbers have very different hues."""
    step = next(s for s in (3, 5, 7, 2, 1) if count % s or s == 1)
    red, green, blue = colorsys.hsv_to_rgb((keypoint * step % count) / count, 0.75, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)


def instance_number(name: str) -> int:
    """A number of an instance, by its name alone: 0 for the one without a name, 1 for `2`, and so on."""
    if name.isdecimal():
        return int(name) - 1
    return 1 + crc32(name.encode()) % 7 if name else 0


def tint_of(row: int, instance: int, *, objects: int) -> Rgb:
    """Colour of an instance of an object; more of it take colours of no object where there are some."""
    colors = len(OBJECT_COLORS)
    step = objects if objects % colors else 1
    return OBJECT_COLORS[(row + step * instance) % colors]


def view_of(label: FrameLabel, intrinsics: Intrinsics) -> Box:
    """The 4:3 part of the image around all objects; the whole image when none is there or all is needed."""
    width, height = float(intrinsics.width), float(intrinsics.height)
    whole = (0.0, 0.0, width, height)
    if not label.instances:
        return whole
    edges = np.array([instance.box_full for instance in label.instances])
    for instance in label.instances:
        box = instance.square_box
        half = 0.53 * box.side_px + 2
        edges = np.vstack([edges, [box.cx_px - half, box.cy_px - half, box.cx_px + half, box.cy_px + half]])
    x0, y0 = np.clip(edges[:, :2].min(axis=0), 0, [width, height])
    x1, y1 = np.clip(edges[:, 2:].max(axis=0), 0, [width, height])
    wanted = max(x1 - x0, (y1 - y0) * 4 / 3, SMALLEST_VIEW_PX)
    if wanted >= width or wanted * 3 / 4 >= height:
        return whole
    left = float(np.clip((x0 + x1 - wanted) / 2, 0, width - wanted))
    top = float(np.clip((y0 + y1 - wanted * 3 / 4) / 2, 0, height - wanted * 3 / 4))
    return left, top, left + wanted, top + wanted * 3 / 4


def draw_overlay(
    color: ColorImage,
    label: FrameLabel,
    models: Mapping[str, KeypointModel],
    *,
    view: Box | None = None,
    width_px: int | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the labels on a copy of the image: tinted visible mask, boxes, skeleton, numbered keypoints.

    A keypoint is a filled dot when it is seen (v = 2) and a ring when it is hidden (v = 1). An object that
    `models` lacks is drawn without its skeleton. `view` is the part of the image to show, the whole
    when None; `width_px` is the width of the result: lines stay thin when the view is enlarged.
    """
    x0, y0, x1, y1 = view or (0.0, 0.0, float(color.shape[1]), float(color.shape[0]))
    scale = (width_px or x1 - x0) / (x1 - x0)
    size = (round((x1 - x0) * scale), round((y1 - y0) * scale))
    # Edges stay edges: pixel (u, v) covers [u, u + 1) in box coordinates, which start at the view's corner.
    view_from_box = np.array([[scale, 0, -x0 * scale], [0, scale, -y0 * scale]])
    view_from_pixel = view_from_box.copy()
    view_from_pixel[:, 2] += scale / 2 - 0.5
    picture = cv2.warpAffine(color, view_from_pixel, size, flags=cv2.INTER_LINEAR).astype(np.uint8)
    order = sorted(models)
    for number, instance in enumerate(label.instances):
        first = order.index(instance.object) if instance.object in order else number
        tint = tint_of(first, instance_number(instance.instance), objects=len(order))
        _draw_masks(picture, instance, tint, view_from_pixel)
        _draw_boxes(picture, instance, tint, view_from_box)
        _draw_keypoints(picture, instance, models.get(instance.object), view_from_pixel)
    return picture


def _draw_masks(
    picture: ColorImage, instance: InstanceLabel, tint: Rgb, view_from_pixel: Float64[np.ndarray, "2 3"]
) -> None:
    """Draw the visible mask tinted, with its outline, and a thin outline of the full mask."""
    visible, full = (
        _mask_in_view(rle, picture, view_from_pixel) for rle in (instance.mask, instance.mask_full)
    )
    inside = visible > 0
    picture[inside] = (0.76 * picture[inside] + 0.24 * np.array(tint)).astype(np.uint8)
    for mask, rgb in ((full, (235, 235, 235)), (visible, tint)):
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outlines, -1, rgb, 1, cv2.LINE_AA)


def _mask_in_view(rle: Rle, picture: ColorImage, view_from_pixel: Float64[np.ndarray, "2 3"]) -> np.ndarray:
    from pycocotools import mask as coco_mask

    size = (picture.shape[1], picture.shape[0])
    mask = cv2.warpAffine(np.ascontiguousarray(coco_mask.decode(rle)) * 255, view_from_pixel, size)
    return (mask > 127).astype(np.uint8)


def _draw_boxes(
    picture: ColorImage, instance: InstanceLabel, tint: Rgb, view_from_box: Float64[np.ndarray, "2 3"]
) -> None:
    """Draw the box of the visible mask, and the square box of the keypoints thin and white."""
    square = instance.square_box
    half = square.side_px / 2
    # The square is centred on pixel coordinates, boxes count from pixel edges: half a pixel between them.
    cx, cy = square.cx_px + 0.5, square.cy_px + 0.5
    boxes: list[tuple[Box, Rgb]] = [((cx - half, cy - half, cx + half, cy + half), (200, 200, 200))]
    if instance.box is not None:
        boxes.append((instance.box, tint))
    for (x0, y0, x1, y1), rgb in boxes:
        corners = (
            np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) @ view_from_box[:, :2].T + view_from_box[:, 2]
        )
        # Box edges lie between pixels; OpenCV draws through centres.
        outline = np.round((corners - 0.5) * 2**SHIFT_BITS).astype(np.int32)
        cv2.polylines(picture, [outline], True, rgb, 1, cv2.LINE_AA, SHIFT_BITS)


def _draw_keypoints(
    picture: ColorImage,
    instance: InstanceLabel,
    model: KeypointModel | None,
    view_from_pixel: Float64[np.ndarray, "2 3"],
) -> None:
    pixels = instance.keypoints_px @ view_from_pixel[:, :2].T + view_from_pixel[:, 2]
    drawn = (instance.visibility > 0) & np.isfinite(pixels).all(axis=1)
    for a, b in model.skeleton if model else ():
        if drawn[a] and drawn[b]:
            cv2.line(
                picture, _fixed(pixels[a]), _fixed(pixels[b]), (250, 250, 250), 1, cv2.LINE_AA, SHIFT_BITS
            )
    radius = 5 * 2**SHIFT_BITS
    for k in np.flatnonzero(drawn):
        rgb, centre = keypoint_color(int(k), len(pixels)), _fixed(pixels[k])
        if instance.visibility[k] == 2:
            cv2.circle(picture, centre, radius, rgb, cv2.FILLED, cv2.LINE_AA, SHIFT_BITS)
            cv2.circle(picture, centre, radius, (20, 20, 20), 1, cv2.LINE_AA, SHIFT_BITS)
        else:
            cv2.circle(picture, centre, radius, (20, 20, 20), 4, cv2.LINE_AA, SHIFT_BITS)
            cv2.circle(picture, centre, radius, rgb, 2, cv2.LINE_AA, SHIFT_BITS)
    for k in np.flatnonzero(drawn):
        _write_number(picture, int(k), pixels[k])


def _write_number(picture: ColorImage, keypoint: int, at: Float64[np.ndarray, "2"]) -> None:
    """Write the number beside its keypoint, white with a dark rim, readable on any background."""
    corner = (round(float(at[0])) + 7, round(float(at[1])) - 6)
    for color, thickness in (((15, 15, 15), 3), ((255, 255, 255), 1)):
        cv2.putText(
            picture, str(keypoint), corner, cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, thickness, cv2.LINE_AA
        )


def _fixed(pixel: Float64[np.ndarray, "2"]) -> tuple[int, int]:
    """Convert to OpenCV's fixed-point coordinates."""
    return round(float(pixel[0]) * 2**SHIFT_BITS), round(float(pixel[1]) * 2**SHIFT_BITS)
