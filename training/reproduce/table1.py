"""Table I: how accurate the sparse models and the labels are, beside the paper's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rpl_data.types import DataError
from training.reproduce.paper import TABLE_1, TABLE_1_MEAN

if TYPE_CHECKING:
    from rpl_data.report.html import Cell
    from rpl_data.types import QualityRow
    from rpl_data.workspace import Workspace


@dataclass(frozen=True)
class Scores:
    """Errors under one protocol; NaN where nothing could be measured."""

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
    """

    workspace: str
    object: str
    keypoints: int
    scenes: int
    labels: int
    strict: Scores | None


def table1(sources: Path | list[Path], out: Path = Path("runs/table1"), root: Path | None = None) -> None:
    """Accuracy of sparse models and labels (the paper's Table I), an object a row.

    A source is a workspace that is built, or a recipe, which is built first. Truth comes from the twin or
    from the recipe's `truth:`.

    Args:
        sources: a workspace, a recipe, or a list of them: '[a, b]'.
        out: folder for table1.json, table1.html and the workspaces of recipes.
        root: where the relative paths of recipes start; the recipe's own folder when left out.
    """
    from rpl_data.build import build
    from rpl_data.recipe import load_recipe
    from rpl_data.workspace import Workspace

    rows: list[Row] = []
    for source in sources if isinstance(sources, list) else [sources]:
        workspace = Workspace(source)
        if source.is_file():
            workspace = Workspace(out / "workspaces" / source.stem)
            build(load_recipe(source, root=root), workspace)
        rows += measure(workspace)
    path = write_table(out, rows)
    print(f"{path}: {len(rows)} objects")


def measure(workspace: Workspace) -> list[Row]:
    """A row an object of a built workspace."""
    from rpl_data.build import context_of
    from rpl_data.pipeline.products import truth_workspace
    from rpl_data.quality import compare_workspaces

    context = context_of(workspace)
    truth = truth_workspace(context)
    if truth is None:
        raise DataError(f"the truth of {workspace.root} is not known; name it with `truth:` in the recipe")
    strict = {row.object: row for row in compare_workspaces(workspace, truth)}
    labels = labels_of(workspace)
    rows = []
    for name in context.object_names:
        solution = workspace.load_solution(name)
        scores = strict_scores(strict[name]) if name in strict else None
        size = len(solution.model.keypoints), len(solution.scene_from_object)
        rows.append(Row(workspace.root.name, name, *size, labels.get(name, 0), scores))
    return rows


def labels_of(workspace: Workspace) -> dict[str, int]:
    """Labelled frames of every object."""
    counts: dict[str, int] = {}
    for scene in workspace.labelled_scene_names():
        for label in workspace.load_labels(scene):
            for instance in label.instances:
                counts[instance.object] = counts.get(instance.object, 0) + 1
    return counts


def strict_scores(row: QualityRow) -> Scores:
    """The figures of the strict protocol that Table I has."""
    return Scores(row.error_3d_mean_mm, row.error_2d_mean_px, row.iou_full_mean, row.iou_visible_mean)


def write_table(out: Path, rows: Sequence[Row]) -> Path:
    """table1.json and table1.html."""
    from rpl_data.report.html import section, table
    from training.reproduce.results import write_results

    header = ("object", "N_k", "N_s", "3D mm", "2D px", "IoU", "IoU visible", "labels")
    ours = table(header, [_cells(row) for row in rows])
    paper: list[list[str | Cell]] = []
    for r in TABLE_1:
        errors = (f"{r.error_3d_mm:.2f}", f"{r.error_2d_px:.2f}", f"{r.iou:.3f}")
        paper.append([r.object, str(r.keypoints), str(r.scenes), *errors, "", str(r.labels)])
    means = [f"{TABLE_1_MEAN[name]:.{digits}f}" for name, digits in (("error_3d_mm", 2), ("error_2d_px", 2))]
    paper.append(["mean", "", "", *means, f"{TABLE_1_MEAN['iou']:.3f}", "", ""])
    parts = [
        section("ours", "Measured, strict protocol", ours, note="Nothing is aligned in the image."),
        section("paper", "The paper's Table I", table(header, paper)),
    ]
    data = {"rows": [asdict(row) for row in rows], "paper": [asdict(row) for row in TABLE_1]}
    return write_results(out, "table1", title="Table I", data=data, sections=parts)


def _cells(row: Row) -> list[str | Cell]:
    from rpl_data.report.html import number

    scores = row.strict or Scores(np.nan, np.nan, np.nan, np.nan)
    figures = [number(scores.error_3d_mm), number(scores.error_2d_px)]
    figures += [number(scores.iou, 3), number(scores.iou_visible, 3)]
    return [row.object, str(row.keypoints), str(row.scenes), *figures, str(row.labels)]
