"""The commands about datasets: exported COCO folders, merged, filtered, split anew, converted and counted."""

from __future__ import annotations

from pathlib import Path
from typing import Literal


def dataset_merge(
    out: Path,
    sources: list[Path],
    images: Literal["link", "copy"] = "link",
    max_residual_mm: float | None = None,
) -> None:
    """Merge the exports of several workspaces into one dataset.

    Each workspace has an object frame of its own. Where the keypoints of an object, by name, agree up to a
    rigid transform, the poses of later sources are converted into the frame of the first, and the residual is
    printed in mm; where they do not, nothing is written. An image that two sources share is taken once, with
    the objects that either has labelled. Frames keep their split, but a scene that any source tests on is a
    test scene as a whole. Beside the splits, dataset.json says what was merged, how, and the hash of the
    content.

    Example: rpl dataset merge both '[workspaces/monday, workspaces/tuesday]'

    Args:
        out: folder to write; it is replaced only if `rpl dataset` wrote it and nobody edited it.
        sources: workspaces, or folders that `rpl export` or `rpl dataset` wrote.
        images: link them where the file system can, or copy them.
        max_residual_mm: by how much the keypoints of an object may differ (root mean square); three times
            the error that the labels themselves state, when left out.
    """
    from rpl_data.dataset import merge_datasets

    written = merge_datasets(out, sources, images=images, most_residual_mm=max_residual_mm)
    print("\n".join(written.lines(out)))


def dataset_filter(
    out: Path,
    source: Path,
    objects: tuple[str, ...] | None = None,
    scenes: tuple[str, ...] | None = None,
    min_visibility: float = 0.0,
    min_quality: float = 0.0,
    rate: float | None = None,
    images: Literal["link", "copy"] = "link",
) -> None:
    """Write the part of a dataset that passes, with the splits as they are.

    Example: rpl dataset filter good workspaces/demo --min_visibility 0.3 --rate 1

    Args:
        out: folder to write; it is replaced only if `rpl dataset` wrote it and nobody edited it.
        source: a workspace, or a folder that `rpl export` or `rpl dataset` wrote.
        objects: only these, and images that show one of them: '[cup, drill]'.
        scenes: only images of these.
        min_visibility: an instance less visible than this share is marked as to be ignored (`iscrowd`), since
            it is in the image all the same; an image without any other is left out.
        min_quality: an image with a label of a lower quality is left out.
        rate: images per second of recording, in each scene; all of them when left out.
        images: link them where the file system can, or copy them.
    """
    from rpl_data.dataset import Wanted, filter_dataset

    wanted = Wanted(objects, scenes, min_visibility, min_quality, rate)
    print("\n".join(filter_dataset(out, source, wanted, images=images).lines(out)))


def dataset_split(
    out: Path,
    source: Path,
    test_scenes: int | tuple[str, ...] = 1,
    val_fraction: float = 0.1,
    seed: int = 0,
    images: Literal["link", "copy"] = "link",
) -> None:
    """Split a dataset anew: `test` is whole scenes, `val` random frames of the others.

    Example: rpl dataset split resplit both --test_scenes '[00, 05]'

    Args:
        out: folder to write; it is replaced only if `rpl dataset` wrote it and nobody edited it.
        source: a workspace, or a folder that `rpl export` or `rpl dataset` wrote.
        test_scenes: the least number of test scenes (more if that covers every object), or their names.
        val_fraction: share of the frames of the other scenes.
        seed: the same seed and frames give the same split.
        images: link them where the file system can, or copy them.
    """
    from rpl_data.dataset import split_dataset
    from rpl_data.export.split import SplitRule

    rule = SplitRule(test_scenes, val_fraction, seed)
    print("\n".join(split_dataset(out, source, rule, images=images).lines(out)))


def dataset_convert(
    out: Path,
    source: Path,
    format: Literal["yolo", "coco_per_object", "okt", "huggingface", "webdataset"] = "yolo",
) -> None:
    """Write a dataset in another format: what `rpl export --format` does for a workspace, for any dataset.

    It takes rendered datasets (`rpl synthesize`), merged, filtered and split ones. The splits stay; images
    are linked, or copied into the shards of webdataset. A YOLO dataset without val is validated on its
    training images.

    Example: rpl dataset convert mixed-yolo mixed --format yolo

    Args:
        out: folder to write; a new one.
        source: a workspace, or a folder that `rpl export`, `rpl synthesize` or `rpl dataset` wrote.
        format: yolo for Ultralytics; coco_per_object; okt for ObjectKeypointTrainer; huggingface, an image
            folder for `datasets`; webdataset, tar shards.
    """
    from rpl_data.cli.building import say_written
    from rpl_data.dataset import convert_dataset

    say_written(out, convert_dataset(out, source, format))


def dataset_stats(source: Path, json: Path | None = None) -> None:
    """Count what a dataset holds: per object and scene, visibility, distances, and the views covered.

    Example: rpl dataset stats workspaces/demo --json stats.json

    Args:
        source: a workspace, or a folder that `rpl export` or `rpl dataset` wrote.
        json: also write everything to this file.
    """
    from rpl_data.dataset import dataset_stats as counts
    from rpl_data.dataset.stats_table import stats_table
    from rpl_data.files import write_json

    found = counts(source)
    if json is not None:
        write_json(json, found)
    print("\n".join(stats_table(found)))
