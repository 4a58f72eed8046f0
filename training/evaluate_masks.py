"""Score a trained Mask R-CNN on an exported split: `python -m training.evaluate_masks --help`."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

import torch

from rpl_data.files import write_json
from training.masks.results import predict_split
from training.masks.scores import SplitScore, score_split
from training.masks.weights import Segmenter, load_segmenter

SCORE_THRESHOLD = 0.5
"""Least score of what counts as found for the IoU."""


def evaluate(
    segmenter: Segmenter, coco_json: Path, out: Path | None = None, *, threshold: float = SCORE_THRESHOLD
) -> SplitScore:
    """Scores on a split; with `out`, also `<split>_results.json` (COCO's) and `<split>_scores.json`."""
    results = predict_split(segmenter, coco_json)
    score = score_split(coco_json, results, threshold=threshold)
    if out is not None:
        write_json(out / f"{coco_json.stem}_results.json", results, indent=None)
        write_json(out / f"{coco_json.stem}_scores.json", {"threshold": threshold, **asdict(score)})
    return score


def table(score: SplitScore) -> str:
    """The scores as lines for a terminal."""
    lines = [f"{'class':20s} images  mean IoU  missed  false  box AP  mask AP  mask AP50"]
    for row in score.classes:
        lines.append(
            f"{row.name:20s} {row.images:6d}  {_percent(row.mean_iou):>8s}  {row.missed:6d}  "
            f"{row.false_alarms:5d}  {_percent(row.box_ap):>6s}  {_percent(row.mask_ap):>7s}  "
            f"{_percent(row.mask_ap50):>9s}"
        )
    lines.append(
        f"{'all':20s} {score.images:6d}  {_percent(score.mean_iou):>8s}  {'':6s}  {'':5s}  "
        f"{_percent(score.box_ap):>6s}  {_percent(score.mask_ap):>7s}  {_percent(score.mask_ap50):>9s}"
    )
    return "\n".join(lines)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


def evaluate_masks(
    checkpoint: Path,
    data: Path,
    out: Path | None = None,
    threshold: float = SCORE_THRESHOLD,
    threads: int | None = None,
) -> None:
    """Average precision and mean IoU per class, in percent.

    Args:
        checkpoint: `last.ckpt` of training.train_masks.
        data: a COCO file that `rpl export` wrote: test.json, val.json.
        out: folder for the results and the scores; nothing is written when left out.
        threshold: least score of what counts as found for IoU, missed and false; AP uses everything.
        threads: processor cores to use; as many as there are when left out.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    print(table(evaluate(load_segmenter(checkpoint), data, out, threshold=threshold)))


if __name__ == "__main__":
    from training.runs.program import main

    sys.exit(main(evaluate_masks))
