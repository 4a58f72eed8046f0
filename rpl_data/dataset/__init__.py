"""Exported COCO folders as data: merged, filtered, split anew, converted, and counted.

A dataset is a folder that `rpl export` wrote (`export/coco` of a workspace) or that one of these functions
wrote. What they write is again such a folder, with a version file, `dataset.json`, beside the splits.
"""

from rpl_data.dataset.convert import convert_dataset
from rpl_data.dataset.merge import merge_datasets
from rpl_data.dataset.narrow import Wanted, filter_dataset, split_dataset
from rpl_data.dataset.stats import dataset_stats
from rpl_data.dataset.written import Written

__all__ = [
    "Wanted",
    "Written",
    "convert_dataset",
    "dataset_stats",
    "filter_dataset",
    "merge_datasets",
    "split_dataset",
]
