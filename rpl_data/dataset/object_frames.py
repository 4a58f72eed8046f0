"""Whether two datasets mean the same by an object: its keypoints, and the frame that its poses are in.

The object frame comes from the clicks of a workspace (its origin is the centroid of the keypoints, its axes
are those of the first scene), so two workspaces of one object have two frames. One rigid transform takes the
keypoints of one to those of the other, up to the errors of both models; anything else is another object,
other keypoints of the same name, or a wrong model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from rpl_data.formats.datasets.coco import intrinsics_from_coco
from rpl_data.formats.datasets.coco_objects import symmetries_of_entry, symmetries_of_object
from rpl_data.geometry import Transform, fit_rigid, invert, is_collinear, project, transform
from rpl_data.json_arrays import Json, matrix_from_json, numbers, rows_from_json, rows_to_json
from rpl_data.symmetries import moved_symmetries
from rpl_data.types import DataError, Symmetries

MOST_SIGMAS = 3.0
"""Residual, in multiples of what the labels state of themselves, up to which two models are the same.

Between eight pairs of workspaces of the same scanned object, clicked independently, it was 1.0 to 1.5; one
pair of exchanged keypoints makes it 24 or more.
"""
UNSTATED_M = 0.002
"""Error of a keypoint of a model whose labels state none: what one click per keypoint and scene gives."""


@dataclass(frozen=True)
class SameObject:
    """How the object of one dataset becomes that of another.

    Attributes:
        order: for each keypoint of the other, its row here.
        ours_from_theirs: from the object frame of the one that is converted to that of the other.
        points_object: the keypoints of both, in the frame of the other; those it lacks are filled in.
        residual_m, most_m, expected_m: root mean square and largest distance of shared keypoints after the
            fit, and the root mean square that the labels of both state, per axis.
        shared: number of keypoints that both have.
        unchanged: the models are the same number by number, so nothing needs to be converted.
    """

    order: Sequence[int]
    ours_from_theirs: Transform
    points_object: Float64[np.ndarray, "k 3"]
    residual_m: float
    most_m: float
    expected_m: float
    shared: int
    unchanged: bool


def same_object(
    ours: tuple[Json, Json],
    theirs: tuple[Json, Json],
    sigmas_m: tuple[Mapping[str, float], Mapping[str, float]],
    *,
    most_residual_m: float | None = None,
    where: str,
) -> SameObject:
    """Fit the keypoints of an object in one dataset to those in another.

    Args:
        ours, theirs: the entries of the object in `categories` and `rpl.objects`.
        sigmas_m: what the labels of both state about each keypoint (`stated_sigmas_m`).
        most_residual_m: largest residual that passes; `MOST_SIGMAS` times what is stated, when left out.
        where: names both, for messages.

    Raises:
        DataError: other keypoints, too few that both know, or no rigid transform between them.
    """
    names: list[str] = ours[0]["keypoints"]
    theirs_named: list[str] = theirs[0]["keypoints"]
    if set(names) != set(theirs_named):
        only = sorted(set(names) ^ set(theirs_named))
        raise DataError(
            f"{where}: keypoints {', '.join(only)} are in one of them only; name them alike in both"
        )
    order = [theirs_named.index(name) for name in names]
    own, other = (rows_from_json(item[1]["points_object"], 3) for item in (ours, theirs))
    other = other[order]
    both = np.isfinite(own).all(axis=1) & np.isfinite(other).all(axis=1)
    if both.sum() < 3 or is_collinear(own[both]):
        raise DataError(
            f"{where}: {both.sum()} keypoints have points_object in both; at least 3 that are not on a line "
            "are needed to compare the object frames; click more keypoints, or rename the object in one"
        )
    identical = np.array_equal(own, other, equal_nan=True)
    ours_from_theirs = np.eye(4) if identical else fit_rigid(own[both], other[both])
    moved = transform(ours_from_theirs, other)
    apart = np.linalg.norm(moved[both] - own[both], axis=1)
    expected_m = _expected_m([name for name, known in zip(names, both, strict=True) if known], sigmas_m)
    found = SameObject(
        order,
        ours_from_theirs,
        np.where(np.isfinite(own), own, moved),
        float(np.sqrt((apart**2).mean())),
        float(apart.max()),
        expected_m,
        int(both.sum()),
        identical and order == sorted(order),
    )
    limit_m = MOST_SIGMAS * expected_m if most_residual_m is None else most_residual_m
    if found.residual_m > limit_m:
        worst = [name for name, known in zip(names, both, strict=True) if known][int(apart.argmax())]
        raise DataError(
            f"{where}: no rigid transform takes the keypoints of one to those of the other: they stay "
            f"{1000 * found.residual_m:.1f} mm apart (root mean square; keypoint {worst} "
            f"{1000 * found.most_m:.1f} mm), where up to {1000 * limit_m:.1f} mm would pass. Its poses "
            "cannot be brought into one frame: look for exchanged or wrong keypoints, or rename one of them"
        )
    return found


def _expected_m(names: Sequence[str], sigmas_m: tuple[Mapping[str, float], Mapping[str, float]]) -> float:
    """What both models together state, per axis, root mean square over the keypoints."""
    squares = [sum(side.get(name, UNSTATED_M) ** 2 for side in sigmas_m) for name in names]
    return float(np.sqrt(np.mean(squares)))


def stated_sigmas_m(keypoints: Sequence[str], labels: Iterable[tuple[Json, float]]) -> dict[str, float]:
    """Median over the labels of sigma_px at the distance of the object, in metres, per keypoint.

    Keypoints without any stated sigma are absent.

    Args:
        labels: annotations of the object, each with the focal length of its image in pixels.
    """
    found: dict[str, list[float]] = {name: [] for name in keypoints}
    for annotation, focal_px in labels:
        metres_per_px = annotation["camera_from_object"][11] / focal_px
        for name, sigma_px in zip(keypoints, annotation["sigma_px"], strict=True):
            if sigma_px is not None:
                found[name].append(sigma_px * metres_per_px)
    return {name: float(np.median(values)) for name, values in found.items() if values}


def moved_annotation(annotation: Json, same: SameObject, image: Json) -> Json:
    """An annotation with its pose in the other frame, its keypoints in the other order.

    Keypoints are projected anew, so that all annotations of the object are projections of one model; those
    that a person corrected, and crowds, stay where they are.
    """
    if same.unchanged or "camera_from_object" not in annotation:  # which a crowd drawn elsewhere lacks
        return annotation
    camera_from_ours = matrix_from_json(annotation["camera_from_object"]) @ invert(same.ours_from_theirs)
    moved = annotation | {"camera_from_object": numbers(camera_from_ours)}
    if "keypoints" in annotation and not annotation.get("iscrowd"):
        triples = np.array(annotation["keypoints"], dtype=float).reshape(-1, 3)[same.order]
        if annotation.get("corrected") is not True:
            projected = project(intrinsics_from_coco(image), transform(camera_from_ours, same.points_object))
            again = (triples[:, 2] > 0) & np.isfinite(projected).all(axis=1)
            triples[again, :2] = np.round(projected[again], 4)
        moved["keypoints"] = [x for u, v, seen in triples for x in (float(u), float(v), int(seen))]
        moved["sigma_px"] = [annotation["sigma_px"][row] for row in same.order]
    return moved


def joined_object(
    ours: tuple[Json, Json], theirs: tuple[Json, Json], same: SameObject
) -> tuple[tuple[Json, Json], list[str]]:
    """The entries of the object, with the keypoints and symmetries that it lacked; and what to say."""
    described = ours[1] | {"points_object": rows_to_json(same.points_object)}
    lines = []
    own, other = symmetries_of_object(ours[1]), symmetries_of_object(theirs[1])
    if other != Symmetries() and own == Symmetries():
        described |= symmetries_of_entry(moved_symmetries(other, same.ours_from_theirs))
        lines.append("only one of them says how it is symmetric; that holds for all")
    elif _counts(own) != _counts(other) and other != Symmetries():
        lines.append("they say otherwise how it is symmetric; what the first says holds")
    if ours[1]["mesh"] is None and theirs[1]["mesh"] is not None:
        lines.append("only the later one has a mesh, which is left out: name that source first")
    return (ours[0], described), lines


def _counts(symmetries: Symmetries) -> tuple[int, int]:
    return len(symmetries.discrete), len(symmetries.continuous)
