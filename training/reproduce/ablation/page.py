"""The ablation as text and page: one line per part, and how much worse (or better) the labels are without."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from rpl_data.report.html import number, section, table
from rpl_data.types import QualityRow

from ..results import write_results

HEADER = ("part", "3D mm", "2D px", "p95 px", "IoU", "3D mm", "2D px", "p95 px", "IoU")
DIGITS = (2, 2, 2, 3)
NOTE = (
    "Means over the objects, strict protocol: true correspondences and poses, nothing aligned in the image. "
    "The last four columns are the difference from the whole chain: errors that rise and an IoU that falls "
    "say what the part is worth."
)


def write_page(out: Path, found: Mapping[str, Sequence[QualityRow]]) -> Path:
    """Write ablation.json and ablation.html; the path of the page comes back."""
    data = {
        "means": {part: dict(zip(HEADER[1:5], means_of(rows), strict=True)) for part, rows in found.items()},
        "rows": {part: [asdict(row) for row in rows] for part, rows in found.items()},
    }
    body = [[part, *cells] for part, cells in _lines(found).items()]
    parts = section("parts", "Without each part", table(HEADER, body), note=NOTE)
    return write_results(out, "ablation", title="What each part is worth", data=data, sections=[parts])


def as_text(found: Mapping[str, Sequence[QualityRow]]) -> str:
    """One line per part: its figures, then their differences from the whole chain."""
    rows = [list(HEADER), *([part, *cells] for part, cells in _lines(found).items())]
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADER))]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    )


def means_of(rows: Sequence[QualityRow]) -> tuple[float, ...]:
    """3D error in mm, 2D error and its 95th percentile in pixels, and IoU, means over the objects."""
    columns = [
        (row.error_3d_mean_mm, row.error_2d_mean_px, row.error_2d_p95_px, row.iou_full_mean) for row in rows
    ]
    return tuple(float(value) for value in np.nanmean(columns, axis=0))


def _lines(found: Mapping[str, Sequence[QualityRow]]) -> dict[str, list[str]]:
    whole = means_of(found["all"])
    lines = {}
    for part, rows in found.items():
        means = means_of(rows)
        shown = [number(value, digits) for value, digits in zip(means, DIGITS, strict=True)]
        changes = [f"{value - other:+.{d}f}" for value, other, d in zip(means, whole, DIGITS, strict=True)]
        lines[part] = [*shown, *(changes if part != "all" else ["" for _ in changes])]
    return lines
