"""The error curves as figures, as a table of slopes, and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.report.html import Cell, number, section, table

from ..results import picture, png_of, write_results
from .curve import Curve
from .slopes import Slope, before_the_fit, slope_of

COLORS = ("#0f7c74", "#c26a00", "#5b4bb5", "#b3364b", "#3b6ea5", "#6b7a1f")
SAYS = {
    "keypoints": "fairly independent of N_k",
    "scenes": "improves with N_s",
}
NOTE_OF_FIT = (
    "A model is fitted to the truth before it is measured, which hides more of the error the fewer keypoints "
    "there are: sqrt(1 - 2 / N_k) is left. Without that: the dashed "
    "lines, by which the statement is judged."
)


@dataclass(frozen=True)
class Judged:
    """A curve with the slopes by which the paper's statement about it is judged.

    Attributes:
        measured: slope of the curve as it is.
        fair: slope of the curve that is judged; against N_k it is corrected for what the rigid fit hides.
    """

    curve: Curve
    measured: Slope
    fair: Slope

    @property
    def holds(self) -> bool:
        """Whether the paper's statement about such curves is true of this one."""
        return self.fair.flat if self.curve.against == "keypoints" else self.fair.falls


def judge(curve: Curve) -> Judged:
    """The curve with its slopes."""
    x = np.array(curve.x, dtype=float)
    return Judged(curve, slope_of(x, np.array(curve.error_mm)), slope_of(x, fair_errors(curve)))


def fair_errors(curve: Curve) -> Float64[np.ndarray, "seeds n"]:
    """Errors that can be compared along the curve, millimetres."""
    errors = np.array(curve.error_mm)
    return before_the_fit(np.array(curve.x, float), errors) if curve.against == "keypoints" else errors


def write_curves(
    out: Path, curves: Sequence[Curve], *, seeds: int, click_noise_px: float
) -> tuple[Path, str]:
    """Write curves.json, curves.html and one PNG per figure; the page's path and the slopes as text."""
    judged = [judge(curve) for curve in curves]
    figures = {
        f"curves_{against}": draw([c for c in curves if c.against == against], against) for against in SAYS
    }
    parts = []
    for against, says in SAYS.items():
        caption = f"Mean 3D error against N_{against[0]}; bands: one standard deviation among seeds"
        chosen = [one for one in judged if one.curve.against == against]
        body = picture(figures[f"curves_{against}"], caption) + _table(chosen)
        note = f'The paper: the error is "{says}". {seeds} seeds, clicks {click_noise_px:g} px off an axis.'
        if against == "keypoints":
            note = f"{note} {NOTE_OF_FIT}"
        parts.append(section(against, f"Number of {against}", body, note=note))
    data = {"seeds": seeds, "click_noise_px": click_noise_px, "curves": [_as_json(one) for one in judged]}
    page = write_results(out, "curves", title="Error curves", data=data, sections=parts, figures=figures)
    return page, "\n".join(as_line(one) for one in judged)


def _as_json(one: Judged) -> dict[str, Any]:
    slopes = {"slope": asdict(one.measured), "slope_judged": asdict(one.fair)}
    return asdict(one.curve) | {"failed": one.curve.failed, "holds": one.holds} | slopes


def as_line(one: Judged) -> str:
    """Describe one curve in a line for the terminal."""
    curve = one.curve
    means = np.nanmean(np.array(curve.error_mm), axis=0)
    line = (
        f"{curve.object:14s} N_{curve.against[0]} {curve.x[0]}..{curve.x[-1]}: "
        f"{means[0]:.2f} -> {means[-1]:.2f} mm, change {_interval(one.measured)}"
    )
    if curve.against == "keypoints":
        line += f", without what the fit hides {_interval(one.fair)}"
    line += f", spread {one.measured.spread:.2f}; '{SAYS[curve.against]}' "
    line += "holds" if one.holds else "does not hold"
    return line + (f"; {curve.failed} without an answer" if curve.failed else "")


def _interval(slope: Slope) -> str:
    return f"{slope.change:+.2f} mm [{slope.low:+.2f}, {slope.high:+.2f}]"


def draw(curves: Sequence[Curve], against: str) -> bytes:
    """Means over the seeds with bands of one standard deviation, as PNG."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(6.4, 4.0))
    axes = figure.subplots()
    for curve, color in zip(curves, COLORS, strict=False):
        values = np.array(curve.error_mm)
        mean, spread = np.nanmean(values, axis=0), np.nanstd(values, axis=0)
        axes.plot(curve.x, mean, "o-", color=color, label=curve.object.replace("_", " "), markersize=4)
        if curve.against == "keypoints":
            fair = np.nanmean(fair_errors(curve), axis=0)
            axes.plot(curve.x, fair, "--", color=color, alpha=0.7, linewidth=1)
        axes.fill_between(curve.x, mean - spread, mean + spread, color=color, alpha=0.15, linewidth=0)
    other = "s" if against == "keypoints" else "k"
    fixed = ", ".join(str(count) for count in sorted({curve.other for curve in curves}))
    axes.set_xlabel(f"number of {against} $N_{against[0]}$  ($N_{other}$ = {fixed})")
    axes.set_ylabel("mean 3D error of keypoints (mm)")
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    return png_of(figure)


def _table(chosen: Sequence[Judged]) -> str:
    """The table of slopes; against N_k it has one more column, the change that is judged."""
    of_keypoints = chosen[0].curve.against == "keypoints"
    changes = ("change, 95 % interval", *(("without what the fit hides",) if of_keypoints else ()))
    header = ("object", "first mm", "last mm", *changes, "spread mm", "failed", "the paper's statement")
    body: list[list[str | Cell]] = []
    for one in chosen:
        means = np.nanmean(np.array(one.curve.error_mm), axis=0)
        verdict = Cell("holds", kind="good") if one.holds else Cell("does not hold", kind="over")
        intervals = [_interval(slope) for slope in (one.measured, one.fair)[: len(changes)]]
        ends, spread = (number(means[0]), number(means[-1])), number(one.measured.spread)
        body.append([one.curve.object, *ends, *intervals, spread, str(one.curve.failed), verdict])
    return table(header, body)
