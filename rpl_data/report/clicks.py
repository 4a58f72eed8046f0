"""How well the solution explains every click: bars by scene, what needs a look, and the whole list."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from rpl_data.report.html import Cell, folded, number, table, text
from rpl_data.types import ClickResidual, KeypointModel, Solution

HEADER = ("keypoint", "scene", "depth", "what was found", "frame", "px", "mm")


def click_section(solution: Solution) -> str:
    """Bars, the table of clicks that need a look, and all clicks folded."""
    residuals = solution.residuals
    if not residuals:
        return '<p class="note">No click residuals were kept.</p>'
    model = solution.model
    outliers = [residual for residual in residuals if residual.outlier]
    worst_first = sorted(outliers, key=lambda residual: -residual.error_px)
    odd = table(HEADER, [_row(model, r) for r in worst_first], left=4, kinds=["bad"] * len(outliers))
    everything = table(
        HEADER,
        [_row(model, r) for r in residuals],
        left=4,
        kinds=["bad" if r.outlier else "" for r in residuals],
    )
    return (
        f'<h3>Clicks</h3><p class="note">{text(_in_words(residuals))}</p>{_bars(model, residuals)}'
        + (f"<h3>Clicks that contradict the others</h3>{odd}" if outliers else "")
        + folded(f"all {len(residuals)} clicks", everything)
    )


def _in_words(residuals: Sequence[ClickResidual]) -> str:
    pixels = np.array([r.error_px for r in residuals if not r.outlier])
    states = Counter[str](r.depth_state for r in residuals)
    depths = ", ".join(f"{states[state]} {words}" for state, words in DEPTH_WORDS.items() if states[state])
    middle = f"median {number(float(np.median(pixels)), 1)} px; " if len(pixels) else ""
    outliers = sum(r.outlier for r in residuals)
    return (
        f"Distance of every click from the projected keypoint: {len(residuals)} clicks, {middle}"
        f"{outliers} outlier{'' if outliers == 1 else 's'} (red, full height). Depth: {depths}; "
        "pale bars used no depth."
    )


DEPTH_WORDS = {
    "agrees": "agree at the click",
    "other surface": "taken from another surface nearby",
    "rejected": "rejected",
    "none": "without any depth",
}


def _bars(model: KeypointModel, residuals: Sequence[ClickResidual]) -> str:
    """A bar a click, a group a scene; outliers would flatten the rest, so they are cut at full height."""
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
