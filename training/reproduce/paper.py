"""The numbers the paper prints, to stand beside ours."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperRow:
    """One row of Table I: the accuracy of the sparse model and of the labels."""

    object: str
    keypoints: int
    scenes: int
    error_3d_mm: float
    error_2d_px: float
    iou: float
    labels: int


TABLE_1 = (
    PaperRow("Dewalt Cut-out Tool", 8, 11, 1.00, 4.23, 0.8109, 3043),
    PaperRow("Facom Electronic Wrench", 6, 10, 2.69, 6.66, 0.7154, 2188),
    PaperRow("Hitachi Screw Gun", 9, 9, 5.29, 6.08, 0.7573, 2172),
    PaperRow("Cup Noodle", 10, 6, 0.5, 3.97, 0.8895, 860),
    PaperRow("Lipton", 11, 6, 2.1, 8.02, 0.8319, 1029),
    PaperRow("Mt. Rainier Coffee", 11, 8, 1.6, 7.40, 0.8249, 1036),
    PaperRow("Oolong Tea", 11, 5, 1.1, 3.65, 0.836, 850),
    PaperRow("Mustard Bottle", 7, 5, 1.17, 7.15, 0.8329, 947),
    PaperRow("Potted Meat Can", 10, 8, 1.02, 8.83, 0.8349, 1391),
    PaperRow("Bleach Cleanser", 8, 9, 3.37, 9.73, 0.815, 1525),
    PaperRow("Power Drill", 12, 9, 1.52, 6.43, 0.7825, 1346),
)
TABLE_1_MEAN = {"error_3d_mm": 1.94, "error_2d_px": 6.56, "iou": 0.812}
"""As printed."""

TABLE_2 = (
    # object, position mm OURS and MANUAL, orientation deg OURS and MANUAL
    ("Dewalt Cut-out Tool", 9.93, 9.23, 0.78, 0.69),
    ("Facom Electronic Wrench", 3.66, 4.75, 1.35, 1.23),
    ("Hitachi Screw Gun", 6.77, 7.52, 4.46, 4.80),
)
"""Median errors in object pose estimation."""
