"""Check of YCB-Video's layout, which is described in `export.ycb_video`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.checks.findings import Findings, box_of
from rpl_data.export.checks.image_lists import check_lists
from rpl_data.export.checks.models import check_obj
from rpl_data.export.checks.rules import Rules, camera_matrix, one_of, pixel, positive, rigid
from rpl_data.export.ycb_video import MAT_HEADING, MODEL_POINTS
from rpl_data.formats.containers.mat import read_mat
from rpl_data.json_arrays import each, number
from rpl_data.types import DataError

CLASSES = "image_sets/classes.txt"
LARGEST_M = 1e3
BOX_PX = 0.01
"""By how much a box may miss its pixels: two digits are written."""
CENTER_PX = 0.01
_FILE = re.compile(r"(\d{6})-(?:color\.png|depth\.png|label\.png|box\.txt|meta\.mat)")


def looks_like_ycb_video(folder: Path) -> bool:
    """Whether a folder has frames that we wrote; the dataset itself is a recording like others."""
    first = next(folder.glob("data/[0-9]*/*-meta.mat"), None)
    if first is None or not first.is_file():
        return False
    with first.open("rb") as file:
        return b"rpl-data" in file.read(MAT_HEADING)


def check_ycb_video(findings: Findings) -> None:
    """Check each frame, the lists of frames, and the models."""
    classes = [line.strip() for line in findings.lines(CLASSES)]
    if not classes or not all(classes) or len(set(classes)) < len(classes):
        findings.add(CLASSES, "", "names", "expected a name per line, each once")
    frames = sorted(
        {
            f"{path.parent.name}/{match[1]}"
            for path in findings.folder.glob("data/*/*")
            if (match := _FILE.fullmatch(path.name))
        }
    )
    if not frames:
        findings.add("data", "", "", "there is no frame, <scene>/000001-color.png")
    listed = {frame for frame in frames if _check_frame(findings, f"data/{frame}", classes)}
    check_lists(findings, "image_sets", listed, "a frame with an object, such as 0000/000001")
    _check_keyframes(findings)
    for path in sorted((findings.folder / "models").glob("*")):
        _check_model(findings, path.name, classes)


def _check_frame(findings: Findings, frame: str, classes: Sequence[str]) -> bool:
    """Check the five files of a frame; whether they show an object."""
    color = f"{frame}-color.png"
    image = findings.image(color)
    size = None if image is None else (image.shape[1], image.shape[0])
    findings.image(f"{frame}-depth.png", size=size, like=color, kind="depth")
    label = findings.image(f"{frame}-label.png", size=size, like=color, kind="mask")
    numbers = _check_meta(findings, f"{frame}-meta.mat", len(classes))
    boxes = _boxes(findings, f"{frame}-box.txt", classes)
    if numbers is not None and boxes is not None:
        file, what = f"{frame}-box.txt", f"as {frame}-meta.mat has them in cls_indexes"
        findings.equal(file, "", "numbers of the names", sorted(boxes), sorted(numbers), what)
    if numbers is not None and label is not None:
        _check_label(findings, f"{frame}-label.png", label, numbers)
    if boxes is not None and label is not None:
        for object_number, box in boxes.items():
            _check_box(findings, f"{frame}-box.txt", classes[object_number - 1], box, label == object_number)
    return bool(boxes if numbers is None else numbers)


def _check_meta(findings: Findings, file: str, classes: int) -> list[int] | None:
    """Check the arrays of a meta.mat; returns the numbers of the objects, None where they are not sound."""
    try:
        meta = read_mat(findings.folder / file, META.keys())
    except DataError as error:
        findings.add(file, "", "", str(error).replace(f"{findings.folder}/", ""))
        return None
    if not findings.fields(meta, META, file, ""):
        return None
    numbers = [int(value) for value in meta["cls_indexes"].ravel()]
    wanted = one_of(range(1, classes + 1), f"the number of a line of {CLASSES}")
    if not all([findings.rule(file, "", "cls_indexes", wanted, value) for value in numbers]):
        return None
    findings.equal(file, "", "cls_indexes", len(set(numbers)), len(numbers), "each object once")
    poses, center = meta["poses"].astype(np.float64), meta["center"].astype(np.float64)
    if len(numbers) == 1 and poses.ndim == 2:  # as MATLAB writes a single one
        poses = poses[..., None]
    for field, found, shape in (
        ("poses", poses, (3, 4, len(numbers))),
        ("center", center, (len(numbers), 2)),
    ):
        what = f"one per number of cls_indexes, which has {len(numbers)}"
        findings.equal(file, "", field, found.shape, shape, what)
    if poses.shape == (3, 4, len(numbers)) and center.shape == (len(numbers), 2):
        for row in range(len(numbers)):
            record = f"object {numbers[row]}"
            if findings.rule(file, record, "poses", _pose, poses[..., row]):
                _check_center(
                    findings, file, record, center[row], meta["intrinsic_matrix"] @ poses[:, 3, row]
                )
    return numbers


def _check_center(findings: Findings, file: str, record: str, center: np.ndarray, origin: np.ndarray) -> None:
    """The centre is where the camera sees the object's origin; `origin` is that times the camera's matrix."""
    if origin[2] > 0 and not np.allclose(center, origin[:2] / origin[2], rtol=1e-6, atol=CENTER_PX):
        what = f"expected {(origin[:2] / origin[2]).tolist()}, the origin of poses in the image"
        findings.add(file, record, "center", f"{what}, found {center.tolist()}")


def _boxes(findings: Findings, file: str, classes: Sequence[str]) -> dict[int, list[float]] | None:
    """The box of each object, by its number; None, with a fault noted, where a line is not sound."""
    lines = findings.lines(file)
    found: dict[int, list[float]] = {}
    for row, line in enumerate(lines, start=1):
        name, *words = line.rsplit(maxsplit=4) or [""]
        if name not in classes:
            findings.add(file, f"line {row}", "name", f"expected one of {CLASSES}, found {name!r:.60}")
            return None
        try:
            box = [number(float(word)) for word in words]
        except ValueError as error:
            findings.add(file, f"line {row}", "box", str(error))
            return None
        if len(box) != 4:
            findings.add(file, f"line {row}", "box", f"expected x1 y1 x2 y2, found {words}")
            return None
        found[classes.index(name) + 1] = box
    findings.equal(file, "", "names", len(lines), len(found), "each object once")
    return found if (findings.folder / file).is_file() else None


def _check_label(findings: Findings, file: str, label: np.ndarray, numbers: Sequence[int]) -> None:
    """A pixel has 0, or the number of an object of the frame; one may be covered by a later one."""
    others = sorted(set(np.unique(label).tolist()) - {0, *numbers})
    if others:
        what = f"expected 0 and those of cls_indexes, {sorted(numbers)}"
        findings.add(file, "", "numbers", f"{what}; found {others}")


def _check_box(findings: Findings, file: str, name: str, box: list[float], seen: np.ndarray) -> None:
    """A box lies in the image and holds the object's pixels."""
    left, top, right, bottom = box
    x, y, width, height = box_of(seen)
    rows, columns = seen.shape
    inside = -BOX_PX <= left < right <= columns + BOX_PX and -BOX_PX <= top < bottom <= rows + BOX_PX
    misses = max(left - x, top - y, x + width - right, y + height - bottom) > BOX_PX
    if not inside or (width and misses):
        what = f"expected a box of the image around {[x, y, x + width, y + height]}, as the label has it"
        findings.add(file, name, "box", f"{what}; found {box}")


