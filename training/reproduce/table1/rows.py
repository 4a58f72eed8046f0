"""The rows of Table I."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from rpl_data.types import QualityRow

    from .worst import WorstScene

Trajectories = Literal["given", "drifting", "tracked"]


@dataclass(frozen=True)
class Scores:
    """Errors under one protocol; NaN where nothing could be measured.

    Attributes:
        iou: IoU of the full masks, as in the paper, whose masks ignore occlusion.
        iou_visible: IoU of the visible masks; the paper's protocol has none.
    """

    error_3d_mm: float
    error_2d_px: float
    iou: float
    iou_visible: float


def scores_of(row: QualityRow) -> Scores:
    """Reduce errors to the figures of Table I."""
    return Scores(row.error_3d_mean_mm, row.error_2d_mean_px, row.iou_full_mean, row.iou_visible_mean)


@dataclass(frozen=True)
class Row:
    """The figures of one object of a workspace.

    Attributes:
        keypoints, scenes: N_k and N_s.
        labels: number of frames in which it is labelled.
        strict: errors against true correspondences and true poses, nothing aligned; None without truth.
        by_cad: errors by the paper's protocol, GT-CAD aligned by ICP; None without a CAD.
        started_by_solution: scenes with too few clicks to start ICP from; our own solution started it.
        left_out: scenes that the paper's protocol could not judge, and why.
        cad_rms_mm: how well GT-CAD lies on the scenes' surfaces; NaN without a CAD.
        worst: the scene with the largest 2D error; None without truth.
        paper: strict errors of the paper's own chain on the same recording and clicks; None if not asked for.
        careful: those when a careful hand clicks and crops; see `baseline.py`.
    """

    workspace: str
    trajectories: Trajectories
    object: str
    keypoints: int
    scenes: int
    labels: int
    strict: Scores | None
    by_cad: Scores | None
    started_by_solution: int
    left_out: tuple[str, ...]
    cad_rms_mm: float
    worst: WorstScene | None = None
    paper: Scores | None = None
    careful: Scores | None = None
