"""Check of an image folder for Hugging Face; the layout is described in `export.huggingface`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rpl_data.export.checks.entries import ANNOTATION_RULES, IMAGE_RULES
from rpl_data.export.checks.findings import Findings, stems
from rpl_data.export.checks.rules import Rules, at_least, one_of
from rpl_data.export.huggingface import CALLED, COLUMNS
from rpl_data.json_arrays import Json, each, text, whole

KEPT = ("file_name", "width", "height", "scene", "frame", "timestamp_s", "cam_K")
LINE: Rules = {"image_id": whole, **{key: IMAGE_RULES[key] for key in KEPT}}
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def looks_like_huggingface(folder: Path) -> bool:
    """Whether a folder has a split with metadata."""
    return any((folder / split / "metadata.jsonl").is_file() for split in CALLED.values())


def check_huggingface(findings: Findings) -> None:
    """Check the categories and each split."""
    data = findings.json_objects("categories.json")
    names: list[str] = []
    keypoints: Json = {}
    if findings.fields(data, {"categories": each(text), "keypoints": _keypoints}, "categories.json", ""):
        names, keypoints = data["categories"], data["keypoints"]
        what = "one list per category"
        findings.equal("categories.json", "", "keypoints", sorted(keypoints), sorted(names), what)
    seen: set[int] = set()
    present = [name for name in CALLED.values() if (findings.folder / name).is_dir()]
    if not present:
        findings.add("", "", "", f"none of {', '.join(CALLED.values())} is there")
    for split in present:
        _check_split(findings, split, names, keypoints, seen)


def _keypoints(values: Any) -> None:
    """Rule: names of the keypoints by category."""
    for category, names in values.items():
        try:
            each(text)(names)
        except ValueError as error:
            raise ValueError(f"{category}: {error}") from error


def _check_split(findings: Findings, split: str, names: list[str], keypoints: Json, seen: set[int]) -> None:
    file = f"{split}/metadata.jsonl"
    listed = set()
    for record, line in findings.json_lines(file):
        if isinstance(line.get("file_name"), str):
            listed.add(line["file_name"])
        if not findings.fields(line, LINE, file, record):
            continue
        if line["image_id"] in seen:
            findings.add(file, record, "image_id", f"{line['image_id']} is the id of another image")
        seen.add(line["image_id"])
        if findings.named(f"{split}/{line['file_name']}", file, record, "file_name"):
            size = (line["width"], line["height"])
            findings.image(f"{split}/{line['file_name']}", size=size, like=f"{file}, {record}")
        _check_objects(findings, line.get("objects"), file, record, names, keypoints)
    for name in stems(findings.folder / split, IMAGES).values():
        if name not in listed:
            findings.add(file, "", "file_name", f"there is no line for {name}")


def _check_objects(
    findings: Findings, objects: Any, file: str, record: str, names: list[str], keypoints: Json
) -> None:
    """The columns have one value per instance."""
    rules: Rules = {column: each(ANNOTATION_RULES[column]) for column in COLUMNS}
    category = each(one_of(range(len(names)), "the index of a category")) if names else each(at_least(0))
    record = f"{record}, objects"
    if not findings.fields(objects, {**rules, "category": category, "instance": each(text)}, file, record):
        return
    count = len(objects["id"])
    for column in (*COLUMNS, "category", "instance"):
        findings.equal(file, record, column, len(objects[column]), count, "the number of instances")
    for marks, number in zip(objects["keypoints"], objects["category"], strict=False):
        if number < len(names) and isinstance(keypoints.get(names[number]), list):
            wanted = 3 * len(keypoints[names[number]])
            what = f"3 per keypoint of {names[number]} in categories.json"
            findings.equal(file, record, "keypoints", len(marks), wanted, what)
