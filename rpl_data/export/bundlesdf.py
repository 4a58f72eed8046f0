"""Videos of single objects, as BundleSDF reads them: every labelled frame of a scene, in order.

::

    <folder>/<object>/<scene>/  cam_K.txt           (<scene>_instance_2 for another instance there)
                                rgb/000000.png              8 bit; files are called by frame number
                                depth/000000.png            16 bit, millimetres
                                masks/000000.png            255 where the object is seen
                                annotated_poses/000000.txt  4 x 4, camera_from_object, metres

Layout and names as the README and `data_reader.py` of https://github.com/NVlabs/BundleSDF give them for one's
own videos; `annotated_poses` is where the YCBInEOAT videos, which it also reads, keep the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rpl_data.export.dialect import DialectSummary, splits_of
from rpl_data.export.folder import replacing
from rpl_data.export.views import View, refuse_distortion, refuse_rgb_in, rows_of, views_of, write_view
from rpl_data.files import write_text
from rpl_data.json_arrays import matrix_from_json


def export_bundlesdf(folder: Path, coco: Path, metres_per_unit: Mapping[str, float]) -> DialectSummary:
    """Write `folder` from all splits of an exported COCO folder: a video is one scene, whatever its splits.

    Args:
        folder: folder to write; its old content is replaced.
        coco: the exported COCO folder.
        metres_per_unit: unit of the depth images, by scene name.

    Raises:
        DataError: a lens has distortion, the path of the folder would lead the reader astray, or the folder
            cannot be written.
    """
    refuse_rgb_in(folder)
    images: dict[str, int] = {}
    cameras: dict[Path, View] = {}
    with replacing(folder) as building:
        for split in splits_of(coco):
            images[split.name] = 0
            for category in split.data["categories"]:
                views = views_of(split, category["id"])
                refuse_distortion(views, "BundleSDF's layout")
                _write_frames(building / category["name"], views, coco, metres_per_unit)
                images[split.name] += len(views)
                cameras |= {building / category["name"] / _video(view): view for view in views}
        for place, view in cameras.items():
            write_text(place / "cam_K.txt", rows_of(view.camera.matrix))
    return DialectSummary(images, sum(images.values()))


def _write_frames(
    folder: Path, views: Sequence[View], coco: Path, metres_per_unit: Mapping[str, float]
) -> None:
    for view in views:
        place, name = folder / _video(view), f"{view.image['frame']:06d}"
        write_view(
            view,
            coco,
            color=place / "rgb" / f"{name}.png",
            depth=place / "depth" / f"{name}.png",
            mask=place / "masks" / f"{name}.png",
            metres_per_unit=metres_per_unit,
        )
        pose = matrix_from_json(view.annotation["camera_from_object"])
        write_text(place / "annotated_poses" / f"{name}.txt", rows_of(pose))


def _video(view: View) -> str:
    """Name of the video of an instance in a scene; it shows one object."""
    instance = view.annotation.get("instance")
    return f"{view.image['scene']}_instance_{instance}" if instance else str(view.image["scene"])
