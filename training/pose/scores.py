"""Scores of judged poses, and judged poses as a JSON file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import read_json, write_json
from rpl_data.pose.errors import INFINITE, PoseErrors

from ..keypoints.module import PCK_SHARE
from .pipeline import SeenKeypoints


@dataclass(frozen=True)
class Judged:
    """One object in one image: what was predicted, and how far off it is.

    Attributes:
        found: `ok`, `not detected`, or why there is no pose.
        errors: infinite where there is no pose.
        keypoint_errors: distance of each labelled keypoint, divided by the side of the true square box;
            infinite where the object was not detected.
        pose: ``camera_from_object`` in the truth's object frame; None without one.
        seen: what the hourglass said; None where the object was not detected.
    """

    object: str
    image: str
    method: str
    found: str
    errors: PoseErrors
    keypoint_errors: np.ndarray
    pose: np.ndarray | None
    seen: SeenKeypoints | None


@dataclass(frozen=True)
class PoseScore:
    """Scores of one object under one PnP method and protocol; a failure counts as an infinite error.

    Attributes:
        instances: how many were judged.
        failures: how many of them have no pose.
        position_mm, orientation_deg, add_mm, adds_mm: median errors.
        recall_add: share of instances whose ADD is below a tenth of the object's diameter.
        recall_adds: the same for ADD-S.
        recall_5cm_5deg: share of instances within 5 cm and 5 degrees.
        pck: share of keypoints within `PCK_SHARE` of the box.
    """

    instances: int
    failures: int
    position_mm: float
    orientation_deg: float
    add_mm: float
    adds_mm: float
    recall_add: float
    recall_adds: float
    recall_5cm_5deg: float
    pck: float


def score(judged: Sequence[Judged], surface: np.ndarray) -> PoseScore:
    """Score the instances of one object; `surface` holds points of its true surface, n x 3, metres."""
    errors = errors_table(judged)
    diameter_m = diameter(surface)
    position_m, orientation_rad, add_m, adds_m = errors.T
    medians = np.median(errors, axis=0) if len(errors) else np.full(4, np.nan)
    near = (position_m < 0.05) & (orientation_rad < np.deg2rad(5))
    keypoints = np.concatenate([each.keypoint_errors for each in judged]) if judged else np.zeros(0)
    return PoseScore(
        instances=len(judged),
        failures=sum(each.found != "ok" for each in judged),
        position_mm=float(1e3 * medians[0]),
        orientation_deg=float(np.degrees(medians[1])),
        add_mm=float(1e3 * medians[2]),
        adds_mm=float(1e3 * medians[3]),
        recall_add=_share(add_m < 0.1 * diameter_m),
        recall_adds=_share(adds_m < 0.1 * diameter_m),
        recall_5cm_5deg=_share(near),
        pck=_share(keypoints < PCK_SHARE),
    )


def errors_table(judged: Sequence[Judged]) -> np.ndarray:
    """Errors as a table, n x 4: position (m), orientation (rad), ADD (m) and ADD-S (m) per instance."""
    rows = [[e.position_m, e.orientation_rad, e.add_m, e.adds_m] for e in (each.errors for each in judged)]
    return np.array(rows, dtype=float).reshape(-1, 4)


def diameter(surface: np.ndarray) -> float:
    """The largest distance between two points of a surface, in metres."""
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import pdist

    return float(pdist(surface[ConvexHull(surface).vertices]).max())


def _share(holds: np.ndarray) -> float:
    return float(holds.mean()) if len(holds) else float("nan")


def save_judged(path: Path, judged: Sequence[Judged]) -> None:
    """Write instances as JSON; null stands for infinite or missing."""
    write_json(path, finite([asdict(each) for each in judged]), indent=None)


def _seen_from(row: Mapping[str, Any]) -> SeenKeypoints:
    """Keypoints from their JSON values."""
    arrays = {name: np.array(value) for name, value in row.items() if isinstance(value, list)}
    return SeenKeypoints(object=str(row["object"]), score=float(row["score"]), **arrays)


def load_judged(path: Path) -> list[Judged]:
    """Read the instances that `save_judged` wrote."""
    judged = []
    for row in read_json(path):
        # Earlier versions wrote half a turn for the orientation of what has no pose.
        given = {name: _or_infinite(value) for name, value in row["errors"].items()}
        errors = INFINITE if row["pose"] is None else PoseErrors(**given)
        seen = None if row["seen"] is None else _seen_from(row["seen"])
        off = np.array([_or_infinite(value) for value in row["keypoint_errors"]], dtype=float)
        pose = None if row["pose"] is None else np.array(row["pose"])
        judged.append(
            Judged(row["object"], row["image"], row["method"], row["found"], errors, off, pose, seen)
        )
    return judged


def finite(value: Any) -> Any:
    """Make values ready for JSON: arrays become lists, infinite and missing numbers null."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _or_infinite(value: float | None) -> float:
    return np.inf if value is None else value
