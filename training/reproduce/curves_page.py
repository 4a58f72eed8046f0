"""The error curves as figures, as a table of slopes, and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from rpl_data.report.html import Cell, number, section, table
from training.reproduce.curves import Curve
from training.reproduce.results import picture, png_of, write_results
from training.reproduce.slopes import Slope, slope_of

COLORS = ("#0f7c74", "#c26a00", "#5b4bb5", "#b3364b", "#3b6ea5", "#6b7a1f")
SAYS = {
    "keypoints": "fairly independent of N_k",
    "scenes": "improves with N_s",
}


def write_curves(
    out: Path, curves: Sequence[Curve], *, seeds: int, click_noise_px: float
) -> tuple[Path, str]:
    """curves.json, curves.html and a PNG a figure; the page's path, and the slopes as text."""
    slopes = [slope_of(np.array(c.x, dtype=float), np.array(c.error_mm)) for c in curves]
    figures = {
        f"curves_{against}": draw([c for c in curves if c.against == against], against) for against in SAYS
    }
    parts = []
    for against, says in SAYS.items():
        chosen = [(c, s) for c, s in zip(curves, slopes, strict=True) if c.against == against]
        caption = f"Mean 3D error against N_{against[0]}; bands: one standard deviation among seeds"
        body = picture(figures[f"curves_{against}"], caption) + _table(chosen)
        note = f'The paper: the error is "{says}". {seeds} seeds, clicks {click_noise_px:g} px off an axis.'
        parts.append(section(against, f"Number of {against}", body, note=note))
    data = {
        "seeds": seeds,
        "click_noise_px": click_noise_px,
        "curves": [
            asdict(c) | {"failed": c.failed, "slope": asdict(s), "holds": holds(c, s)}
            for c, s in zip(curves, slopes, strict=True)
        ],
    }
    page = write_results(out, "curves", title="Error curves", data=data, sections=parts, figures=figures)
    return page, "\n".join(as_line(c, s) for c, s in zip(curves, slopes, strict=True))


def holds(curve: Curve, slope: Slope) -> bool:
    """What the paper says of such a curve is true of this one."""
    return slope.flat if curve.against == "keypoints" else slope.falls


def as_line(curve: Curve, slope: Slope) -> str:
    """One curve for the terminal."""
    means = np.nanmean(np.array(curve.error_mm), axis=0)
    verdict = "holds" if holds(curve, slope) else "does not hold"
    run = f"{curve.object:14s} N_{curve.against[0]} {curve.x[0]}..{curve.x[-1]}"
    return (
        f"{run}: {means[0]:.2f} -> {means[-1]:.2f} mm, "
        f"change {slope.change:+.2f} mm [{slope.low:+.2f}, {slope.high:+.2f}], spread {slope.spread:.2f}; "
        f"'{SAYS[curve.against]}' {verdict}" + (f"; {curve.failed} without an answer" if curve.failed else "")
    )


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


def _table(chosen: Sequence[tuple[Curve, Slope]]) -> str:
    header = (
        "object",
        "first mm",
        "last mm",
        "change mm",
        "95 % interval",
        "spread mm",
        "failed",
        "the paper's",
    )
    body: list[list[str | Cell]] = []
    for curve, slope in chosen:
        means = np.nanmean(np.array(curve.error_mm), axis=0)
        interval = f"{slope.low:+.2f} .. {slope.high:+.2f}"
        verdict = Cell("holds", kind="good") if holds(curve, slope) else Cell("does not hold", kind="over")
        figures = [
            number(means[0]),
            number(means[-1]),
            f"{slope.change:+.2f}",
            interval,
            number(slope.spread),
        ]
        body.append([curve.object, *figures, str(curve.failed), verdict])
    return table(header, body)
