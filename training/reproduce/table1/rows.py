"""Table I: what a row of it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from training.reproduce.table1.worst import WorstScene

Trajectories = Literal["given", "drifting", "tracked"]


@dataclass(frozen=True)
class Scores:
    """Errors under one protocol; NaN where nothing could be measured.

    Attributes:
        iou: of the full masks, as the paper's, whose masks know nothing of what hides the object.
        iou_visible: of the visible masks; the paper's protocol has none.
    """

    error_3d_mm: float
    error_2d_px: float
    iou: float
    iou_visible: float


@dataclass(frozen=True)
class Row:
    """An object of a workspace.

    Attributes:
        keypoints, scenes: N_k and N_s.
        labels: frames in which it is labelled.
        strict: against true correspondences and true poses, nothing aligned; None without truth.
        by_cad: the paper's protocol, GT-CAD aligned by ICP; None without a CAD.
        started_by_solution: scenes with too few clicks to start ICP by, started by our own solution.
        left_out: scenes that the paper's protocol could not judge, and why.
        cad_rms_mm: how well GT-CAD lies on the scenes' surfaces; NaN without a CAD.
        worst: the scene with the largest 2D error; None without truth.
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
