"""Find objects in an image, a folder or a video: `rpl predict masks --help`."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from rpl_data.types import DataError
from rpl_data.wording import counted

from .masks.settings import SCORE_THRESHOLD


def predict_masks(
    images: Path,
    masks: Path,
    out: Path = Path("runs/predicted_masks"),
    threshold: float = SCORE_THRESHOLD,
    threads: int | None = None,
) -> None:
    """Find objects in an image, a folder of images or a video.

    For example: rpl predict masks photos runs/masks/last.ckpt. Writes the pictures (or the video) with
    masks, boxes, names and scores drawn on them, results.json (COCO results with boxes and masks) and
    images.json (which image has which id). Images of a folder that cannot be read are left out and counted.

    Args:
        images: an image, a folder of images, or a video.
        masks: checkpoint of `rpl train masks`.
        out: folder for everything that is written.
        threshold: least score of what is drawn; results.json has all from a score of 0.05 on.
        threads: processor threads of torch; None leaves the number to torch.
    """
    from .masks.prediction import predict_to
    from .masks.weights import load_segmenter
    from .runs.program import say_left_out, use_threads

    use_threads(threads)
    if out.resolve() in {images.resolve(), images.resolve().parent}:
        raise DataError(f"the overlays would replace the images of {out}; choose another --out")
    unreadable: Counter[str] = Counter()
    count, drawn = predict_to(load_segmenter(masks), images, out, threshold=threshold, unreadable=unreadable)
    print(
        f"{out}: {counted(count, 'image')}, {counted(drawn, 'object')} with a score of {threshold:g} or more"
    )
    say_left_out(unreadable)


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(predict_masks))
