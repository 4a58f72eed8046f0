"""Instances of a BOP scene: both masks, the numbers of scene_gt_info.json, the entries of scene_gt_coco.json.

Definitions of the numbers: `scripts/calc_gt_info.py` and `calc_gt_coco.py` of
https://github.com/thodan/bop_toolkit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from rpl_data.files import write_bytes
from rpl_data.formats.datasets.coco import CocoObject, intrinsics_from_coco
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.meshes import load_mesh
from rpl_data.raycast import RayScene, render_depth_m

LEAST_VISIBLE = 0.1
"""The benchmark asks for poses of instances that show at least this share of themselves."""

Mask = Bool[np.ndarray, "height width"]
Canvas = Bool[np.ndarray, "_ _"]


class Silhouettes:
    """Silhouettes of objects on a canvas three times as wide and as high, as the benchmark counts them."""

    def __init__(self, coco: Path, objects: Sequence[CocoObject]) -> None:
        """Remember where the meshes are; each is loaded when an image first cuts its object off."""
        self._files: Mapping[int, Path | None] = {
            number: None if item.mesh is None else coco / item.mesh
            for number, item in enumerate(objects, start=1)
        }
        self._rays: dict[int, RayScene] = {}

    def around(self, image: Json, annotation: Json, inside: Mask) -> tuple[Canvas, int, int]:
        """The whole silhouette, and the column and the row of the canvas where the image starts.

        Without a mesh, or where nothing is cut off, it is the mask of the image itself.

        Args:
            image, annotation: entries of the COCO file.
            inside: the object's silhouette within the image.
        """
        file = self._files[annotation["category_id"]]
        if file is None or not annotation["truncated"]:
            return inside, 0, 0
        if annotation["category_id"] not in self._rays:
            self._rays[annotation["category_id"]] = RayScene([load_mesh(file)], threads=1)
        rays = self._rays[annotation["category_id"]]
        height, width = inside.shape
        depth_m = render_depth_m(
            rays,
            intrinsics_from_coco(image),
            matrix_from_json(annotation["camera_from_object"]),
            left_px=-width,
            top_px=-height,
            width=3 * width,
            height=3 * height,
        )
        canvas = depth_m > 0
        canvas[height : 2 * height, width : 2 * width] = inside
        return canvas, width, height


def write_instance(
    folder: Path, name: str, image: Json, annotation: Json, measured: np.ndarray | None, whole: Silhouettes
) -> Json:
    """Write both masks of an instance, and return its entry of scene_gt_info.json.

    Args:
        folder: of the scene.
        name: of the two mask files.
        image, annotation: entries of the COCO file.
        measured: the depth image, where there is one.
        whole: silhouettes beyond the border of the image.
    """
    from pycocotools import mask as masks

    full = masks.decode(annotation["segmentation_full"]).view(np.bool_)
    visible = masks.decode(annotation["segmentation"]).view(np.bool_)
    for kind, mask in (("mask", full), ("mask_visib", visible)):
        write_bytes(folder / kind / name, encoded(mask.astype(np.uint8) * 255, "png"))
    silhouette, left, top = whole.around(image, annotation, full)
    valid = full if measured is None else full & (measured > 0)
    return {
        "bbox_obj": _box(silhouette, left, top),
        "bbox_visib": _box(visible),
        "px_count_all": int(silhouette.sum()),
        "px_count_valid": int(valid.sum()),
        "px_count_visib": int(visible.sum()),
        "visib_fract": float(visible.sum() / silhouette.sum()),
    }


def coco_entry(number: int, image: Json, annotation: Json, info: Json) -> Json:
    """An instance for scene_gt_coco.json: the mask of what is seen, the box of all of it in the image."""
    height, width = annotation["segmentation"]["size"]
    return {
        "id": number,
        "image_id": image["frame"],
        "category_id": annotation["category_id"],
        "iscrowd": 0,
        "area": annotation["area"],
        "bbox": annotation["bbox_full"],
        "segmentation": {
            "size": [height, width],
            "counts": _counts(_decoded(annotation)),
        },
        "width": width,
        "height": height,
        "ignore": info["visib_fract"] < LEAST_VISIBLE,
    }


def _decoded(annotation: Json) -> np.ndarray:
    from pycocotools import mask as masks

    return np.asarray(masks.decode(annotation["segmentation"]))


def _counts(mask: np.ndarray) -> list[int]:
    """COCO's run lengths without compression: columns one after the other, zeros first."""
    flat = mask.ravel(order="F").astype(np.int8)
    starts = np.flatnonzero(np.diff(flat, prepend=0))
    return [int(run) for run in np.diff(np.concatenate([[0], starts, [len(flat)]]))]


def _box(mask: Canvas, left_px: int = 0, top_px: int = 0) -> list[int]:
    """x, y, width, height as BOP counts them: from the first pixel to the last, not to its far edge."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return [-1, -1, -1, -1]
    x, y = int(columns.min()) - left_px, int(rows.min()) - top_px
    return [x, y, int(np.ptp(columns)), int(np.ptp(rows))]
