"""Check of WebDataset's shards; the layout is described in `export.webdataset`."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np

from rpl_data.export.checks.entries import check_annotation, check_image
from rpl_data.export.checks.findings import Findings

COLORS = ("jpg", "jpeg", "png")


def looks_like_webdataset(folder: Path) -> bool:
    """Whether a folder has a first shard of a split."""
    return any((folder / f"{split}-000000.tar").is_file() for split in ("train", "val", "test"))


def check_webdataset(findings: Findings) -> None:
    """Check each shard, and that none is missing between the first and the last."""
    shards = sorted(path.name for path in findings.folder.glob("*.tar"))
    if not shards:
        findings.add("", "", "", "there is no shard")
    for split, names in groupby(shards, key=lambda name: name.rpartition("-")[0]):
        found = list(names)
        expected = [f"{split}-{number:06d}.tar" for number in range(len(found))]
        findings.equal("", "", f"shards of {split}", found, expected, "numbered from 0 without gaps")
    for shard in shards:
        samples = 0
        try:
            for key, files in groupby(_files(findings.folder / shard), key=lambda file: file[0]):
                samples += 1
                _check_sample(findings, shard, key, {suffix: content for _, suffix, content in files})
        except (tarfile.TarError, OSError, EOFError) as error:
            findings.add(shard, "", "", f"damaged: {error}")
        else:
            if not samples:
                findings.add(shard, "", "", "it has no sample")


def _files(shard: Path) -> Iterator[tuple[str, str, bytes]]:
    """Key, suffix and content of each file of a shard, in order.

    Raises:
        TarError: it is damaged or cut off.
    """
    with tarfile.open(shard) as tar:
        for member in tar:
            content = tar.extractfile(member)
            key, _, suffix = member.name.partition(".")
            data = b"" if content is None else content.read()
            if len(data) != member.size:
                raise tarfile.ReadError(f"{member.name} is cut off")
            yield key, suffix, data
    if shard.stat().st_size < tar.offset + tarfile.BLOCKSIZE:
        raise tarfile.ReadError("its end is cut off")


def _check_sample(findings: Findings, shard: str, key: str, files: dict[str, bytes]) -> None:
    record = f"{key}.json"
    try:
        entry = json.loads(files["json"])
    except (KeyError, ValueError) as error:
        findings.add(shard, record, "", "missing" if "json" not in files else f"no JSON: {error}")
        return
    if not check_image(findings, entry, shard, record):
        return
    annotations = entry.get("annotations")
    if not isinstance(annotations, list):
        findings.add(shard, record, "annotations", "missing" if annotations is None else "expected a list")
        return
    size = (entry["width"], entry["height"])
    colors = [suffix for suffix in files if suffix in COLORS]
    if len(colors) != 1:
        findings.add(shard, key, "", f"expected one colour image, found {len(colors)}")
    for suffix in colors:
        _decoded(findings, shard, f"{key}.{suffix}", files[suffix], size, np.uint8)
    if entry["depth_file_name"] is not None:
        name = f"depth{Path(entry['depth_file_name']).suffix}"
        _decoded(findings, shard, f"{key}.{name}", files.get(name, b""), size, np.uint16)
    elif any(suffix.startswith("depth") for suffix in files):
        findings.add(shard, record, "depth_file_name", f"null, though there is a depth image of {key}")
    mask = _decoded(findings, shard, f"{key}.mask.png", files.get("mask.png", b""), size, np.uint8)
    for row, annotation in enumerate(annotations):
        check_annotation(findings, annotation, entry, shard, f"{record}, annotation number {row}")
    if mask is not None:
        _check_numbers(findings, shard, key, mask, len(annotations))


def _decoded(
    findings: Findings, shard: str, record: str, content: bytes, size: tuple[int, int], kind: type
) -> np.ndarray | None:
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    if image is None:
        findings.add(shard, record, "", "damaged or no image" if content else "missing")
        return None
    if image.dtype != kind or [image.shape[1], image.shape[0]] != list(size):
        what = f"expected {size[0]} x {size[1]} px of {kind.__name__}"
        findings.add(shard, record, "size", f"{what}, found {image.dtype} of shape {image.shape}")
        return None
    return np.asarray(image)


def _check_numbers(findings: Findings, shard: str, key: str, mask: np.ndarray, annotations: int) -> None:
    """The mask numbers the annotations; one may be covered by a later one."""
    highest = int(mask.max(initial=0))
    if highest > annotations:
        what = f"it has {highest}, though there are {annotations} annotations"
        findings.add(shard, f"{key}.mask.png", "", what)
