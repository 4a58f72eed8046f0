"""Reference views for FoundationPose's model-free mode, as its reconstruction step reads them.

::

    <folder>/ob_0000001/  K.txt  select_frames.yml
                          rgb/000000.png             8 bit
                          depth_enhanced/000000.png  16 bit, millimetres
                          mask/000000.png            255 where the object is seen
                          cam_in_ob/000000.txt       4 x 4, the camera's pose in the object frame, metres
             names.json                              which object each folder shows

Layout and names as `bundlesdf/run_nerf.py` of https://github.com/NVlabs/FoundationPose reads them (about 16
views of each object; it finds the other files by replacing `rgb` in the path of the colour image).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from rpl_data.export.dialect import DialectSummary, training_split
from rpl_data.export.folder import replacing
from rpl_data.export.views import (
    View,
    refuse_distortion,
    refuse_rgb_in,
    rows_of,
    views_of,
    write_view,
)
from rpl_data.files import write_json, write_text
from rpl_data.types import DataError
from rpl_data.wording import counted

REFERENCE_VIEWS = 16
"""Views per object, as many as the reader's own sets have."""

MOSTLY_SEEN = 0.9
"""Views that show less than this share of the object are taken only where too few show more."""


def export_foundationpose(folder: Path, coco: Path, metres_per_unit: Mapping[str, float]) -> DialectSummary:
    """Write `folder` from the training images of an exported COCO folder.

    Val and test stay out: poses that are estimated in them with these views say something.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.

    Raises:
        DataError: an object is in no training image with depth, a lens has distortion, the path of the folder
            would lead the reader astray, or the folder cannot be written.
    """
    refuse_rgb_in(folder)
    train = training_split(coco)
    lines: list[str] = []
    count, names = 0, {}
    with replacing(folder) as building:
        for category in train.data["categories"]:
            place = f"ob_{category['id']:07d}"
            views = reference_views(views_of(train, category["id"]))
            if not views:
                raise DataError(
                    f"no training image with depth shows {category['name']}, so it has no reference view; "
                    "label more frames (`label.rate`), or give more scenes to training (`split`)"
                )
            refuse_distortion(views, "FoundationPose's layout")
            _write_object(building / place, views, coco, metres_per_unit)
            names[place] = category["name"]
            count += len(views)
            if len(views) < REFERENCE_VIEWS:
                few = f"{category['name']}: {counted(len(views), 'view')} only"
                lines.append(f"{few}, {REFERENCE_VIEWS} are usual: label more frames (`label.rate`)")
        write_json(building / "names.json", names)
    return DialectSummary({train.name: count}, count, tuple(lines))


def reference_views(views: Sequence[View], *, most: int = REFERENCE_VIEWS) -> list[View]:
    """Choose views that are spread over all sides, the best first: each is far from those before it.

    The views of one camera only, the most frequent one, since a folder has one K.txt. Farthest points
    (Gonzalez, 1985) of the viewing directions, each angle weighted by the label's quality.
    """
    alike = _of_one_camera(views)
    clear = [view for view in alike if view.annotation["visib_fract"] >= MOSTLY_SEEN]
    candidates = clear if len(clear) >= most else alike
    if not candidates:
        return []
    directions = np.array([view.direction for view in candidates])
    worth = np.array([view.annotation["quality"] for view in candidates], dtype=np.float64)
    chosen = [int(worth.argmax())]
    while len(chosen) < min(most, len(candidates)):
        nearest = np.arccos(np.clip(directions @ directions[chosen].T, -1, 1)).min(axis=1)
        gain = nearest * worth
        gain[chosen] = -1.0
        chosen.append(int(gain.argmax()))
    return [candidates[row] for row in chosen]


def _of_one_camera(views: Sequence[View]) -> list[View]:
    groups: dict[object, list[View]] = {}
    for view in views:
        groups.setdefault(view.camera, []).append(view)
    return max(groups.values(), key=len, default=[])


def _write_object(
    folder: Path, views: Sequence[View], coco: Path, metres_per_unit: Mapping[str, float]
) -> None:
    for number, view in enumerate(views):
        name = f"{number:06d}"
        write_view(
            view,
            coco,
            color=folder / "rgb" / f"{name}.png",
            depth=folder / "depth_enhanced" / f"{name}.png",
            mask=folder / "mask" / f"{name}.png",
            metres_per_unit=metres_per_unit,
        )
        write_text(folder / "cam_in_ob" / f"{name}.txt", rows_of(view.object_from_camera))
    write_text(folder / "K.txt", rows_of(views[0].camera.matrix))
    chosen = [_source(view) for view in views]
    write_text(folder / "select_frames.yml", yaml.safe_dump({"frames": chosen}))


def _source(view: View) -> str:
    """Where a view is from; an image with several instances gives several views."""
    instance = view.annotation.get("instance")
    frame = f"{view.image['scene']}/{view.image['frame']:06d}"
    return f"{frame}_instance_{instance}" if instance else frame
