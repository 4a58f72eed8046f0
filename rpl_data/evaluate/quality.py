"""Compare labels and models with the ground truth, in mm, px and IoU.

In the strict protocol, a keypoint is compared with that of the same name in the truth, and a label with the
truth of the same frame; nothing is aligned in the image. Only the 3D model, which has its own frame, is first
moved onto the truth by one rigid transform. Another protocol means another truth: the paper's (GT-SPARSE as
the closest points of a CAD aligned by ICP) passes its own model and labels to the same functions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from rpl_data.evaluate.matching import in_order_of_model, matched_instances, rows_in_truth
from rpl_data.geometry import Transform, fit_rigid, invert, rotation_angle_rad, transform
from rpl_data.types import DataError, FrameLabel, InstanceLabel, KeypointModel, QualityRow, Rle
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace


@dataclass(frozen=True)
class ModelError:
    """Errors of a sparse model.

    Attributes:
        keypoints_m: distance of every keypoint from the truth, after the fit; NaN where unknown.
        truth_from_object: the rigid fit, from the model's object frame to the truth's.
    """

    keypoints_m: Float64[np.ndarray, " k"]
    truth_from_object: Transform


@dataclass(frozen=True)
class InstanceError:
    """Errors of one instance of an object in one frame.

    Attributes:
        keypoints_px: distance of every labelled keypoint (v > 0) from the truth; NaN for the others.
        position_m, rotation_rad: error of the pose at the object's origin; NaN without alignment.
    """

    scene: str
    frame: int
    keypoints_px: Float64[np.ndarray, " k"]
    iou_full: float
    iou_visible: float
    position_m: float
    rotation_rad: float

    @property
    def mean_px(self) -> float:
        """Mean over the labelled keypoints; NaN when there are none."""
        return _mean(self.keypoints_px)


@dataclass(frozen=True)
class LabelErrors:
    """Errors in all frames of one object; `types.QualityRow` explains the counts."""

    instances: tuple[InstanceError, ...]
    truth_frames: int
    missed: int
    invented: int


def model_error(model: KeypointModel, truth: KeypointModel) -> ModelError:
    """Measure 3D keypoint errors after a rigid fit (no scale, no reflection) over the keypoints both know.

    Raises:
        DataError: the models differ in their keypoints, or share fewer than three.
    """
    if len(model.keypoints) != len(truth.keypoints):
        raise DataError(
            f"object {model.name} has {counted(len(model.keypoints), 'keypoint')} and its truth "
            f"{len(truth.keypoints)}: correct the recipe"
        )
    rows = rows_in_truth(model, truth)
    true_points = truth.points_object[rows]
    both = model.known & truth.known[rows]
    truth_from_object = fit_rigid(true_points[both], model.points_object[both])
    offsets = transform(truth_from_object, model.points_object) - true_points
    return ModelError(np.linalg.norm(offsets, axis=1), truth_from_object)


def label_errors(
    labels: Iterable[FrameLabel],
    truth: Iterable[FrameLabel],
    truth_from_object: Mapping[str, Transform] | None = None,
) -> dict[str, LabelErrors]:
    """Measure the errors of labels, per object; frames without truth are ignored.

    Args:
        labels: any number of scenes, in any order.
        truth: true labels, in which keypoints_px are the true projections, visible or not.
        truth_from_object: alignment of each object's model (`ModelError`), for the pose errors.
    """
    alignments = truth_from_object or {}
    true_frames = {(label.scene, label.frame): _by_object(label) for label in truth}
    pairs: dict[str, list[InstanceError]] = {}
    missed: dict[str, int] = {}
    invented: dict[str, int] = {}
    for label in labels:
        true_instances = true_frames.get((label.scene, label.frame))
        if true_instances is None:
            continue
        instances = _by_object(label)
        for name in instances.keys() | true_instances.keys():
            same = matched_instances(instances.get(name, []), true_instances.get(name, []))
            pairs.setdefault(name, []).extend(
                _instance_error(label, one, true, alignments.get(name)) for one, true in same
            )
            missed[name] = missed.get(name, 0) + len(true_instances.get(name, [])) - len(same)
            invented[name] = invented.get(name, 0) + len(instances.get(name, [])) - len(same)
    totals: dict[str, int] = {}
    for true_instances in true_frames.values():
        for name, several in true_instances.items():
            totals[name] = totals.get(name, 0) + len(several)
    names = sorted(totals.keys() | pairs.keys())
    return {
        name: LabelErrors(
            tuple(pairs.get(name, ())), totals.get(name, 0), missed.get(name, 0), invented.get(name, 0)
        )
        for name in names
    }


def _by_object(label: FrameLabel) -> dict[str, list[InstanceLabel]]:
    found: dict[str, list[InstanceLabel]] = {}
    for instance in label.instances:
        found.setdefault(instance.object, []).append(instance)
    return found


def _instance_error(
    label: FrameLabel, instance: InstanceLabel, truth: InstanceLabel, truth_from_object: Transform | None
) -> InstanceError:
    distances = np.linalg.norm(instance.keypoints_px - truth.keypoints_px, axis=1)
    distances[instance.visibility == 0] = np.nan
    position_m, rotation_rad = np.nan, np.nan
    if truth_from_object is not None:
        position_m, rotation_rad = pose_error(
            instance.camera_from_object, truth.camera_from_object @ truth_from_object
        )
    return InstanceError(
        scene=label.scene,
        frame=label.frame,
        keypoints_px=distances,
        iou_full=mask_iou(instance.mask_full, truth.mask_full),
        iou_visible=mask_iou(instance.mask, truth.mask),
        position_m=position_m,
        rotation_rad=rotation_rad,
    )


def pose_error(camera_from_object: Transform, true_camera_from_object: Transform) -> tuple[float, float]:
    """Distance of the origins (m) and angle between the rotations (rad)."""
    difference = invert(true_camera_from_object) @ camera_from_object
    return float(np.linalg.norm(difference[:3, 3])), rotation_angle_rad(difference[:3, :3])


def mask_iou(a: Rle, b: Rle) -> float:
    """Intersection over union of two masks of the same image; 0 when both are empty."""
    from pycocotools import mask as coco_mask

    return float(coco_mask.iou([a], [b], [0])[0, 0])


# The table ----------------------------------------------------------------------------------------


def summarise(
    object_name: str, model: KeypointModel, error: ModelError, labels: LabelErrors | None
) -> QualityRow:
    """Summarise one object in a row; `labels` is None for an object without truth in any frame."""
    labels = labels or LabelErrors((), 0, 0, 0)
    pixels = np.array([instance.mean_px for instance in labels.instances])
    pixels = pixels[np.isfinite(pixels)]
    full = np.array([instance.iou_full for instance in labels.instances])
    visible = np.array([instance.iou_visible for instance in labels.instances])
    errors_mm = 1e3 * error.keypoints_m[np.isfinite(error.keypoints_m)]
    return QualityRow(
        object=object_name,
        keypoints=len(model.keypoints),
        keypoints_known=int(model.known.sum()),
        error_3d_mean_mm=_mean(errors_mm),
        error_3d_max_mm=float(errors_mm.max()) if len(errors_mm) else np.nan,
        error_2d_mean_px=_mean(pixels),
        error_2d_median_px=float(np.median(pixels)) if len(pixels) else np.nan,
        error_2d_p95_px=float(np.percentile(pixels, 95)) if len(pixels) else np.nan,
        iou_full_mean=_mean(full),
        iou_full_worst=float(full.min()) if len(full) else np.nan,
        iou_visible_mean=_mean(visible),
        iou_visible_worst=float(visible.min()) if len(visible) else np.nan,
        position_mm=1e3 * _mean(np.array([instance.position_m for instance in labels.instances])),
        rotation_deg=float(
            np.rad2deg(_mean(np.array([instance.rotation_rad for instance in labels.instances])))
        ),
        frames=len(labels.instances),
        truth_frames=labels.truth_frames,
        missed=labels.missed,
        invented=labels.invented,
    )


def _mean(values: np.ndarray) -> float:
    """Mean of the finite values; NaN when there are none (numpy would warn)."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def compare_workspaces(workspace: Workspace, truth: Workspace) -> list[QualityRow]:
    """Compare each object that both workspaces have; one row per object.

    Raises:
        DataError: they have no object in common, or the models of one cannot be compared.
    """
    shared = [name for name in workspace.object_names() if truth.solution_file(name).exists()]
    if not shared:
        raise DataError(
            f"{truth.root} has no truth for {', '.join(workspace.object_names()) or 'any object'}; "
            f"it has {', '.join(truth.object_names()) or 'no objects'}; objects must have the same names"
        )
    models = {name: workspace.load_placed(name).model for name in shared}
    true_models = {name: truth.load_solution(name).model for name in shared}
    errors = {name: model_error(models[name], true_models[name]) for name in shared}
    rows = {name: rows_in_truth(models[name], true_models[name]) for name in shared}
    alignments = {name: error.truth_from_object for name, error in errors.items()}
    by_scene = [
        label_errors(
            workspace.load_labels(scene) if workspace.labels_file(scene).exists() else (),
            in_order_of_model(truth.load_labels(scene), rows),
            alignments,
        )
        for scene in truth.labelled_scene_names()
    ]
    return [
        summarise(
            name, models[name], errors[name], merged([scene[name] for scene in by_scene if name in scene])
        )
        for name in shared
    ]


