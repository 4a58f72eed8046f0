"""Ultralytics' YOLO labels as text: one line per instance, classes from 0, lengths as shares of the image.

::

    detect    class xc yc w h
    segment   class x1 y1 x2 y2 ...            one polygon; if the object is hidden in between, its parts
                                               are joined by lines of zero width
    pose      class xc yc w h (x y v) ...      as many keypoints as the object with most keypoints has

Lengths are measured from the image's edge, but our pixels have their centres at whole numbers: add 0.5 px.
A keypoint that is not labelled or lies outside the image is 0 0 0, since the trainer refuses others.
A mirrored object is another object, so `flip_idx` is left out and `fliplr` must be 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import yaml
from jaxtyping import Float64

Entry = Mapping[str, Any]
"""An image, annotation or category of a COCO file, which is only read."""


def detect_line(image: Entry, annotation: Entry, categories: Sequence[Entry]) -> str:
    """Write the class and the box of the visible part."""
    x, y, w, h = annotation["bbox"]
    width, height = image["width"], image["height"]
    sides = [(x + w / 2) / width, (y + h / 2) / height, w / width, h / height]
    return f"{annotation['category_id'] - 1} {_shares(sides)}"


def segment_line(image: Entry, annotation: Entry, categories: Sequence[Entry]) -> str:
    """Write the class and the outline of the visible mask; empty for a mask too small to have one."""
    from pycocotools import mask as masks

    mask = masks.decode(annotation["segmentation"])
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    parts = [part[:, 0].astype(np.float64) for part in found if len(part) >= 3]
    if not parts:
        return ""
    outline = (_joined(parts) + 0.5) / [image["width"], image["height"]]
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


def _joined(parts: Sequence[Float64[np.ndarray, "_ 2"]]) -> Float64[np.ndarray, "n 2"]:
    """Join several outlines into one; each further part is traversed from its point nearest to the rest."""
    first, *others = sorted(parts, key=len, reverse=True)
    outline = first
    for part in others:
        apart = np.linalg.norm(outline[:, None] - part[None], axis=2)
        here, there = np.unravel_index(int(apart.argmin()), apart.shape)
        round_trip = np.concatenate([part[there:], part[: there + 1]])
        outline = np.concatenate([outline[: here + 1], round_trip, outline[here:]])
    return outline
