"""Check of exported YOLO datasets; the layout is described in `export.yolo`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rpl_data.export.checks.findings import Findings, stems
from rpl_data.export.checks.rules import at_least, one_of, sized
from rpl_data.formats.datasets.yolo import LINES
from rpl_data.json_arrays import number, text

SPLITS = ("train", "val", "test")
BEYOND = 1e-5
"""By how much a box may leave its image: two roundings."""


def looks_like_yolo(folder: Path) -> bool:
    """Whether a folder has a dataset of one of the tasks."""
    return any((folder / task / "data.yaml").is_file() for task in LINES)


Seen = dict[str, tuple[str, tuple[int, ...], list[list[str]]]]
"""Of each image of a task, by split and name: its file of lines, its shape, and the words of the lines."""


def check_yolo(findings: Findings) -> None:
    """Check the dataset of each task, and that all say the same of the same images."""
    found: dict[str, Seen] = {}
    for task in LINES:
        found[task] = {}
        _check_task(findings, task, found[task])
    if findings.faults:
        return
    for task in ("segment", "pose"):
        for name in sorted(found["detect"].keys() | found[task].keys()):
            _compare(findings, task, name, found["detect"].get(name), found[task].get(name))


def _compare(
    findings: Findings,
    task: str,
    name: str,
    detect: tuple[str, tuple[int, ...], list[list[str]]] | None,
    other: tuple[str, tuple[int, ...], list[list[str]]] | None,
) -> None:
    """An image has the same size, and the same objects with the same boxes, in both tasks."""
    if detect is None or other is None:
        findings.add(f"detect, {task}", "", "", f"only one of them has the image {name}")
        return
    if detect[1] != other[1]:
        files = f"detect/{name}, {task}/{name}"
        findings.add(
            files, "", "size", f"{detect[1][:2]} rows and columns in one, {other[1][:2]} in the other"
        )
    many = 5 if task == "pose" else 1
    if [words[:many] for words in detect[2]] != [words[:many] for words in other[2]]:
        what = f"expected the same {'classes' if many == 1 else 'boxes'} in both"
        findings.add(f"{detect[0]}, {other[0]}", "", "lines", what)


def _check_task(findings: Findings, task: str, seen: Seen) -> None:
    file = f"{task}/data.yaml"
    data = findings.yaml_objects(file)
    if data is None:
        return
    if not findings.fields(data, {"train": text, "val": text, "names": _names}, file, ""):
        return
    keypoints = 0
    if task == "pose":
        if not findings.fields(data, {"kpt_shape": sized(2, at_least(1))}, file, ""):
            return
        keypoints = int(data["kpt_shape"][0])
        findings.rule(file, "", "kpt_shape", one_of([3], "x, y and visibility"), data["kpt_shape"][1])
    for split in (name for name in SPLITS if name in data):
        place = data[split]
        if not isinstance(place, str) or not (findings.folder / task / place).is_dir():
            findings.add(file, "", split, f"there is no folder {place!r:.80}")
            continue
        _check_split(findings, task, place, len(data["names"]), keypoints, seen)
    for split in SPLITS:
        if split not in data and (findings.folder / task / "images" / split).is_dir():
            findings.add(file, "", split, f"missing, though there is a folder images/{split}")


def _names(values: Any) -> None:
    """Rule: names by number, from 0 without gaps."""
    if not isinstance(values, dict) or list(values) != list(range(len(values))) or not values:
        raise ValueError(f"expected names by number, from 0 without gaps, found {values!s:.80}")
    for value in values.values():
        text(value)


def _check_split(findings: Findings, task: str, place: str, classes: int, keypoints: int, seen: Seen) -> None:
    lines_at = place.replace("images", "labels", 1)
    images = stems(findings.folder / task / place)
    texts = stems(findings.folder / task / lines_at, [".txt"])
    for name in sorted(images.keys() | texts.keys()):
        image, label = f"{task}/{place}/{images.get(name, name)}", f"{task}/{lines_at}/{name}.txt"
        if name not in images:
            findings.add(label, "", "", f"there is no image {task}/{place}/{name}")
            continue
        pixels = findings.image(image)
        if name not in texts:
            findings.add(label, "", "", f"missing; an image without objects has an empty file ({image})")
            continue
        lines = [line.split() for line in findings.lines(label)]
        for row, words in enumerate(lines, start=1):
            _check_line(findings, task, label, f"line {row}", words, classes, keypoints)
        if pixels is not None:
            seen[f"{place}/{name}"] = label, pixels.shape, lines


def _check_line(
    findings: Findings,
    task: str,
    file: str,
    record: str,
    words: Sequence[str],
    classes: int,
    keypoints: int,
) -> None:
    try:
        values = [number(float(word)) for word in words]
    except ValueError as error:
        findings.add(file, record, "numbers", str(error))
        return
    expected = {"detect": "5", "pose": f"{5 + 3 * keypoints}"}.get(task, "an odd count of at least 7")
    fits = len(values) >= 7 and len(values) % 2 == 1 if task == "segment" else str(len(values)) == expected
    if not fits:
        findings.add(file, record, "numbers", f"expected {expected}, found {len(values)}")
        return
    findings.rule(file, record, "class", one_of(range(classes), f"0 to {classes - 1}"), values[0])
    shares = values[1:] if task == "segment" else values[1:5]
    if not all(0 <= value <= 1 for value in shares):
        findings.add(file, record, "numbers", "shares of the image must be from 0 to 1")
        return
    if task != "segment":
        _check_box(findings, file, record, values[1:5])
    for at in range(5, len(values) if task == "pose" else 0, 3):
        x, y, seen = values[at : at + 3]
        if seen not in (0, 1, 2) or not (0 <= x <= 1 and 0 <= y <= 1) or (seen == 0 and (x or y)):
            what = "shares of the image and 0, 1 or 2; 0 0 0 where it is not labelled"
            findings.add(file, record, f"keypoint {(at - 5) // 3}", f"expected {what}, found {x} {y} {seen}")


def _check_box(findings: Findings, file: str, record: str, box: Sequence[float]) -> None:
    xc, yc, width, height = box
    edges = (xc - width / 2, yc - height / 2, 1 - xc - width / 2, 1 - yc - height / 2)
    if width <= 0 or height <= 0 or min(edges) < -BEYOND:
        findings.add(file, record, "box", f"expected a box within the image, found {' '.join(map(str, box))}")