def _check_keyframes(findings: Findings) -> None:
    """keyframe.txt is test.txt once more."""
    test, keyframe = (f"image_sets/{name}.txt" for name in ("test", "keyframe"))
    there = any((findings.folder / file).exists() for file in (test, keyframe))
    if there and findings.lines(keyframe) != findings.lines(test):
        findings.add(keyframe, "", "image", f"expected the lines of {test}")


def _check_model(findings: Findings, name: str, classes: Sequence[str]) -> None:
    """A model is of a class, in metres, and has a textured mesh; an object may have none."""
    folder = f"models/{name}"
    if name not in classes:
        findings.add(CLASSES, "", "names", f"there is {folder}, but no such name")
    points = findings.numbers(f"{folder}/points.xyz", MODEL_POINTS, 3)
    if points is not None and np.abs(points).max() > LARGEST_M:
        found = np.abs(points).max()
        findings.add(f"{folder}/points.xyz", "", "numbers", f"expected metres, found {found:g}")
    check_obj(findings, f"{folder}/textured.obj")


def _pose(array: np.ndarray) -> None:
    """Rule: the first three rows of a rigid transform."""
    rigid([*_shaped(array, (3, 4)), 0, 0, 0, 1])


def _counted(value: Any) -> None:
    """Rule: a whole number from 1, which MATLAB may hold as a float."""
    if not (number(value) >= 1 and value == int(value)):
        raise ValueError(f"expected whole numbers from 1, found {value}")


def _shaped(array: np.ndarray, shape: tuple[int, ...]) -> list[float]:
    """The numbers of an array, row by row; ValueError where it has another shape."""
    if array.shape != shape:
        raise ValueError(f"expected an array of {shape}, found {array.shape}")
    values: list[float] = array.astype(np.float64).ravel().tolist()
    return values


META: Rules = {
    "center": lambda array: each(pixel)(array.astype(np.float64).ravel().tolist()),
    "cls_indexes": lambda array: each(_counted)(array.ravel().tolist()),
    "factor_depth": lambda array: positive(float(array.item())),
    "intrinsic_matrix": lambda array: camera_matrix(_shaped(array, (3, 3))),
    "poses": lambda array: each(number)(array.astype(np.float64).ravel().tolist()),
    "rotation_translation_matrix": _pose,
}
"""Rules for the arrays of a meta.mat."""
