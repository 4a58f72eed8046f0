"""Score a trained Mask R-CNN on an exported split: `rpl evaluate masks --help`."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from rpl_data.types import DataError

from .masks.settings import SCORE_THRESHOLD


def evaluate_masks(
    coco: Path,
    masks: Path,
    split: str = "test",
    out: Path | None = None,
    threshold: float = SCORE_THRESHOLD,
    threads: int | None = None,
) -> None:
    """Average precision and mean IoU per class, in percent.

    For example: rpl evaluate masks my-workspace/export/coco runs/masks/last.ckpt --split val. With --out,
    writes <split>_results.json (COCO results) and <split>_scores.json.

    Args:
        coco: folder that `rpl export` wrote: export/coco, or export/coco_truth for true labels.
        masks: checkpoint of `rpl train masks`.
        split: train, val or test.
        out: folder for the results and the scores; nothing is written when left out.
        threshold: least score of what counts as found for IoU, missed and false; AP takes all from 0.05 on.
        threads: processor threads of torch; None leaves the number to torch.
    """
    from rpl_data.torch.splits import split_file

    from .masks.evaluation import evaluate, table
    from .masks.weights import load_segmenter
    from .runs.program import say_left_out, use_threads
    from .runs.trained_scenes import say_trained

    use_threads(threads)
    unreadable: Counter[str] = Counter()
    coco_json = split_file(coco, split)
    segmenter = load_segmenter(masks)
    if split == "test":
        say_trained([masks], coco_json)
    score = evaluate(segmenter, coco_json, out, threshold=threshold, unreadable=unreadable)
    if not score.images:
        first = next(iter(unreadable), "it has none")
        raise DataError(f"{coco_json}: no image can be scored ({first}); choose another --split")
    print(table(score))
    say_left_out(unreadable)


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(evaluate_masks))
