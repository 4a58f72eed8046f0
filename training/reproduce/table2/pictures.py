"""Pictures of Table II: learning curves, sample predictions, worst cases."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from rpl_data.formats.datasets.coco import (
    instance_from_coco,
    intrinsics_from_coco,
    objects_from_coco,
    read_coco,
)
from rpl_data.torch.image_files import read_image
from rpl_data.workspace.workspace import Workspace

from ...pose.pictures import close_up, drawn
from ...pose.scores import Judged
from ..results import png_of
from .pose_comparison import Cell, Found, run_folder


def curves(out: Path, objects: Sequence[str]) -> bytes | None:
    """Validation error by epoch of every hourglass of the first seed."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    plots = figure.subplots(1, 2)
    validated = False
    for source, style in (("OURS", "-"), ("MANUAL", "--")):
        for number, name in enumerate(objects):
            logs = sorted(run_folder(out, source, 0, name).glob("logs*/metrics.csv"))
            rows = [row for log in logs for row in csv.DictReader(log.read_text().splitlines())]
            rows = [row for row in rows if row.get("val_pck")]
            epochs = [int(row["epoch"]) + 1 for row in rows]
            for plot, key in zip(plots, ("val_pck", "val_error"), strict=True):
                plot.plot(
                    epochs,
                    [float(row[key]) for row in rows],
                    style,
                    color=f"C{number}",
                    label=f"{name} {source}",
                )
            validated = validated or bool(rows)
    plots[0].set(xlabel="epoch", ylabel="PCK within a tenth of the box", ylim=(0, 1.02))
    plots[1].set(xlabel="epoch", ylabel="mean keypoint error by box side", yscale="log")
    plots[1].legend(fontsize=6)
    return png_of(figure) if validated else None


Row = list[tuple[Cell, Judged]]
"""Of the mosaic."""


def samples(found: Sequence[Found], key: tuple[str, str]) -> list[Row]:
    """Five instances per object and source, from one of the best by ADD to one of the worst.

    Args:
        found: all cells.
        key: split and crops of those that are shown.
    """
    return _rows(found, key, (0.1, 0.3, 0.5, 0.7, 0.9))


def worst(found: Sequence[Found]) -> list[Row]:
    """The five instances with the largest ADD that have a pose, per object and source; strict protocol."""
    return _rows(found, ("test", "detected"), (0.96, 0.97, 0.98, 0.99, 1.0))


def _rows(found: Sequence[Found], key: tuple[str, str], shares: Sequence[float]) -> list[Row]:
    """Instances judged with our PnP, of all seeds; empty where none has a pose."""
    return [
        row
        for cell, judged in found
        if (cell.split, cell.crops) == key and cell.method == "consensus"
        if (row := _near(cell, [each for rows in judged for each in rows], shares))
    ]


def _near(cell: Cell, judged: list[Judged], shares: Sequence[float]) -> Row:
    ranked = sorted((j for j in judged if j.pose is not None), key=lambda j: j.errors.add_m)
    return [(cell, ranked[round(share * (len(ranked) - 1))]) for share in shares] if ranked else []


def mosaic(workspace: Path, rows: Sequence[Row]) -> bytes:
    """Draw close-ups with what was predicted; one row per object and source."""
    root = Workspace(workspace).export("coco_truth")
    data = {split: read_coco(root / f"{split}.json") for split in {row[0][0].split for row in rows}}
    strips = []
    for row in rows:
        strips.append(np.hstack([_tile(root, data[cell.split], cell, judged) for cell, judged in row]))
    _, png = cv2.imencode(".png", cv2.cvtColor(np.vstack(strips), cv2.COLOR_RGB2BGR))
    return bytes(png)


def _tile(root: Path, data: Mapping[str, Any], cell: Cell, judged: Judged) -> Any:
    """Draw one prediction, close up, with its errors written on it."""
    models = [item.model for item in objects_from_coco(data)]
    category = [model.name for model in models].index(judged.object) + 1
    image = next(entry for entry in data["images"] if entry["file_name"] == judged.image)
    label = next(
        instance_from_coco(entry, judged.object)
        for entry in data["annotations"]
        if (entry["image_id"], entry["category_id"]) == (image["id"], category)
    )
    picture = drawn(
        read_image(str(root / judged.image)),
        judged.seen,
        judged.pose,
        intrinsics_from_coco(image),
        models[category - 1],
        true_px=label.keypoints_px,
    )
    box = label.square_box
    tile = close_up(picture, np.array([box.cx_px, box.cy_px, 1.2 * box.side_px]))
    errors = f"{1e3 * judged.errors.position_m:.0f} mm {np.degrees(judged.errors.orientation_rad):.1f} deg"
    tile[:36] //= 4  # a dark bar to write on
    for line, words in enumerate((f"{cell.source} {judged.object}", errors)):
        at = (4, 14 + 16 * line)
        cv2.putText(tile, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
    return tile
