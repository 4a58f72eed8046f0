"""Ultralytics' YOLO labels as text: one line per instance, classes from 0, lengths as shares of the image.

::

    detect    class xc yc w h
    segment   class x1 y1 x2 y2 ...            one polygon; the parts of an object that is hidden in between,
                                               and its holes, are joined to it by lines of zero width
    pose      class xc yc w h (x y v) ...      as many keypoints as the object with most keypoints has

Lengths are measured from the image's edge, but our pixels have their centres at whole numbers: add 0.5 px.
A keypoint that is not labelled or lies outside the image is 0 0 0, since the trainer refuses others.
A mirrored object is another object, so `flip_idx` is left out and `fliplr` must be 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import yaml
from jaxtyping import Float64, Int32, UInt8

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Entry = Mapping[str, Any]
"""An image, annotation or category of a COCO file, which is only read."""


def detect_line(image: Entry, annotation: Entry, categories: Sequence[Entry]) -> str:
    """Write the class and the box of the visible part."""
    x, y, w, h = annotation["bbox"]
    width, height = image["width"], image["height"]
    sides = [(x + w / 2) / width, (y + h / 2) / height, w / width, h / height]
    return f"{annotation['category_id'] - 1} {_shares(sides)}"


def segment_line(image: Entry, annotation: Entry, categories: Sequence[Entry]) -> str:
    """Write the class and the outline of the visible mask, holes left out."""
    from pycocotools import mask as masks

    outline = outline_of(masks.decode(annotation["segmentation"])) / [image["width"], image["height"]]
    return f"{annotation['category_id'] - 1} {_shares(outline.ravel().tolist())}"


def pose_line(image: Entry, annotation: Entry, categories: Sequence[Entry]) -> str:
    """Write the line of `detect_line` followed by the keypoints."""
    most = max(len(category["keypoints"]) for category in categories)
    words = [detect_line(image, annotation, categories)]
    flat = annotation["keypoints"]
    for u, v, seen in zip(flat[::3], flat[1::3], flat[2::3], strict=True):
        x, y = (u + 0.5) / image["width"], (v + 0.5) / image["height"]
        inside = seen > 0 and 0 <= x <= 1 and 0 <= y <= 1
        words.append(f"{_shares([x, y])} {seen}" if inside else "0 0 0")
    return " ".join([*words, *["0 0 0"] * (most - len(flat) // 3)])


LINES: dict[str, Callable[[Entry, Entry, Sequence[Entry]], str]] = {
    "detect": detect_line,
    "segment": segment_line,
    "pose": pose_line,
}
"""Writers of an annotation's line, by task, given its image and all categories of our COCO dialect."""


def data_yaml(task: str, categories: Sequence[Entry], splits: Sequence[str]) -> str:
    """Write the YAML file for the trainer; validation uses the training split where there is no other."""
    content: dict[str, Any] = {split: f"images/{split}" for split in splits}
    content.setdefault("val", content.get("train", f"images/{splits[0]}"))
    content.setdefault("train", content["val"])
    content["names"] = {category["id"] - 1: category["name"] for category in categories}
    if task == "pose":
        content["kpt_shape"] = [max(len(category["keypoints"]) for category in categories), 3]
    return str(yaml.safe_dump(content, sort_keys=False))


def _shares(values: Sequence[float]) -> str:
    return " ".join(f"{min(max(value, 0.0), 1.0):.6f}" for value in values)


LEAST_POINTS = 3
"""Readers take fewer for a box, or for damage."""

ON_PIXEL_PX = 0.495
"""Where the outline crosses its pixels, from their left and upper edges.

It is their middle, but a little less: some readers cut coordinates off to whole pixels (Ultralytics), others
round them (supervision), and both then find the same pixel.
"""

Bridge = tuple[float, Int32[np.ndarray, "2"], int]
"""Length of a line to an outline, the point where it starts, and the outline's row where it ends."""


def outline_of(mask: UInt8[np.ndarray, "height width"]) -> Float64[np.ndarray, "n 2"]:
    """Trace a mask that is not empty as one polygon, in pixels from the image's edge.

    It goes through the outermost pixels, which readers draw with it (as cv2.fillPoly and PIL do).
    """
    found, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outline = _joined([ring[:, 0] for ring in sorted(found, key=len, reverse=True)])
    few = max(0, LEAST_POINTS - len(outline))  # one pixel, or a straight line
    return np.concatenate([outline, outline[:1].repeat(few, axis=0)]) + ON_PIXEL_PX


def _joined(rings: Sequence[Int32[np.ndarray, "_ 2"]]) -> Int32[np.ndarray, "n 2"]:
    """Join closed outlines into one: always the nearest next, by going there and back on the same line."""
    from scipy.spatial import cKDTree

    outline, *others = rings
    nearest = [_nearest(cKDTree(outline), ring) for ring in others]
    while others:
        row = min(range(len(others)), key=lambda number: _length(nearest[number]))
        ring, (_, here, there) = others.pop(row), nearest.pop(row)
        (at,) = np.flatnonzero((outline == here).all(axis=1))[:1]
        outline = np.concatenate([outline[: at + 1], ring[there:], ring[: there + 1], outline[at:]])
        tree = cKDTree(ring)
        to_new = [_nearest(tree, other) for other in others]
        nearest = [min(pair, key=_length) for pair in zip(nearest, to_new, strict=True)]
    return outline


def _nearest(tree: cKDTree, ring: Int32[np.ndarray, "_ 2"]) -> Bridge:
    apart, rows = tree.query(ring)
    there = int(apart.argmin())
    return float(apart[there]), tree.data[rows[there]].astype(np.int32), there


def _length(bridge: Bridge) -> float:
    return bridge[0]
