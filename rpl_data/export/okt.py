"""ObjectKeypointTrainer's datasets, as RapidPoseLabels writes them: one folder per object.

::

    <folder>/<object>/frames/frame_00000.jpg
                      center/center_00000.txt      two lines: x, y of the square box's centre, pixels
                      scale/scales_00000.txt       its side / 200
                      label/label_00000.txt        one line "u v" per keypoint, even if hidden or outside
                      bboxes/frame_00000.txt       darknet: class 0, centre and size as shares of the image
                      masks/mask_00000.png         255 where the object is visible
                      train.txt, valid.txt         absolute paths of the images; test.txt is ours
                      camera_matrix.npy            3 x 3, for its PnP

The layout cannot express a keypoint without a position: those never clicked are left out of every frame, so
keypoint n is line n of `keypoints.txt`. COCO does not label keypoints outside the image; here they lie where
the pose puts them.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from rpl_data.export.dialect import DialectSummary, Split, splits_of
from rpl_data.export.folder import link, replacing
from rpl_data.files import write_bytes, write_text, writing
from rpl_data.formats.datasets.coco import intrinsics_from_coco, objects_from_coco
from rpl_data.formats.datasets.yolo import detect_line
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.geometry import Pixels, inside_image, project, transform
from rpl_data.images import read_pixels
from rpl_data.json_arrays import Json, matrix_from_json
from rpl_data.types import DataError, KeypointModel

LISTS = {"train": "train.txt", "val": "valid.txt", "test": "test.txt"}
UNIT_PX = 200.0
"""Pixels per unit of a scale, as in datasets of human pose."""


def export_okt(folder: Path, coco: Path) -> DialectSummary:
    """Write `folder` from an exported COCO folder; JPEG images are linked, others converted.

    Raises:
        DataError: the COCO folder is missing or broken, or the folder cannot be written.
    """
    images: dict[str, int] = {}
    counts: Counter[str] = Counter()
    left_out: Counter[str] = Counter()
    with replacing(folder) as building:
        for split in splits_of(coco):
            images[split.name] = len(split.images)
            for number, item in enumerate(objects_from_coco(split.data), start=1):
                model, first = item.model, counts[item.model.name]
                labels, incomplete = _whole(split, number, model)
                left_out[f"{model.name}: frames left out, as a keypoint has no position there"] += incomplete
                left_out[f"{model.name}: keypoints left out, as they were never clicked"] = int(
                    (~model.known).sum()
                )
                for index, label in enumerate(labels, start=first):
                    _write_frame(building / model.name, index, coco, *label)
                if labels:
                    _write_list(building, folder, split.name, model.name, range(first, first + len(labels)))
                    _write_object(building / model.name, model, labels[0][0])
                counts[model.name] += len(labels)
    lines = tuple(f"{what}: {count}" for what, count in left_out.items() if count)
    return DialectSummary(images, counts.total(), lines)


def _whole(split: Split, category: int, model: KeypointModel) -> tuple[list[tuple[Json, Json, Pixels]], int]:
    """Images with the object where every known keypoint has a position; number of others.

    Returns:
        Image, annotation and positions of the known keypoints, per label; how many labels lack one.
    """
    by_id = {image["id"]: image for image in split.images}
    every = [
        one for several in split.annotations.values() for one in several if one["category_id"] == category
    ]
    placed = [(by_id[one["image_id"]], one, _positions(by_id[one["image_id"]], one, model)) for one in every]
    whole = [label for label in placed if np.isfinite(label[2]).all()]
    return whole, len(every) - len(whole)


def _positions(image: Json, annotation: Json, model: KeypointModel) -> Pixels:
    """Pixels of the known keypoints; NaN behind the camera, and where the image should show one but does not.

    COCO has no keypoints outside the image, so the pose says where these are.
    """
    table = np.array(annotation["keypoints"], dtype=np.float64).reshape(-1, 3)[model.known]
    camera, pose = intrinsics_from_coco(image), matrix_from_json(annotation["camera_from_object"])
    posed = project(camera, transform(pose, model.points_object[model.known]))
    posed[inside_image(camera, posed)] = np.nan
    return np.where(table[:, 2:] > 0, table[:, :2], posed)


def _write_list(building: Path, folder: Path, split: str, name: str, indices: range) -> None:
    """Write the paths of a split's images, where they will be."""
    frames = folder.absolute() / name / "frames"
    lines = [f"{frames / _stem(index)}.jpg\n" for index in indices]
    write_text(building / name / LISTS[split], "".join(lines))


def _stem(index: int) -> str:
    return f"frame_{index:05d}"


def _write_object(folder: Path, model: KeypointModel, image: Json) -> None:
    """Write what all frames share: names of the keypoints, and the camera."""
    names = [name for name, known in zip(model.keypoints, model.known, strict=True) if known]
    write_text(folder / "keypoints.txt", "".join(f"{name}\n" for name in names))
    with writing(folder / "camera_matrix.npy", "wb") as file:
        np.save(file, intrinsics_from_coco(image).matrix)


def _write_frame(
    folder: Path, index: int, coco: Path, image: Json, annotation: Json, keypoints_px: Pixels
) -> None:
    from pycocotools import mask as masks

    _link_jpeg(coco / image["file_name"], folder / "frames" / f"{_stem(index)}.jpg")
    cx, cy, side = annotation["square_box"]
    box = detect_line(image, annotation, ()).split()[1:]
    write_text(folder / "center" / f"center_{index:05d}.txt", f"{cx!r}\n{cy!r}\n")
    write_text(folder / "scale" / f"scales_{index:05d}.txt", f"{side / UNIT_PX!r}\n")
    write_text(
        folder / "label" / f"label_{index:05d}.txt",
        "".join(f"{u!r} {v!r}\n" for u, v in keypoints_px.tolist()),
    )
    write_text(folder / "bboxes" / f"{_stem(index)}.txt", "\t".join(["0", *box]) + "\n")
    mask = masks.decode(annotation["segmentation"]) * np.uint8(255)
    write_bytes(folder / "masks" / f"mask_{index:05d}.png", encoded(mask, "png"))


def _link_jpeg(source: Path, target: Path) -> None:
    """Link a JPEG; convert any other image to one."""
    if source.suffix.lower() in (".jpg", ".jpeg"):
        link(source, target)
        return
    image = read_pixels(source)
    if image is None:
        raise DataError(f"{source} is missing or damaged; put it back and export again")
    write_bytes(target, encoded(image[..., ::-1], "jpg"))
