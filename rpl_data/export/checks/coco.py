"""Check of an exported COCO folder; the layout is described in `export.coco`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.checks.entries import check_annotation, check_image
from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.rules import at_least, between, sized
from rpl_data.export.dialect import SPLITS
from rpl_data.files import decoding
from rpl_data.formats.datasets.coco import intrinsics_from_coco
from rpl_data.formats.datasets.coco_check import validate_coco
from rpl_data.formats.datasets.coco_edited import REMEDY, annotations_as_exported
from rpl_data.geometry import project, transform
from rpl_data.json_arrays import Json, each, matrix_from_json, optional, text
from rpl_data.meshes import load_mesh
from rpl_data.types import DataError

TOP = {key: each(lambda entry: entry) for key in ("images", "annotations", "categories")}
LARGEST_M = 1e3
"""No keypoint lies farther from the origin of its object."""


def looks_like_coco(folder: Path) -> bool:
    """Whether a folder has a file per split."""
    return any((folder / f"{name}.json").is_file() for name in SPLITS)


def holds_exports(folder: Path) -> bool:
    """Whether a folder has one per dialect: `export` itself, or a choice of `rpl export --object ...`."""
    return folder.name == "export" or (folder.parent.name == "export" and folder.name.startswith("only_"))


def looks_like_coco_per_object(folder: Path) -> bool:
    """Whether a folder has one COCO folder per object."""
    return not holds_exports(folder) and any(
        looks_like_coco(path) for path in folder.glob("*") if path.is_dir()
    )


def check_coco_per_object(findings: Findings) -> None:
    """Check each object's folder as one of `coco`."""
    for folder in sorted(path for path in findings.folder.iterdir() if path.is_dir()):
        own = Findings(folder)
        check_coco(own)
        for fault in own.faults:
            findings.add(f"{folder.name}/{fault.file}", fault.record, fault.field, fault.problem)


def check_coco(findings: Findings) -> None:
    """Check every split, its images and the meshes."""
    present = [name for name in SPLITS if (findings.folder / f"{name}.json").exists()]
    if not present:
        findings.add("", "", "", f"none of {', '.join(f'{name}.json' for name in SPLITS)} is there")
    seen: dict[str, set[int]] = {"image": set(), "annotation": set()}
    listed: set[str] = set()
    for name in present:
        listed |= _check_split(findings, f"{name}.json", seen)
    if not findings.faults:
        _check_all_named(findings, listed)


def _check_all_named(findings: Findings, listed: set[str]) -> None:
    """Every image that is there belongs to a split."""
    files = ", ".join(f"{name}.json" for name in SPLITS)
    for kind, field in (("images", "file_name"), ("depth", "depth_file_name")):
        for path in sorted((findings.folder / kind).glob("*/*")):
            name = str(path.relative_to(findings.folder))
            if name not in listed:
                findings.add(files, "", field, f"none of them names {name}")


def _check_split(findings: Findings, file: str, seen: Mapping[str, set[int]]) -> set[str]:
    """Check a file and what it names; returns the names of its images."""
    before = len(findings.faults)
    data = findings.json_objects(file)
    if not data or not findings.fields(data, TOP, file, ""):
        return set()
    images = {}
    for row, image in enumerate(data["images"]):
        record = _record("image", image, row)
        if check_image(findings, image, file, record):
            images[image["id"]] = image
            _note_id(findings, seen["image"], image["id"], file, record)
    _check_units(findings, images, file)
    for row, annotation in enumerate(data["annotations"]):
        record = _record("annotation", annotation, row)
        image = images.get(annotation.get("image_id")) if isinstance(annotation, dict) else None
        if image is None and len(images) == len(data["images"]):
            findings.add(file, record, "image_id", "there is no such image in this file")
        elif image is None or not _with_packed_masks(findings, annotation, image, file, record):
            continue
        elif check_annotation(findings, annotation, image, file, record):
            _note_id(findings, seen["annotation"], annotation["id"], file, record)
    if len(findings.faults) > before:
        return set()
    try:
        validate_coco(data, source=file)
    except DataError as error:
        findings.add(file, "", "", str(error).removeprefix(f"{file}: "))
        return set()
    _check_objects(findings, data, file)
    _check_places(findings, data, images, file)
    for image in images.values():
        _check_files(findings, image, file)
    names = (image[key] for image in images.values() for key in ("file_name", "depth_file_name"))
    return {name for name in names if name is not None}


