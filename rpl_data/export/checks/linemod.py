"""Check of LINEMOD's layout, which is described in `export.linemod`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.checks.findings import Findings, box_of, stems
from rpl_data.export.checks.image_lists import check_lists
from rpl_data.export.checks.models import SIZE_SHARE, SIZES, check_sizes
from rpl_data.export.checks.rules import Rules, at_least, camera_matrix, place, positive, rotation, sized
from rpl_data.export.dialect import SPLITS
from rpl_data.json_arrays import Json, each, text, whole

TRUTH: Rules = {
    "cam_R_m2c": rotation,
    "cam_t_m2c": sized(3, place),
    "obj_bb": sized(4, whole),
    "obj_id": at_least(1),
}
CAMERA: Rules = {"cam_K": camera_matrix, "depth_scale": positive}
SOURCE: Rules = {"name": text, "frames": each(text)}
COUNT_LINE = 4
"""The line of a model that has the number of its vertices, where the layout's loader looks for it."""


def looks_like_linemod(folder: Path) -> bool:
    """Whether a folder has objects with the true poses of their images, and says where these are from."""
    return (folder / "names.yml").is_file() and any(folder.glob("data/[0-9]*/gt.yml"))


def check_linemod(findings: Findings) -> None:
    """Check each object's images, and the models."""
    root = findings.folder
    names = findings.yaml_objects("names.yml")
    folders = {path.name for path in (root / "data").glob("*") if path.is_dir()}
    if not folders:
        findings.add("data", "", "", "there is no folder of an object")
    splits = {split for split in SPLITS if any(root.glob(f"data/*/{split}.txt"))}
    for folder in sorted(folders):
        if not folder.isdecimal():
            findings.add(f"data/{folder}", "", "", "expected the number of an object")
            continue
        images = _check_object(findings, f"data/{folder}", int(folder))
        if names is not None:
            _check_source(findings, names, int(folder), len(images))
        check_lists(findings, f"data/{folder}", images, "an image of gt.yml")
        for split in sorted(splits):
            if not (root / f"data/{folder}/{split}.txt").exists():
                findings.add(f"data/{folder}/{split}.txt", "", "", "missing, though other objects have it")
    numbers = {int(folder) for folder in folders if folder.isdecimal()}
    for number in (names or {}).keys() - numbers:
        findings.add("names.yml", f"object {number}", "", "there is no folder of its images in data/")
    _check_models(findings, numbers)


def _check_source(findings: Findings, names: dict[Any, Any], number: int, images: int) -> None:
    """The name of an object is given, and a frame for each of its images."""
    record = f"object {number}"
    if _has_fields(findings, names.get(number), SOURCE, "names.yml", record):
        frames = len(names[number]["frames"])
        findings.equal("names.yml", record, "frames", frames, images, "one per image")


def _has_fields(findings: Findings, entry: Any, rules: Rules, file: str, record: str) -> bool:
    """Whether there is an entry whose fields keep their rules."""
    if entry is None:
        findings.add(file, record, "", "missing")
        return False
    return findings.fields(entry, rules, file, record)


def _check_object(findings: Findings, folder: str, number: int) -> set[str]:
    """Check what an object's folder says of each image; returns the names of the images."""
    truth, cameras = (findings.yaml_objects(f"{folder}/{name}.yml") for name in ("gt", "info"))
    images: set[str] = set()
    for kind in ("rgb", "depth", "mask"):
        images |= stems(findings.folder / folder / kind, [".png"]).keys()
    for file, entries in (("gt", truth), ("info", cameras)):
        for key in entries or {}:
            if isinstance(key, int) and key >= 0:
                images.add(f"{key:04d}")
            else:
                findings.add(f"{folder}/{file}.yml", f"image {key}", "", "expected the image's number as key")
    for name in sorted(images):
        if not name.isdecimal():
            findings.add(f"{folder}/rgb/{name}.png", "", "", "expected a number as its name")
            continue
        seen = _check_images(findings, folder, name)
        record = f"image {int(name)}"
        if cameras is not None:
            _has_fields(findings, cameras.get(int(name)), CAMERA, f"{folder}/info.yml", record)
        if truth is not None:
            _check_truth(findings, truth.get(int(name)), f"{folder}/gt.yml", record, number, seen)
    return images


def _check_images(findings: Findings, folder: str, name: str) -> np.ndarray | None:
    """The mask of an image; None, with a fault noted, where it is not sound."""
    color = f"{folder}/rgb/{name}.png"
    image = findings.image(color)
    size = None if image is None else (image.shape[1], image.shape[0])
    findings.image(f"{folder}/depth/{name}.png", size=size, like=color, kind="depth")
    file = f"{folder}/mask/{name}.png"
    mask = findings.image(file, size=size, like=color)
    if mask is None:
        return None
    alike = mask.ndim == 3 and mask.shape[2] == 3 and (mask == mask[..., :1]).all()
    if not (alike and np.isin(mask, (0, 255)).all() and mask.any()):
        what = "expected 255 in all three channels where the object is seen, else 0"
        findings.add(file, "", "", f"{what}, found {mask.dtype} of shape {mask.shape}")
        return None
    return np.asarray(mask[..., 0])


def _check_truth(
    findings: Findings, entries: Any, file: str, record: str, number: int, seen: np.ndarray | None
) -> None:
    """One entry of an image is of the folder's object, and its box holds what is seen of it."""
    if not isinstance(entries, list):
        what = "missing" if entries is None else f"expected a list, found {type(entries).__name__}"
        findings.add(file, record, "", what)
        return
    mine: list[Json] = []
    for row, entry in enumerate(entries):
        sound = findings.fields(entry, TRUTH, file, f"{record}, instance {row}")
        if sound and entry["obj_id"] == number:
            mine.append(entry)
    if len(mine) != 1:
        findings.add(
            file, record, "obj_id", f"expected one sound entry of object {number}, found {len(mine)}"
        )
    elif seen is not None:
        left, top, wide, high = mine[0]["obj_bb"]
        x, y, width, height = box_of(seen)
        if not (left <= x and top <= y and left + wide >= x + width and top + high >= y + height):
            what = f"expected a box around the mask's {[x, y, width, height]}, found {mine[0]['obj_bb']}"
            findings.add(file, record, "obj_bb", what)


def _check_models(findings: Findings, numbers: set[int]) -> None:
    """Check each model and its sizes; an object may have none."""
    file = "models/models_info.yml"
    info = findings.yaml_objects(file)
    if info is None:
        return
    for number, entry in info.items():
        record = f"object {number}"
        if number not in numbers:
            findings.add(file, record, "", "there is no folder of its images in data/")
        elif findings.fields(entry, SIZES, file, record):
            mesh = f"models/obj_{number:02d}.ply"
            check_sizes(findings, mesh, entry, file, record, share=SIZE_SHARE)
            _check_count(findings, mesh)
    for path in sorted((findings.folder / "models").glob("*.ply")):
        number = path.stem.removeprefix("obj_")
        if not number.isdecimal() or int(number) not in info:
            findings.add(file, "", path.stem, f"missing, though there is models/{path.name}")


def _check_count(findings: Findings, file: str) -> None:
    """A model has the number of its vertices where the loader looks for it."""
    if (findings.folder / file).is_file():
        line = "".join(findings.lines(file)[COUNT_LINE - 1 : COUNT_LINE])
        if not line.startswith("element vertex "):
            findings.add(
                file, f"line {COUNT_LINE}", "", f"expected the number of vertices, found {line!r:.60}"
            )
