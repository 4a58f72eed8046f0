"""A twin while it is rendered: what was interrupted goes on with the frames that are missing.

A frame is done once its label is there, which is written last. Unlike the lines of `labels/<scene>.jsonl`,
these labels hold every number in full: the clicks are made of them, and must not depend on an interruption.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import FAULTS, read_text, remove, write_text
from rpl_data.twin.spec import TwinSpec
from rpl_data.types import DataError, FrameLabel, InstanceLabel, SquareBox

LABELS = "unfinished"
"""Folder of the labels of the frames that are done; a finished recording has none."""
ARRAYS = {
    "camera_from_object": np.float64, "keypoints_px": np.float64, "visibility": np.int64,
    "sigma_px": np.float64,
}  # fmt: skip
"""Fields of a label that are arrays, and of which numbers."""


@contextmanager
def unfinished(folder: Path, spec: TwinSpec) -> Iterator[Path]:
    """Yield the folder in which a twin is made; it replaces `folder` when the block ends well.

    Otherwise it stays as it is, for the next twin of the same spec there. One of another spec removes it.

    Raises:
        DataError: the folder cannot be written.
    """
    partial = folder.with_name(f".{folder.name}.{_digest(spec)}.partial")
    try:
        partial.mkdir(parents=True, exist_ok=True)
        _clean(folder, partial)
        yield partial
        remove(folder)
        remove(partial / LABELS)
        partial.rename(folder)
    except OSError as error:
        raise DataError(
            f"cannot write the twin {folder}: {error.strerror or error}. Free some space or choose another "
            "folder; the same command goes on with the frames that are missing"
        ) from error


def _clean(folder: Path, partial: Path) -> None:
    """Remove the beginnings of other twins, and files that a killed process left half-written in this one."""
    begun = re.compile(rf"\.{re.escape(folder.name)}(\.[0-9a-f]{{16}})?\.partial")
    for other in folder.parent.iterdir():
        if begun.fullmatch(other.name) and other != partial:
            remove(other)
    for half_written in partial.rglob(".*"):
        remove(half_written)


def _digest(spec: TwinSpec) -> str:
    """Stands for all that the pixels depend on: the spec, the files of its meshes, and the code."""
    from rpl_data.compiled import digest_of

    found = [thing.mesh.stat() for thing in spec.things if thing.mesh is not None]
    meshes = [(status.st_size, status.st_mtime_ns) for status in found]
    content = json.dumps([asdict(spec), meshes, digest_of(Path(__file__).parents[1])], default=str)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def label_file(partial: Path, scene: str, frame: int) -> Path:
    """Where the label of a frame is, once the frame is done."""
    return partial / LABELS / scene / f"{frame:06d}.json"


def keep_label(path: Path, label: FrameLabel) -> None:
    """Note a frame as done."""
    write_text(path, json.dumps(asdict(label), default=lambda array: array.tolist()))


def kept_label(path: Path, *images: Path) -> FrameLabel | None:
    """The label of a frame that is done, exactly as it was; None where the frame must be rendered.

    Args:
        images: the files of the frame; after a power cut one may be empty.
    """
    if not all(image.is_file() and image.stat().st_size for image in images):
        return None
    try:
        data = json.loads(read_text(path))
        return FrameLabel(**data | {"instances": tuple(map(_instance, data["instances"]))})
    except (DataError, *FAULTS):
        return None


def _instance(data: dict[str, Any]) -> InstanceLabel:
    arrays = {name: np.array(data[name], dtype=kind) for name, kind in ARRAYS.items()}
    boxes = {name: data[name] and tuple(data[name]) for name in ("box", "box_full")}
    return InstanceLabel(**data | arrays | boxes | {"square_box": SquareBox(**data["square_box"])})
