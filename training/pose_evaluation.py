"""Errors of a pose pipeline on a split of a dataset whose labels are true."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.formats.coco import instance_from_coco, intrinsics_from_coco, objects_from_coco, read_coco
from rpl_data.geometry import fit_rigid
from rpl_data.pose import Method, PoseFailure
from rpl_data.pose.errors import INFINITE, pose_errors
from rpl_data.torch.regions import read_image
from rpl_data.types import DataError, InstanceLabel, KeypointModel
from training.options import Crops
from training.pose_pipeline import PosePipeline, SeenKeypoints
from training.pose_scores import Judged


@dataclass(frozen=True)
class TrueObject:
    """An object as the truth has it.

    Attributes:
        category: its category id in the file.
        surface: points of its surface, n x 3, metres, the truth's object frame.
        centre: of the surface's bounding box: where position errors are taken.
    """

    category: int
    model: KeypointModel
    surface: np.ndarray
    centre: np.ndarray


def true_objects(coco_json: Path, *, points: int = 1000) -> dict[str, TrueObject]:
    """The objects of a true export, with points of their meshes, by name.

    Raises:
        DataError: the export has no mesh of an object.
    """
    found = {}
    for category, item in enumerate(objects_from_coco(read_coco(coco_json)), start=1):
        if item.mesh is None or not (coco_json.parent / item.mesh).exists():
            raise DataError(f"{coco_json}: {item.model.name} has no mesh; ADD needs one: export again")
        surface = surface_points(coco_json.parent / item.mesh, points)
        centre = (surface.min(axis=0) + surface.max(axis=0)) / 2
        found[item.model.name] = TrueObject(category, item.model, surface, centre)
    return found


def surface_points(mesh: Path, count: int) -> np.ndarray:
    """Points spread evenly over a mesh file's surface, the same ones every time."""
    import open3d

    open3d.utility.random.seed(0)
    triangles = open3d.io.read_triangle_mesh(str(mesh))
    return np.asarray(triangles.sample_points_uniformly(count).points)


def evaluate(
    pipeline: PosePipeline,
    coco_json: Path,
    *,
    crops: Crops,
    methods: Sequence[Method],
    truth: Mapping[str, TrueObject],
    least_visible: float = 0.1,
) -> Iterator[Judged]:
    """Every true instance of the pipeline's objects, judged; a line an instance and method.

    Args:
        pipeline: trained on any labels of the same keypoints; its object frames may differ from the truth's
            by one rigid transform an object, which the two sparse models give.
        coco_json: a split of the true export.
        crops: the true boxes, or what the detector finds.
        methods: of PnP.
        truth: of `true_objects`.
        least_visible: instances that show a smaller share of themselves are left out.
    """
    data = read_coco(coco_json)
    truth_from_trained = {
        name: aligned(truth[name].model, network.model, source=str(coco_json))
        for name, network in pipeline.networks.items()
    }
    of_image: dict[int, list[dict[str, Any]]] = {image["id"]: [] for image in data["images"]}
    for annotation in data["annotations"]:
        of_image[annotation["image_id"]].append(annotation)
    names = {item.category: name for name, item in truth.items()}
    for image in data["images"]:
        labels = {
            names[annotation["category_id"]]: instance_from_coco(annotation, names[annotation["category_id"]])
            for annotation in of_image[image["id"]]
            if names[annotation["category_id"]] in pipeline.networks
            and annotation["visib_fract"] >= least_visible
        }
        if not labels:
            continue
        pixels = read_image(str(coco_json.parent / image["file_name"]))
        squares = {name: _square(label) for name, label in labels.items()} if crops == "given" else None
        seen = {each.object: each for each in pipeline.see(pixels, squares)}
        for name, label in labels.items():
            for method in methods:
                yield _judged(
                    pipeline, seen.get(name), label, image, method, truth[name], truth_from_trained[name]
                )


def aligned(true: KeypointModel, trained: KeypointModel, *, source: str) -> np.ndarray:
    """``truth_from_trained``: the one rigid transform between the object frames of two label sources."""
    if true.keypoints != trained.keypoints:
        raise DataError(
            f"{source}: {true.name} has the keypoints {', '.join(true.keypoints)}, the checkpoint "
            f"{', '.join(trained.keypoints)}; evaluate on the dataset it was trained on"
        )
    both = true.known & trained.known
    return fit_rigid(true.points_object[both], trained.points_object[both])


def _judged(
    pipeline: PosePipeline,
    seen: SeenKeypoints | None,
    label: InstanceLabel,
    image: Mapping[str, Any],
    method: Method,
    truth: TrueObject,
    truth_from_trained: np.ndarray,
) -> Judged:
    known = label.visibility > 0
    if seen is None:
        missed = np.full(int(known.sum()), np.inf)
        return Judged(label.object, image["file_name"], method, "not detected", INFINITE, missed, None, None)
    off = np.linalg.norm(seen.positions_px - label.keypoints_px, axis=1)[known] / label.square_box.side_px
    result = pipeline.pose(seen, intrinsics_from_coco(image), method=method)
    if isinstance(result, PoseFailure):
        return Judged(label.object, image["file_name"], method, result.reason, INFINITE, off, None, seen)
    pose = result.camera_from_object @ np.linalg.inv(truth_from_trained)
    errors = pose_errors(pose, label.camera_from_object, truth.surface, centre_object=truth.centre)
    return Judged(label.object, image["file_name"], method, "ok", errors, off, pose, seen)


def _square(label: InstanceLabel) -> np.ndarray:
    box = label.square_box
    return np.array([box.cx_px, box.cy_px, box.side_px])
