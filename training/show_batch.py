"""Show what training crops look like: `python -m training.show_batch --help`."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from pathlib import Path

from rpl_data.torch.augmentation import Augmentation

TYPE_CHECKING = False  # not typing's: the parser of the options would import what follows, torch and all
if TYPE_CHECKING:
    import numpy as np

    from rpl_data.torch.keypoints import KeypointSample

NONE = Augmentation(scale=0.0, shift=0.0, rotation_deg=0.0, gain=0.0, offset=0.0)
GAP_PX = 4
COLOURS = (
    (230, 25, 75), (60, 180, 75), (255, 225, 25), (0, 130, 200),
    (245, 130, 48), (145, 30, 180), (70, 240, 240), (240, 50, 230),
)  # fmt: skip
HEADING_PX = 22


def show_batch(
    coco: Path,
    object: str | None = None,  # noqa: A002 (the recipe's and the CLI's word for it)
    split: str = "train",
    out: Path = Path("batch.png"),
    augment: Augmentation = Augmentation(),  # noqa: B008 (frozen)
    columns: int = 8,
    input_px: int = 128,
    seed: int = 0,
) -> Path:
    """Write a picture of crops: as labelled, with each augmentation alone, and with all of them.

    A row per augmentation that is not 0, under its name; dots are keypoints that are seen, rings those that
    are hidden. For example: python -m training.show_batch my-workspace/export/coco --object cube
    --augment.background 1 --augment.light 0.5. The path of the picture comes back.

    Args:
        coco: folder that `rpl export` wrote.
        object: name of the object; may be left out when the dataset has one object.
        split: train, val or test.
        out: the picture, a PNG.
        augment: as in `rpl train keypoints`.
        columns: crops per row.
        input_px: side of a crop.
        seed: of what is drawn at random.
    """
    import cv2
    import numpy as np
    import torch

    from rpl_data.files import write_bytes
    from rpl_data.torch.keypoints import KeypointDataset
    from rpl_data.types import DataError

    if columns < 1:
        raise DataError(f"columns is {columns}; give 1 or more")
    if out.suffix.lower() != ".png":
        raise DataError(f"--out is {out}; the picture is a PNG: give it a name that ends in .png")
    strips = []
    for name, alone in _alone(augment).items():
        data = KeypointDataset(coco, split=split, object=object, input_px=input_px, augment=alone)
        rows = np.linspace(0, len(data) - 1, columns).round().astype(int)
        torch.manual_seed(seed)
        strips.append(_strip(name, [data[int(row)] for row in rows]))
    png = cv2.imencode(".png", cv2.cvtColor(np.vstack(strips), cv2.COLOR_RGB2BGR))[1]
    write_bytes(out, png.tobytes())
    print(out)
    return out


def _alone(augment: Augmentation) -> dict[str, Augmentation | None]:
    """Augmentations by their headings: none, each option alone, all."""
    shown: dict[str, Augmentation | None] = {"as labelled": None}
    for field in fields(augment):
        value = getattr(augment, field.name)
        if not value or field.name == "backgrounds":
            continue
        folder = augment.backgrounds if field.name == "background" else None
        shown[f"{field.name} {value}"] = replace(NONE, backgrounds=folder, **{field.name: value})
    return {**shown, "all of them": augment}


def _strip(heading: str, samples: list[KeypointSample]) -> np.ndarray:
    """A row of crops with their keypoints, below a heading."""
    import cv2
    import numpy as np

    crops = [
        np.pad(_drawn(sample), ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255) for sample in samples
    ]
    row = np.hstack(crops)
    above = np.full((HEADING_PX, row.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(above, heading, (2, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([above, row])


def _drawn(sample: KeypointSample) -> np.ndarray:
    """A crop with its keypoints: dots where they are seen, rings where they are hidden."""
    import cv2
    import numpy as np

    from rpl_data.torch.transforms import moved

    crop = np.ascontiguousarray((sample["image"] * 255).byte().permute(1, 2, 0).numpy())
    on_crop = moved(sample["crop_from_image"].numpy(), sample["keypoints_px"].numpy())
    for number, (place, seen) in enumerate(zip(on_crop, sample["visibility"].tolist(), strict=True)):
        if seen and np.isfinite(place).all():
            colour = COLOURS[number % len(COLOURS)]
            cv2.circle(crop, tuple(np.rint(place).astype(int).tolist()), 3, colour, -1 if seen == 2 else 1)
    return crop


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(show_batch, presets=False))
