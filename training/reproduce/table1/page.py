"""Table I as text and page: ours by both protocols, one table per kind of trajectory, then the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from rpl_data.report.html import Cell, number, section, table, text

from ..paper import TABLE_1, TABLE_1_MEAN
from ..results import write_results
from .rows import Row, Scores

NOTHING = Scores(np.nan, np.nan, np.nan, np.nan)
STRICT = ("3D mm", "2D px", "IoU", "IoU visible")
PAPER = ("paper's chain: 3D mm", "2D px", "IoU")
CAREFUL = ("careful: 3D mm", "2D px", "IoU")
BY_CAD = ("CAD: 3D mm", "2D px", "IoU")
HEADER = ("object", "N_k", "N_s", *STRICT, *PAPER, *CAREFUL, *BY_CAD, "labels")
TITLES = {
    "given": "Trajectories as recorded",
    "drifting": "Drifting trajectories: 5 mm and 0.3 degrees at the end of a video",
    "tracked": "Our own tracking",
}
NOTE = (
    "The first four figures are strict: true correspondences and poses, nothing aligned in the image. So are "
    "those of the paper's own chain on the same recording and clicks, and of that chain with a careful hand: "
    "clicks moved to where the sensor measures their keypoint, dense models cropped to the true object. The "
    "three from CAD on follow the paper: GT-CAD aligned by ICP to the sparse model and to every scene, "
    "GT-SPARSE its closest points. IoU is of full masks; visible masks leave out what hides the object. "
    "Green is at or better than the paper's mean. *: scenes with too few clicks to start ICP by."
)


def write_page(out: Path, rows: Sequence[Row], *, seed: int) -> Path:
    """Write table1.json and table1.html; the path of the page comes back."""
    parts = []
    for kind in dict.fromkeys(row.trajectories for row in rows):
        chosen = [row for row in rows if row.trajectories == kind]
        body = [_cells(row) for row in chosen] + [_mean_cells(chosen)]
        kinds = ["" for _ in chosen] + ["quiet"]
        left_out = [f"{row.object}, scene {line}" for row in chosen for line in row.left_out]
        lists = _list("Not judged by CAD", left_out) + _list(
            "Where the 2D error is largest", worst_of(chosen)
        )
        parts.append(section(kind, TITLES[kind], table(HEADER, body, kinds=kinds) + lists, note=NOTE))
    parts.append(_paper())
    data = {
        "seed": seed,
        "rows": [asdict(row) for row in rows],
        "means": {kind: asdict(mean) for kind, mean in means(rows).items()},
        "paper": [asdict(row) for row in TABLE_1],
        "paper_mean": TABLE_1_MEAN,
    }
    title = "Table I: sparse models and labels"
    return write_results(out, "table1", title=title, data=data, sections=parts)


def worst_of(rows: Sequence[Row]) -> list[str]:
    """One line per object: its worst scene."""
    return [f"{row.object}, {row.worst}" for row in rows if row.worst is not None]


def _list(title: str, lines: Sequence[str]) -> str:
    items = "".join(f"<li>{text(line)}</li>" for line in lines)
    return f"<p>{title}:</p><ul>{items}</ul>" if lines else ""


def means(rows: Sequence[Row]) -> dict[str, Scores]:
    """Means over the objects: `<trajectories> strict`, `by_cad`, `paper` and `careful`."""
    found: dict[str, Scores] = {}
    for kind in dict.fromkeys(row.trajectories for row in rows):
        chosen = [row for row in rows if row.trajectories == kind]
        found[f"{kind} strict"] = _mean([row.strict for row in chosen])
        found[f"{kind} by_cad"] = _mean([row.by_cad for row in chosen])
        found[f"{kind} paper"] = _mean([row.paper for row in chosen])
        found[f"{kind} careful"] = _mean([row.careful for row in chosen])
    return found


def _mean(scores: Sequence[Scores | None]) -> Scores:
    columns = np.array([list(asdict(one).values()) for one in scores if one is not None]).reshape(-1, 4)
    values = [float(c[np.isfinite(c)].mean()) if np.isfinite(c).any() else np.nan for c in columns.T]
    return Scores(*values)


# The page -----------------------------------------------------------------------------------------


def _cells(row: Row) -> list[str | Cell]:
    name = row.object if row.started_by_solution == 0 else f"{row.object} *"
    return [
        name,
        str(row.keypoints),
        str(row.scenes),
        *_figures(*groups_of(row)),
        number(row.labels, 0),
    ]


def _mean_cells(rows: Sequence[Row]) -> list[str | Cell]:
    return ["mean", "", "", *_figures(*_mean_groups(rows)), number(sum(row.labels for row in rows), 0)]


def groups_of(row: Row) -> tuple[Scores, ...]:
    """The scores of a row in the order of the columns."""
    return tuple(scores or NOTHING for scores in (row.strict, row.paper, row.careful, row.by_cad))


def _mean_groups(rows: Sequence[Row]) -> list[Scores]:
    """Means over the objects, in the order of the columns."""
    return [_mean(column) for column in zip(*(groups_of(row) for row in rows), strict=True)]


def _figures(strict: Scores, *others: Scores) -> list[str | Cell]:
    cells: list[str | Cell] = []
    for scores in (strict, *others):
        cells.append(_judged(scores.error_3d_mm, "error_3d_mm"))
        cells.append(_judged(scores.error_2d_px, "error_2d_px"))
        cells.append(_judged(scores.iou, "iou"))
    return [*cells[:3], number(strict.iou_visible, 3), *cells[3:]]


def _judged(value: float, column: str) -> Cell:
    """A figure beside the paper's mean; an IoU is better when it is larger."""
    shown = number(value, 3 if column == "iou" else 2)
    if np.isnan(value):
        return Cell(shown, kind="n")
    better = value >= TABLE_1_MEAN[column] if column == "iou" else value <= TABLE_1_MEAN[column]
    return Cell(shown, kind="good" if better else "over")


