"""A trained Mask R-CNN judged on a split: predictions, scores, the table that is printed."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path

from rpl_data.files import write_json

from .results import predict_split
from .scores import SplitScore, score_split
from .settings import SCORE_THRESHOLD
from .weights import Segmenter


def evaluate(
    segmenter: Segmenter,
    coco_json: Path,
    out: Path | None = None,
    *,
    threshold: float = SCORE_THRESHOLD,
    unreadable: Counter[str] | None = None,
) -> SplitScore:
    """Scores on a split.

    Args:
        segmenter: the trained network.
        coco_json: the split's labels.
        out: folder for `<split>_results.json` (COCO results) and `<split>_scores.json`; None writes nothing.
        threshold: least score of what counts as found for the IoU; AP uses everything.
        unreadable: counts the images that cannot be read, by message; they are left out of the scores.
            Without it the first of them is a DataError.
    """
    results, left_out = predict_split(segmenter, coco_json, unreadable=unreadable)
    score = score_split(coco_json, results, threshold=threshold, left_out=left_out)
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
