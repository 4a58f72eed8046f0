"""Errors of a pose pipeline on a split of a dataset whose labels are true."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from rpl_data.formats.datasets.coco import (
    depth_unit_m,
    instance_from_coco,
    intrinsics_from_coco,
    objects_from_coco,
)
from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.geometry import fit_rigid, project, transform
from rpl_data.meshes import load_mesh, sampled
from rpl_data.pose.errors import INFINITE, pose_errors
from rpl_data.pose.estimate import Method, PoseEstimate, PoseFailure
from rpl_data.symmetries import symmetry_transforms
from rpl_data.torch.image_files import read_image
from rpl_data.types import DataError, DepthImage, InstanceLabel, Intrinsics, KeypointModel

from ..runs.options import Crops, UseDepth
from .pipeline import PosePipeline, SeenKeypoints, read_depth_like
from .scores import Judged

SYMMETRY_STEP = 0.05
"""How far a point moves between two steps about an axis of full rotation, as a part of the diameter."""


@dataclass(frozen=True)
class TrueObject:
    """An object as the true labels describe it.

    Attributes:
        category: its category id in the COCO file.
        model: its keypoints.
        symmetries: the transforms after which it looks the same, n x 4 x 4, the identity first.
        surface: points of its surface, n x 3, metres, in the truth's object frame.
        centre: centre of the surface's bounding box, where position errors are measured.
    """

    category: int
    model: KeypointModel
    symmetries: np.ndarray
    surface: np.ndarray
    centre: np.ndarray


def true_objects(coco_json: Path, names: Collection[str], *, points: int = 1000) -> dict[str, TrueObject]:
    """Read those of these objects that a true export has, with points on their meshes, by name.

    Raises:
        DataError: the export has no mesh of one of them.
    """
    found = {}
    for category, item in enumerate(objects_from_coco(read_packed(coco_json)), start=1):
        if item.model.name not in names:
            continue
        if item.mesh is None or not (coco_json.parent / item.mesh).exists():
            raise DataError(f"{coco_json}: {item.model.name} has no mesh; ADD needs one: export again")
        surface = sampled(load_mesh(coco_json.parent / item.mesh), count=points)
        centre = (surface.min(axis=0) + surface.max(axis=0)) / 2
        same = symmetry_transforms(item.symmetries, max_deviation=SYMMETRY_STEP)
        found[item.model.name] = TrueObject(category, item.model, same, surface, centre)
    return found


def evaluate(
    pipeline: PosePipeline,
    coco_json: Path,
    *,
    crops: Crops,
    methods: Sequence[Method],
    truth: Mapping[str, TrueObject],
    use_depth: UseDepth = False,
    metres_per_unit: float | None = None,
    symmetric: bool = False,
    least_visible: float = 0.1,
    unreadable: Counter[str] | None = None,
) -> Iterator[Judged]:
    """Judge every true instance of the pipeline's objects, once per method.

    A bar on a terminal shows how far it is.

    Args:
        pipeline: trained on any labels of the same keypoints. Its object frames may differ from the truth's
            by one rigid transform per object, which the two sparse models give.
        coco_json: a split of the true export.
        crops: the true boxes, or what the detector finds.
        methods: methods of PnP.
        truth: what `true_objects` read.
        use_depth: poses use the depth at the keypoints, too; `auto` where an image has some.
        metres_per_unit: unit of the depth images of an export that does not say it.
        symmetric: compare with the nearest of the poses that look the same, and its keypoints.
        least_visible: instances that show a smaller share of themselves are left out.
        unreadable: counts the images that cannot be read, by message; they are left out. Without it the first
            of them is a DataError.
    """
    data = read_packed(coco_json)
    check_known(pipeline, [category["name"] for category in data["categories"]], source=str(coco_json))
    if not symmetric:
        truth = {name: replace(one, symmetries=np.eye(4)[None]) for name, one in truth.items()}
    truth_from_trained = {
        name: aligned(truth[name].model, network.model, source=str(coco_json))
        for name, network in pipeline.networks.items()
    }
    labels_of = _labels(data, {truth[name].category: name for name in pipeline.networks}, least_visible)
    hidden = not sys.stdout.isatty()
    for image in track(data["images"], coco_json.name, transient=True, disable=hidden):
        labels = labels_of.get(image["id"], [])
        pixels = _read(coco_json.parent, image, unreadable) if labels else None
        if pixels is None:
            continue
        depth = _depth_of(coco_json.parent, image, pixels, use_depth, metres_per_unit)
        intrinsics, seen = intrinsics_from_coco(image), _seen_of(pipeline, pixels, labels, crops)
        for (label, found), method in product(zip(labels, seen, strict=True), methods):
            yield _judged(
                found,
                None if found is None else pipeline.pose(found, intrinsics, method=method, depth=depth),
                label,
                image=image["file_name"],
                method=method,
                truth=truth[label.object],
                intrinsics=intrinsics,
                truth_from_trained=truth_from_trained[label.object],
            )


def check_known(pipeline: PosePipeline, names: Collection[str], *, source: str) -> None:
    """Refuse, with a DataError, networks of objects that a dataset does not have."""
    if unknown := set(pipeline.networks) - set(names):
        raise DataError(
            f"{source} has no {', '.join(sorted(unknown))}, which a checkpoint is of; it has "
            f"{', '.join(names)}: evaluate on the dataset it was trained on"
        )


def _read(folder: Path, image: Mapping[str, Any], unreadable: Counter[str] | None) -> np.ndarray | None:
    """The pixels of an image; None, and counted, where it cannot be read and somebody counts."""
    try:
        return read_image(str(folder / image["file_name"]), size=(image["width"], image["height"]))
    except DataError as error:
        if unreadable is None:
            raise
        unreadable[str(error)] += 1
        return None


def _depth_of(
    folder: Path,
    image: Mapping[str, Any],
    pixels: np.ndarray,
    use_depth: UseDepth,
    metres_per_unit: float | None,
) -> DepthImage | None:
    """The depth of an image where it is used."""
    if use_depth is False or (use_depth == "auto" and not has_depth(image, metres_per_unit)):
        return None
    if image["depth_file_name"] is None:
        raise DataError(f"{folder / image['file_name']} has no depth image; evaluate without depth")
    unit_m = depth_unit_m(image, metres_per_unit)
    return read_depth_like(folder / str(image["depth_file_name"]), unit_m, like=pixels)


def has_depth(image: Mapping[str, Any], metres_per_unit: float | None) -> bool:
    """Whether an image of an export has depth whose unit the export or somebody says."""
    unit_m = image.get("metres_per_unit") or metres_per_unit
    return image["depth_file_name"] is not None and bool(unit_m)


def _seen_of(
    pipeline: PosePipeline, pixels: np.ndarray, labels: Sequence[InstanceLabel], crops: Crops
) -> list[SeenKeypoints | None]:
    """What the networks see of each label's instance; None where nothing is detected.

    The detector gives one box per object. Where an image shows several instances, it counts for the nearest,
    and the others are not detected.
    """
    if crops == "given":
        return [next(iter(pipeline.see(pixels, {one.object: _square(one)})), None) for one in labels]
    seen: list[SeenKeypoints | None] = [None] * len(labels)
    for found in pipeline.see(pixels, None):
        off = {row: _apart_px(found, one) for row, one in enumerate(labels) if one.object == found.object}
        if off:
            seen[min(off, key=lambda row: off[row])] = found
    return seen


def _apart_px(found: SeenKeypoints, label: InstanceLabel) -> float:
    """Mean distance of the keypoints seen from those of a label; infinite where none is labelled."""
    known = label.visibility > 0
    apart = np.linalg.norm(found.positions_px - label.keypoints_px, axis=1)[known]
    return float(apart.mean()) if len(apart) else np.inf


def _labels(
    data: Mapping[str, Any], names: Mapping[int, str], least_visible: float
) -> dict[int, list[InstanceLabel]]:
    """Labels of the named categories of which enough is visible, by image id."""
    found: dict[int, list[InstanceLabel]] = {}
    for annotation in data["annotations"]:
        name = names.get(annotation["category_id"])
        if name is not None and annotation["visib_fract"] >= least_visible:
            found.setdefault(annotation["image_id"], []).append(instance_from_coco(annotation, name))
    return found


def aligned(true: KeypointModel, trained: KeypointModel, *, source: str) -> np.ndarray:
    """The rigid transform ``truth_from_trained`` between the object frames of two label sources, 4 x 4."""
    if true.keypoints != trained.keypoints:
        raise DataError(
            f"{source}: {true.name} has the keypoints {', '.join(true.keypoints)}, the checkpoint "
            f"{', '.join(trained.keypoints)}; evaluate on the dataset it was trained on"
        )
    both = true.known & trained.known
    return fit_rigid(true.points_object[both], trained.points_object[both])


def _judged(
    seen: SeenKeypoints | None,
    solved: PoseEstimate | PoseFailure | None,
    label: InstanceLabel,
    *,
    image: str,
    method: Method,
    truth: TrueObject,
    intrinsics: Intrinsics,
    truth_from_trained: np.ndarray,
) -> Judged:
    """Compare the predicted keypoints and pose with a true label, or with the nearest that looks the same."""
    known = label.visibility > 0
    if seen is None or solved is None:
        missed = np.full(int(known.sum()), np.inf)
        return Judged(label.object, image, method, "not detected", INFINITE, missed, None, None)
    off = _keypoints_off(seen, label, truth, intrinsics)
    if isinstance(solved, PoseFailure):
        return Judged(label.object, image, method, solved.reason, INFINITE, off, None, seen)
    pose = solved.camera_from_object @ np.linalg.inv(truth_from_trained)
    same = truth.symmetries
    apart = np.abs((pose - label.camera_from_object @ same)[:, :3, :3]).sum(axis=(1, 2))
    true_pose = label.camera_from_object @ same[int(np.argmin(apart))]
    errors = pose_errors(pose, true_pose, truth.surface, centre_object=truth.centre)
    return Judged(label.object, image, method, "ok", errors, off, pose, seen)


def _keypoints_off(
    seen: SeenKeypoints, label: InstanceLabel, truth: TrueObject, intrinsics: Intrinsics
) -> np.ndarray:
    """Distance of each labelled keypoint, as a share of the box's side; of the symmetry that fits best."""
    known = label.visibility > 0
    found = [np.linalg.norm(seen.positions_px - label.keypoints_px, axis=1)[known]]
    for symmetry in truth.symmetries[1:]:
        points = transform(label.camera_from_object @ symmetry, truth.model.points_object)
        found.append(np.linalg.norm(seen.positions_px - project(intrinsics, points), axis=1)[known])
    best: np.ndarray = min(found, key=lambda off: float(np.mean(off)) if len(off) else 0.0)
    return best / label.square_box.side_px


def _square(label: InstanceLabel) -> np.ndarray:
    box = label.square_box
    return np.array([box.cx_px, box.cy_px, box.side_px])