def _paper() -> str:
    header = ("object", "N_k", "N_s", "3D mm", "2D px", "IoU", "labels")
    body: list[list[str | Cell]] = []
    for row in TABLE_1:
        errors = (number(row.error_3d_mm), number(row.error_2d_px), number(row.iou, 3))
        body.append([row.object, str(row.keypoints), str(row.scenes), *errors, number(row.labels, 0)])
    mean = [number(TABLE_1_MEAN["error_3d_mm"]), number(TABLE_1_MEAN["error_2d_px"])]
    total = number(sum(row.labels for row in TABLE_1), 0)
    body.append(["mean", "", "", *mean, number(TABLE_1_MEAN["iou"], 3), total])
    kinds = ["" for _ in TABLE_1] + ["quiet"]
    return section("paper", "The paper's Table I", table(header, body, kinds=kinds), note="As printed.")


# The terminal -------------------------------------------------------------------------------------


def as_text(rows: Sequence[Row]) -> str:
    """The rows and their means, one line each; strict figures, then those of the paper's protocol."""
    short = ["paper: mm", "px", "IoU", "careful: mm", "px", "IoU", "CAD: mm", "px", "IoU", "labels"]
    head = ["object", "N_k", "N_s", "3D mm", "2D px", "IoU", "vis", *short]
    lines = []
    for kind in dict.fromkeys(row.trajectories for row in rows):
        chosen = [row for row in rows if row.trajectories == kind]
        body = [[row.object, str(row.keypoints), str(row.scenes), *_plain(*groups_of(row))] for row in chosen]
        counts = [str(row.labels) for row in chosen]
        mean = _plain(*_mean_groups(chosen))
        table_rows = [head, *([*cells, n] for cells, n in zip(body, counts, strict=True))]
        table_rows.append(["mean", "", "", *mean, str(sum(row.labels for row in chosen))])
        worst = worst_of(chosen)
        lines += [TITLES[kind], *_aligned(table_rows), *(["worst:"] if worst else []), *worst, ""]
    return "\n".join(lines)


def _plain(strict: Scores, *others: Scores) -> list[str]:
    cells = []
    for scores in (strict, *others):
        cells += [_shown(scores.error_3d_mm, 2), _shown(scores.error_2d_px, 2), _shown(scores.iou, 3)]
    return [*cells[:3], _shown(strict.iou_visible, 3), *cells[3:]]


def _shown(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]
