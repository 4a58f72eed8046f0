"""BOP's onboarding: for each object videos as it stands, as it lies the other way round, and as it is moved.

::

    <folder>/onboarding_static/obj_000001_up/     a scene as in `bop`, with this object only
                               obj_000001_down/
             onboarding_dynamic/obj_000001/       the same of a scene in which it is moved, if there is
             names.json                           object and scene of each folder

From these videos, model-free methods learn an object before they look for it. BOP's own dynamic videos give
the pose of the first frame alone; here all frames have theirs, which a method must not look at. Layout:
`docs/bop_datasets_format.md` of https://github.com/thodan/bop_toolkit; object and image numbers are those of
`bop`, beside whose splits the folder belongs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.export.bop import write_scene
from rpl_data.export.bop_instances import Silhouettes
from rpl_data.export.color_images import ColorFormat
from rpl_data.export.dialect import DialectSummary, Split, training_split
from rpl_data.export.folder import replacing
from rpl_data.files import write_json
from rpl_data.formats.datasets.coco import objects_from_coco
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.types import DataError

STATIC, DYNAMIC = "onboarding_static", "onboarding_dynamic"


@dataclass(frozen=True)
class Video:
    """The images of a scene that show an object once.

    Attributes:
        up_object: which way is up for the cameras, on average; unit vector in the object frame.
    """

    scene: str
    images: tuple[Json, ...]
    up_object: Float64[np.ndarray, "3"]


def export_bop_onboarding(
    folder: Path,
    coco: Path,
    metres_per_unit: Mapping[str, float],
    color: ColorFormat = "recorded",
    *,
    moving: Collection[str] = (),
) -> DialectSummary:
    """Write `folder` from the training images of an exported COCO folder.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.
        color: format of the colour images.
        moving: the scenes in which objects are moved.

    Raises:
        DataError: an object is in no training image, a lens has distortion, which the layout cannot hold, or
            the folder cannot be written.
    """
    train = training_split(coco)
    whole = Silhouettes(coco, objects_from_coco(train.data))
    lines, names, count = [], {}, 0
    with replacing(folder) as building:
        for category in train.data["categories"]:
            videos = _videos(train, category["id"])
            sides = opposite_sides([video for video in videos if video.scene not in moving])
            carried = max((v for v in videos if v.scene in moving), key=lambda v: len(v.images), default=None)
            if not videos:
                raise DataError(
                    f"no training image shows one {category['name']}, so it has no onboarding video; label "
                    "more frames (`label.rate`), or give more scenes to training (`split`)"
                )
            if len(sides) == 1:
                lines.append(f"{category['name']}: no training scene shows it the other way round: no _down")
            number = f"obj_{category['id']:06d}"
            places = {f"{STATIC}/{number}_{side}": video for side, video in sides.items()}
            places |= {} if carried is None else {f"{DYNAMIC}/{number}": carried}
            alone = _only(train, category["id"])
            for place, video in places.items():
                unit_m = metres_per_unit[video.scene]
                write_scene(building / place, coco, video.images, alone, unit_m, whole, color)
                names[Path(place).name] = {"object": category["name"], "scene": video.scene}
                count += len(video.images)
        write_json(building / "names.json", names)
    return DialectSummary({train.name: count}, count, tuple(lines))


def opposite_sides(videos: Sequence[Video]) -> dict[str, Video]:
    """Choose the longest video as `up`, and as `down` the one that shows the object most upside down.

    There is no `down` where the object lies the same way in all of them, to a quarter of a turn.
    """
    if not videos:
        return {}
    up = max(videos, key=lambda video: len(video.images))
    down = min(videos, key=lambda video: float(video.up_object @ up.up_object))
    return {"up": up} | ({"down": down} if down.up_object @ up.up_object < 0 else {})


def _videos(split: Split, category: int) -> list[Video]:
    """The scenes of a split that show an object, by name."""
    scenes: dict[str, list[Json]] = {}
    ups: dict[str, list[Float64[np.ndarray, "3"]]] = {}
    for image in split.images:
        mine = _of(split.annotations.get(image["id"], []), category)
        if len(mine) == 1:
            scenes.setdefault(image["scene"], []).append(image)
            camera_from_object = matrix_from_json(mine[0]["camera_from_object"])
            ups.setdefault(image["scene"], []).append(-camera_from_object[1, :3])  # the camera's y is down
    return [Video(name, tuple(images), _unit(ups[name])) for name, images in sorted(scenes.items())]


def _unit(vectors: Sequence[Float64[np.ndarray, "3"]]) -> Float64[np.ndarray, "3"]:
    mean = np.mean(vectors, axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _of(annotations: Sequence[Json], category: int) -> list[Json]:
    return [one for one in annotations if one["category_id"] == category]


def _only(split: Split, category: int) -> Split:
    """A split with the labels of one object."""
    return replace(split, annotations={key: _of(each, category) for key, each in split.annotations.items()})
