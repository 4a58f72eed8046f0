"""A COCO file of 100,000 annotations: seconds and memory until it is a Dataset, or checked.

    python tests/bench/bench_coco.py [ANNOTATIONS]

The baseline is what the first release did: Python's own JSON reader, and the check of one entry after the
other. Each is measured in a process of its own. "Read and checked" is how exports, merges and trainings
read: all content, an entry parsed when it is looked at; "to be edited" is all of it as dictionaries.
"""

from __future__ import annotations

import gc
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rows import record

sys.path.insert(0, str(Path(__file__).parents[1]))

from labelled_scenes import BOX, CAN, instance

from rpl_data.files import read_json
from rpl_data.formats.datasets import coco_check
from rpl_data.formats.datasets.coco import (
    CocoObject,
    image_to_coco,
    instance_to_coco,
    read_coco,
    writing_coco,
)
from rpl_data.formats.datasets.coco_edited import as_exported
from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.types import Frame, Intrinsics

CAMERA = Intrinsics(600.0, 601.0, 319.5, 239.5, 640, 480)


def write(path: Path, count: int) -> None:
    """Two objects per image, with outlines as ragged as real ones."""
    from bench_export import _grown

    with writing_coco(path, [CocoObject(BOX), CocoObject(CAN)]) as writer:
        rng = np.random.default_rng(0)
        shown = [[_grown(instance(item, x)) for item in (BOX, CAN)] for x in rng.uniform(-0.2, 0.2, 40)]
        for number in range(count // 2):
            frame = Frame(number % 1000, number / 30, Path("c.png"), None)
            scene = f"{number // 1000:03d}"
            image = image_to_coco(
                number + 1,
                frame,
                scene=scene,
                intrinsics=CAMERA,
                scene_from_camera=np.eye(4),
                file_name=f"images/{scene}/{frame.index:06d}.jpg",
                depth_file_name=None,
            )
            found = (
                instance_to_coco(2 * number + k + 1, number + 1, k + 1, one)
                for k, one in enumerate(shown[number % 40])
            )
            writer.add(image, [annotation for annotation in found if annotation is not None])


def opened(way: str, path: str) -> tuple[float, float]:
    """CPU seconds, and how many MB more than before this process took at most."""
    from rpl_data.torch import InstanceDataset, KeypointDataset

    gc.collect()
    before, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    if way == "first release":
        coco_check.FEWEST_IN_BATCH = sys.maxsize
        data = as_exported(read_json(Path(path)), source=path)
        coco_check.validate_coco(data, source=path)
    elif way == "read and checked":
        read_packed(Path(path))
    elif way == "read to be edited":
        read_coco(Path(path))
    elif way == "InstanceDataset":
        InstanceDataset(path)
    else:
        KeypointDataset(path, object="box")
    seconds = time.process_time() - started
    return seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


def main(count: int) -> None:
    """Print the table."""
    ways = ("first release", "read and checked", "read to be edited", "InstanceDataset", "KeypointDataset")
    found = {}
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "train.json"
        write(path, count)
        assert json.loads(path.read_text())["annotations"]
        for way in ways:
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                found[way] = pool.apply(opened, (way, str(path)))
            print(f"{way:20s} {found[way][0]:6.2f} s CPU  {found[way][1]:6.0f} MB", flush=True)
    asked = {"s CPU": 5.0 * count / 100_000, "MB": 400.0 * count / 100_000}
    for way in ways[1:]:
        work = f"{count} annotations, {way}"
        for unit, was, now in zip(("s CPU", "MB"), found[ways[0]], found[way], strict=True):
            better = was / asked[unit] if way != "read to be edited" else None
            record(
                "coco",
                f"{work}, {unit}",
                now,
                unit,
                baseline=("the first release's reader", was),
                asked=better,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