def merged(parts: Sequence[LabelErrors]) -> LabelErrors:
    """Merge the errors of several scenes as if they were one."""
    return LabelErrors(
        instances=tuple(instance for part in parts for instance in part.instances),
        truth_frames=sum(part.truth_frames for part in parts),
        missed=sum(part.missed for part in parts),
        invented=sum(part.invented for part in parts),
    )


COLUMNS: dict[str, tuple[str, int]] = {
    "error_3d_mean_mm": ("3D mm", 2),
    "error_3d_max_mm": ("max", 2),
    "error_2d_mean_px": ("2D px", 2),
    "error_2d_median_px": ("median", 2),
    "error_2d_p95_px": ("p95", 2),
    "iou_full_mean": ("IoU full", 3),
    "iou_full_worst": ("worst", 3),
    "iou_visible_mean": ("IoU vis", 3),
    "iou_visible_worst": ("worst", 3),
    "position_mm": ("pose mm", 2),
    "rotation_deg": ("deg", 2),
}
"""Title and decimals of the measured fields, in the order of the printed table."""


def format_table(rows: Sequence[QualityRow]) -> str:
    """Format the rows as plain text, one line per object; "-" where nothing could be measured."""
    header = [
        "object",
        "keypoints",
        *(title for title, _ in COLUMNS.values()),
        "frames",
        "missed",
        "invented",
    ]
    lines = [header]
    for row in rows:
        values = [getattr(row, name) for name in COLUMNS]
        digits = [digits for _, digits in COLUMNS.values()]
        measured = ["-" if np.isnan(x) else f"{x:.{d}f}" for x, d in zip(values, digits, strict=True)]
        counts = [f"{row.frames}/{row.truth_frames}", str(row.missed), str(row.invented)]
        lines.append([row.object, f"{row.keypoints_known}/{row.keypoints}", *measured, *counts])
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            [line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))]
        )
        for line in lines
    )
