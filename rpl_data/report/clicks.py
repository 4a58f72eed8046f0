"""How well the solution explains each click: bars per scene, clicks to look at, all clicks, distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from rpl_data.report.html import Cell, folded, number, table, text
from rpl_data.types import ClickResidual, KeypointModel, Solution

HEADER = ("keypoint", "scene", "depth", "what was found", "frame", "px", "mm")


def click_section(solution: Solution) -> str:
    """Bars, a table of the clicks to look at, and all clicks in a part that unfolds."""
    residuals = solution.residuals
    if not residuals:
        return '<p class="note">No click residuals were kept.</p>'
    model = solution.model
    doubted = [residual for residual in residuals if residual.outlier or residual.reason]
    worst_first = sorted(doubted, key=lambda residual: (not residual.outlier, -residual.error_px))
    kinds = ["bad" if residual.outlier else "" for residual in worst_first]
    odd = table(HEADER, [_row(model, r) for r in worst_first], left=4, kinds=kinds)
    everything = table(
        HEADER,
        [_row(model, r) for r in residuals],
        left=4,
        kinds=["bad" if r.outlier else "" for r in residuals],
    )
    return (
        f'<h3>Clicks</h3><p class="note">{text(_in_words(residuals))}</p>{_bars(model, residuals)}'
        + (f"<h3>Clicks to look at</h3>{odd}" if doubted else "")
        + folded(f"all {len(residuals)} clicks", everything)
    )


def _in_words(residuals: Sequence[ClickResidual]) -> str:
    pixels = np.array([r.error_px for r in residuals if not r.outlier])
    states = Counter[str](r.depth_state for r in residuals)
    depths = ", ".join(f"{states[state]} {words}" for state, words in DEPTH_WORDS.items() if states[state])
    middle = f"median {number(float(np.median(pixels)), 1)} px; " if len(pixels) else ""
    wrong = sum(r.outlier for r in residuals)
    doubted = sum(bool(r.reason) and not r.outlier for r in residuals)
    said = f"{wrong} wrong (red, full height)" + (f", {doubted} in doubt" if doubted else "")
    return (
        f"Distance of each click from where the solution puts its keypoint: {len(residuals)} clicks, {middle}"
        f"{said}. Depth: {depths}; pale bars used no depth."
    )


DEPTH_WORDS = {
    "agrees": "agree at the click",
    "other surface": "taken from another surface nearby",
    "rejected": "rejected",
    "none": "without any depth",
}


def _bars(model: KeypointModel, residuals: Sequence[ClickResidual]) -> str:
    """One bar per click, grouped by scene; wrong clicks are cut, as they would flatten the rest."""
    ordinary = [r.error_px for r in residuals if not r.outlier]
    top_px = 1.1 * max(ordinary) if ordinary and max(ordinary) > 0 else 1.0
    groups = []
    for scene in dict.fromkeys(r.click.scene for r in residuals):
        bars = "".join(_bar(model, r, top_px) for r in residuals if r.click.scene == scene)
        groups.append(f'<div><div class="row">{bars}</div><p>{text(scene)}</p></div>')
    scale = f'<p class="note">Full height = {number(top_px, 1)} px; scenes side by side.</p>'
    return f'<div class="bars">{"".join(groups)}</div>{scale}'


def _bar(model: KeypointModel, residual: ClickResidual, top_px: float) -> str:
    height = 100.0 if residual.outlier else max(2.0, 100 * residual.error_px / top_px)
    kind = "out" if residual.outlier else "weak" if residual.depth_state in ("rejected", "none") else ""
    click = residual.click
    words = f"{model.keypoints[click.keypoint]}, frame {click.frame}: {residual.error_px:.1f} px"
    return (
        f'<i class="{kind}" style="height:{height:.0f}%" title="{text(words)}. {text(residual.reason)}"></i>'
    )


def _row(model: KeypointModel, residual: ClickResidual) -> list[str | Cell]:
    click = residual.click
    return [
        model.keypoints[click.keypoint],
        click.scene,
        residual.depth_state,
        residual.reason,
        str(click.frame),
        number(residual.error_px, 1),
        number(None if residual.error_m is None else 1e3 * residual.error_m, 1),
    ]


def distance_table(solution: Solution) -> str:
    """Distances between all keypoints that have a position: one that can be measured gives an error away."""
    model = solution.model
    known = np.flatnonzero(model.known)
    names = [model.keypoints[k] for k in known]
    gaps_m = np.linalg.norm(model.points_object[known][:, None] - model.points_object[known], axis=2)
    rows: list[list[str | Cell]] = [
        [name, *(number(1e3 * gap, 1) if b < a else "" for b, gap in enumerate(row))]
        for a, (name, row) in enumerate(zip(names, gaps_m, strict=True))
    ]
    return table(("", *names[:-1]), [row[:-1] for row in rows[1:]])
