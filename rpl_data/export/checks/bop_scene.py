"""Check of one scene in BOP's layout, as `export.bop` and `export.bop_onboarding` write it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rpl_data.export.checks.findings import Findings, box_of, stems
from rpl_data.export.checks.rules import (
    Rules,
    at_least,
    between,
    camera_matrix,
    one_of,
    pixel,
    place,
    positive,
    rotation,
    sized,
)
from rpl_data.json_arrays import Json, each, flag, text, whole

SceneIndex = Mapping[int, list[int]]
"""Objects of the instances in each image."""

CAMERA: Rules = {"cam_K": camera_matrix, "depth_scale": positive}
POSED: Rules = {"cam_R_w2c": rotation, "cam_t_w2c": sized(3, place)}
TRUTH: Rules = {"obj_id": at_least(1), "cam_R_m2c": rotation, "cam_t_m2c": sized(3, place)}
BOX = sized(4, whole)
INFO: Rules = {
    "bbox_obj": BOX,
    "bbox_visib": BOX,
    **{key: at_least(0) for key in ("px_count_all", "px_count_valid", "px_count_visib")},
    "visib_fract": between(0, 1),
}
COCO: Rules = {key: each(lambda entry: entry) for key in ("images", "annotations", "categories")}
COCO_IMAGE: Rules = {"id": whole, "file_name": text, "width": at_least(1), "height": at_least(1)}
COCO_ANNOTATION: Rules = {
    "id": whole,
    "image_id": whole,
    "category_id": at_least(1),
    "iscrowd": one_of([0, 1], "0 or 1"),
    "area": at_least(0),
    "bbox": sized(4, pixel),
    "segmentation": lambda mask: (sized(2, at_least(1))(mask["size"]), each(at_least(0))(mask["counts"])),
    "width": at_least(1),
    "height": at_least(1),
    "ignore": flag,
}
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def check_scene(findings: Findings, scene: str) -> SceneIndex:
    """Check a scene's four files, its images and its masks; returns the objects in each image.

    Args:
        findings: the faults so far.
        scene: its folder, relative to the dataset.
    """
    cameras, truth, info = (
        findings.json_objects(f"{scene}/scene_{name}.json") for name in ("camera", "gt", "gt_info")
    )
    index: dict[int, list[int]] = {}
    visible: dict[int, list[np.ndarray | None]] = {}
    sizes: dict[int, tuple[int, int]] = {}
    colors, depths = (stems(findings.folder / scene / kind, IMAGES) for kind in ("rgb", "depth"))
    for name in sorted(
        cameras.keys() | truth.keys() | info.keys() | {str(int(s)) for s in colors if s.isdecimal()}
    ):
        lacking = [
            part
            for part, content in (("camera", cameras), ("gt", truth), ("gt_info", info))
            if name not in content
        ]
        for part in lacking:
            findings.add(f"{scene}/scene_{part}.json", f"image {name}", "", "missing")
        if lacking or not name.isdecimal():
            continue
        number = int(name)
        _check_camera(findings, cameras[name], f"{scene}/scene_camera.json", f"image {name}")
        size = _check_images(findings, scene, f"{number:06d}", colors, depths)
        found = _check_instances(findings, scene, number, truth[name], info[name], size, depths)
        index[number], visible[number] = found
        if size is not None:
            sizes[number] = size
    _check_coco(findings, scene, index, visible, sizes)
    return index


def _check_camera(findings: Findings, entry: Any, file: str, record: str) -> None:
    posed = isinstance(entry, dict) and any(key in entry for key in POSED)
    findings.fields(entry, {**CAMERA, **(POSED if posed else {})}, file, record)


def _check_images(
    findings: Findings, scene: str, stem: str, colors: Mapping[str, str], depths: Mapping[str, str]
) -> tuple[int, int] | None:
    """Width and height of an image; None where it cannot be read."""
    if stem not in colors:
        findings.add(f"{scene}/rgb/{stem}", "", "", "missing, though scene_camera.json has its number")
        return None
    image = findings.image(f"{scene}/rgb/{colors[stem]}")
    size = None if image is None else (image.shape[1], image.shape[0])
    if stem in depths:
        like = f"{scene}/rgb/{colors[stem]}"
        findings.image(f"{scene}/depth/{depths[stem]}", size=size, like=like, kind="depth")
    elif depths:
        findings.add(f"{scene}/depth/{stem}", "", "", "missing, though other images have one")
    return size


def _check_instances(
    findings: Findings,
    scene: str,
    number: int,
    truth: Any,
    info: Any,
    size: tuple[int, int] | None,
    depths: Mapping[str, str],
) -> tuple[list[int], list[np.ndarray | None]]:
    """Objects and visible masks of the instances of an image."""
    objects: list[int] = []
    masks: list[np.ndarray | None] = []
    if not isinstance(truth, list) or not isinstance(info, list) or len(truth) != len(info):
        what = "scene_gt.json and scene_gt_info.json must list the same instances"
        findings.add(f"{scene}/scene_gt.json, {scene}/scene_gt_info.json", f"image {number}", "", what)
        return objects, masks
    for row, (pose, numbers) in enumerate(zip(truth, info, strict=True)):
        record = f"image {number}, instance {row}"
        if findings.fields(pose, TRUTH, f"{scene}/scene_gt.json", record):
            objects.append(pose["obj_id"])
        name, like = f"{number:06d}_{row:06d}.png", f"{scene}/rgb/{number:06d}"
        pair = [
            findings.image(f"{scene}/{kind}/{name}", size=size, like=like, kind="mask")
            for kind in ("mask", "mask_visib")
        ]
        masks.append(pair[1])
        sound = findings.fields(numbers, INFO, f"{scene}/scene_gt_info.json", record)
        if sound and pair[0] is not None and pair[1] is not None:
            _check_masks(findings, scene, record, name, numbers, pair[0], pair[1])
    return objects, masks


def _check_masks(
    findings: Findings, scene: str, record: str, name: str, info: Json, full: np.ndarray, seen: np.ndarray
) -> None:
    """The numbers of an instance are those of its masks."""
    if (seen.astype(bool) & ~full.astype(bool)).any():
        findings.add(
            f"{scene}/mask_visib/{name}", "", "", f"some of its pixels are not in {scene}/mask/{name}"
        )
    file, counted = f"{scene}/scene_gt_info.json", int((seen > 0).sum())
    findings.equal(
        file, record, "px_count_visib", info["px_count_visib"], counted, "the pixels of mask_visib"
    )
    x, y, width, height = box_of(seen)
    expected = [x, y, width - 1, height - 1] if counted else [-1, -1, -1, -1]
    findings.equal(file, record, "bbox_visib", info["bbox_visib"], expected, "the box of mask_visib")
    inside, every = int((full > 0).sum()), info["px_count_all"]
    if every < inside:
        findings.add(file, record, "px_count_all", f"expected at least the mask's {inside}, found {every}")
    if info["px_count_valid"] > inside:
        found = info["px_count_valid"]
        findings.add(file, record, "px_count_valid", f"expected at most the mask's {inside}, found {found}")
    if every and abs(info["visib_fract"] - counted / every) > 1e-6:
        what = f"expected px_count_visib / px_count_all = {counted / every:.6f}, found {info['visib_fract']}"
        findings.add(file, record, "visib_fract", what)
    x, y, width, height = box_of(full)
    left, top, wide, high = info["bbox_obj"]
    holds = left <= x and top <= y and left + wide >= x + width - 1 and top + high >= y + height - 1
    if inside and not holds:
        what = f"expected a box around the mask's {[x, y, width - 1, height - 1]}, found {info['bbox_obj']}"
        findings.add(file, record, "bbox_obj", what)


def _check_coco(
    findings: Findings,
    scene: str,
    index: SceneIndex,
    visible: Mapping[int, Sequence[np.ndarray | None]],
    sizes: Mapping[int, tuple[int, int]],
) -> None:
    """scene_gt_coco.json says the same as the other files."""
    file = f"{scene}/scene_gt_coco.json"
    data = findings.json_objects(file)
    if not data or not findings.fields(data, COCO, file, ""):
        return
    categories = set()
    for row, category in enumerate(data["categories"]):
        if findings.fields(category, {"id": at_least(1), "name": text}, file, f"category number {row}"):
            categories.add(category["id"])
    _check_coco_images(findings, scene, file, data["images"], index, sizes)
    rows: dict[int, int] = {}
    seen: set[int] = set()
    for row, entry in enumerate(data["annotations"]):
        record = f"annotation number {row}"
        if not findings.fields(entry, COCO_ANNOTATION, file, record):
            continue
        if entry["id"] in seen:
            findings.add(file, record, "id", f"{entry['id']} is the id of another annotation")
        seen.add(entry["id"])
        image = entry["image_id"]
        at = rows[image] = rows.get(image, -1) + 1
        if entry["category_id"] not in categories:
            findings.add(file, record, "category_id", f"there is no category {entry['category_id']}")
        if image not in index:
            findings.add(file, record, "image_id", f"there is no image {image}")
        elif at < len(visible[image]) and visible[image][at] is not None:
            mask = visible[image][at]
            assert mask is not None
            _check_coco_annotation(findings, file, record, entry, mask)
    for image, masks in visible.items():
        if rows.get(image, -1) + 1 != len(masks):
            findings.add(file, f"image {image}", "annotations", f"expected {len(masks)}, as in scene_gt.json")


def _check_coco_images(
    findings: Findings,
    scene: str,
    file: str,
    images: Sequence[Any],
    index: SceneIndex,
    sizes: Mapping[int, tuple[int, int]],
) -> None:
    found = set()
    for row, image in enumerate(images):
        record = f"image number {row}"
        if not findings.fields(image, COCO_IMAGE, file, record):
            continue
        found.add(image["id"])
        findings.named(f"{scene}/{image['file_name']}", file, record, "file_name")
        if image["id"] not in index:
            findings.add(file, record, "id", f"scene_gt.json has no image {image['id']}")
        for key, side in zip(("width", "height"), sizes.get(image["id"], ()), strict=False):
            findings.equal(file, record, key, image[key], side, "that of the image")
    for missing in sorted(index.keys() - found):
        findings.add(file, f"image {missing}", "id", "missing")


def _check_coco_annotation(findings: Findings, file: str, record: str, entry: Json, mask: np.ndarray) -> None:
    height, width = mask.shape
    findings.equal(
        file, record, "segmentation.size", entry["segmentation"]["size"], [height, width], "the mask's"
    )
    findings.equal(file, record, "width", entry["width"], width, "the mask's")
    findings.equal(file, record, "height", entry["height"], height, "the mask's")
    findings.equal(file, record, "area", entry["area"], int((mask > 0).sum()), "the pixels of mask_visib")
    ends = np.cumsum(entry["segmentation"]["counts"])
    starts = np.flatnonzero(np.diff((mask > 0).ravel(order="F").astype(np.int8), prepend=0))
    if not len(ends) or ends[-1] != mask.size or not np.array_equal(ends[:-1], starts):
        findings.add(file, record, "segmentation.counts", "its runs are not those of mask_visib")
    x, y, wide, high = entry["bbox"]
    left, top, w, h = box_of(mask)
    if not (x <= left and y <= top and x + wide >= left + w - 1 and y + high >= top + h - 1):
        findings.add(file, record, "bbox", f"expected a box around mask_visib, found {entry['bbox']}")
