"""Tar shards for WebDataset: all files of an image stand together under one key.

::

    <folder>/{train,val,test}-000000.tar    KEY.jpg KEY.json KEY.mask.png KEY.depth.png

KEY.json has the image's entry of the COCO file and its `annotations`. KEY.mask.png: 0 = background, n = the
n-th annotation. Images of all scenes are mixed, since readers shuffle within a few shards only. Convention:
https://github.com/webdataset/webdataset (keys without dots, files of a key one after the other).
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rpl_data.export.dialect import DialectSummary, Split, splits_of
from rpl_data.export.folder import replacing
from rpl_data.export.views import numbered
from rpl_data.files import read_bytes
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.json_arrays import Json

SHARD_IMAGES = 1000


def export_webdataset(folder: Path, coco: Path) -> DialectSummary:
    """Write `folder` from an exported COCO folder.

    Raises:
        DataError: the COCO folder is missing or broken, an image has more than 255 instances, or the folder
            cannot be written.
    """
    images: dict[str, int] = {}
    instances = 0
    with replacing(folder) as building:
        building.mkdir(exist_ok=True)
        for split in splits_of(coco):
            mixed = [split.images[row] for row in np.random.default_rng(0).permutation(len(split.images))]
            for first in range(0, len(mixed), SHARD_IMAGES):
                shard = building / f"{split.name}-{first // SHARD_IMAGES:06d}.tar"
                instances += _write_shard(shard, coco, mixed[first : first + SHARD_IMAGES], split)
            images[split.name] = len(mixed)
    return DialectSummary(images, instances)


def _write_shard(shard: Path, coco: Path, images: Sequence[Json], split: Split) -> int:
    """Write a tar file; returns how many instances are in it."""
    instances = 0
    with tarfile.open(shard, "w", format=tarfile.USTAR_FORMAT) as tar:
        for image in images:
            annotations = split.annotations.get(image["id"], [])
            key = f"{image['scene']}_{image['frame']:06d}".replace(".", "_")
            source = coco / image["file_name"]
            _add(tar, f"{key}{source.suffix}", read_bytes(source))
            record = json.dumps({**image, "annotations": annotations}, allow_nan=False)
            _add(tar, f"{key}.json", record.encode())
            _add(
                tar,
                f"{key}.mask.png",
                encoded(numbered(image, annotations, range(1, len(annotations) + 1)), "png"),
            )
            if image["depth_file_name"] is not None:
                depth = coco / image["depth_file_name"]
                _add(tar, f"{key}.depth{depth.suffix}", read_bytes(depth))
            instances += len(annotations)
    return instances


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    """Add a file without a time or an owner, so that the same labels give the same bytes."""
    entry = tarfile.TarInfo(name)
    entry.size = len(content)
    tar.addfile(entry, io.BytesIO(content))