def _with_packed_masks(
    findings: Findings, annotation: Json, image: Mapping[str, Any], file: str, record: str
) -> bool:
    """Pack masks that another program drew, as our readers do; whether they are sound."""
    forms = [annotation.get(key) for key in ("segmentation", "segmentation_full")]
    if not any(isinstance(form.get("counts") if isinstance(form, dict) else form, list) for form in forms):
        return True
    sizes = {image["id"]: (image["height"], image["width"])}
    try:
        with decoding(file, REMEDY):
            annotations_as_exported([annotation], sizes, source=file)
    except DataError as error:
        problem = str(error).partition(";")[0].rpartition("version: ")[2].removeprefix("segmentation: ")
        findings.add(file, record, "segmentation", problem)
        return False
    return True


def _check_units(findings: Findings, images: Mapping[int, Json], file: str) -> None:
    """All depth images of a file have a unit, or, as earlier versions wrote it, none has."""
    with_depth = [image for image in images.values() if image["depth_file_name"] is not None]
    without = [image for image in with_depth if "metres_per_unit" not in image]
    if len(without) < len(with_depth):
        for image in without:
            findings.add(file, f"image {image['id']}", "metres_per_unit", "missing, though others say it")


def _record(kind: str, entry: Any, row: int) -> str:
    number = entry.get("id") if isinstance(entry, dict) else None
    return f"{kind} {number}" if isinstance(number, int) else f"{kind} number {row}"


def _note_id(findings: Findings, seen: set[int], number: int, file: str, record: str) -> None:
    if number in seen:
        findings.add(file, record, "id", f"{number} is the id of another entry of this export")
    seen.add(number)


def _check_objects(findings: Findings, data: Json, file: str) -> None:
    findings.fields(data["rpl"], {"version": text}, file, "rpl")
    for category in data["categories"]:
        findings.fields(
            category, {"supercategory": text, "id": at_least(1)}, file, f"category {category['id']}"
        )
    rule = each(optional(sized(3, between(-LARGEST_M, LARGEST_M))))
    for item in data["rpl"]["objects"]:
        record = f"rpl.objects, {item['name']}"
        findings.rule(file, record, "points_object", rule, item["points_object"])
        if item["mesh"] is not None and findings.named(item["mesh"], file, record, "mesh"):
            try:
                load_mesh(findings.folder / item["mesh"])
            except DataError as error:
                findings.add(item["mesh"], "", "", str(error).replace(f"{findings.folder}/", ""))


def _check_places(findings: Findings, data: Json, images: Mapping[int, Json], file: str) -> None:
    """Keypoints lie where pose and camera put them: nobody who corrects them moves them across the image."""
    points = {
        item["category_id"]: np.array([point or [np.nan] * 3 for point in item["points_object"]]).reshape(
            -1, 3
        )
        for item in data["rpl"]["objects"]
    }
    for annotation in data["annotations"]:
        image = images[annotation["image_id"]]
        pose = matrix_from_json(annotation["camera_from_object"])
        there = project(intrinsics_from_coco(image), transform(pose, points[annotation["category_id"]]))
        marked = np.array(annotation["keypoints"], dtype=np.float64).reshape(-1, 3)
        labelled = marked[:, 2] > 0
        off = np.linalg.norm(marked[:, :2] - there, axis=1)[labelled]
        record = f"annotation {annotation['id']}"
        if np.isnan(points[annotation["category_id"]][labelled]).any():
            what = "a keypoint has a place in the image, but is null in points_object"
            findings.add(file, record, "keypoints", what)
        if (off > image["width"] + image["height"]).any():
            findings.add(
                file,
                record,
                "keypoints, camera_from_object",
                f"a keypoint is {np.nanmax(off):.0f} px from where the pose puts it",
            )


def _check_files(findings: Findings, image: Json, file: str) -> None:
    record, size = f"image {image['id']}", (image["width"], image["height"])
    if findings.named(image["file_name"], file, record, "file_name"):
        findings.image(image["file_name"], size=size, like=f"{file}, {record}")
    depth = image["depth_file_name"]
    if depth is not None and findings.named(depth, file, record, "depth_file_name"):
        findings.image(depth, size=size, like=f"{file}, {record}", kind="depth")
