"""A dataset in another format: rendered, merged and filtered datasets for the trainers that read those."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rpl_data.dataset.source import parts_of, source_at
from rpl_data.dataset.written import refuse_overlap
from rpl_data.export import (
    export_coco_per_object,
    export_huggingface,
    export_okt,
    export_webdataset,
    export_yolo,
)
from rpl_data.export.dialect import DialectSummary
from rpl_data.types import DataError

FORMATS: dict[str, Callable[[Path, Path], DialectSummary]] = {
    "yolo": export_yolo,
    "coco_per_object": export_coco_per_object,
    "okt": export_okt,
    "huggingface": export_huggingface,
    "webdataset": export_webdataset,
}
"""The formats that are made of a COCO folder alone; the others need a workspace and its recordings."""


def convert_dataset(out: Path, source: Path, name: str) -> DialectSummary:
    """Write a dataset as the new folder `out` in another format, with the same splits.

    Images are linked, or copied into the shards of `webdataset`.

    Raises:
        DataError: the format needs a workspace, the dataset is missing or damaged, or `out` holds files.
    """
    if name not in FORMATS:
        raise DataError(
            f"a dataset is not converted to {name}; expected one of {', '.join(FORMATS)} (`rpl export "
            "--format` writes the others of a workspace)"
        )
    found = source_at(source)
    refuse_overlap(out, [found])
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise DataError(f"{out} exists and is not replaced; name another folder, or remove it")
    for _ in parts_of(found):  # checks every name that becomes a file
        pass
    return FORMATS[name](out, found.folder)
