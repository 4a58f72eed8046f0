"""Does a curve fall, or is it flat? A straight line through the means, with an interval by bootstrap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True)
class Slope:
    """Change of a curve from its first to its last x.

    Attributes:
        change: rise of the fitted line from the first to the last x, in the unit of y.
        low, high: 95 % interval of `change`, by bootstrap over the seeds.
        relative: `change` as a share of the mean.
        spread: mean over x of the standard deviation among seeds.
    """

    change: float
    low: float
    high: float
    relative: float
    spread: float

    @property
    def falls(self) -> bool:
        """Whether the whole interval is below zero."""
        return self.high < 0

    @property
    def flat(self) -> bool:
        """Whether the interval contains zero."""
        return self.low <= 0 <= self.high


def slope_of(
    x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, "seeds n"], *, resamples: int = 2000
) -> Slope:
    """The slope of the seeds' mean curve; NaN (a seed that failed) is left out of the means."""
    rng = np.random.default_rng(0)
    span = float(x[-1] - x[0])
    draws = rng.integers(0, len(y), (resamples, len(y)))
    changes = _slopes(x, y[draws]) * span
    changes = changes[np.isfinite(changes)]
    change = float(_slopes(x, y[None])[0]) * span
    low, high = np.percentile(changes, [2.5, 97.5]) if len(changes) else (np.nan, np.nan)
    with_spread = [column[np.isfinite(column)].std() for column in y.T if np.isfinite(column).any()]
    relative = change / float(np.nanmean(y))
    spread = float(np.mean(with_spread)) if with_spread else np.nan
    return Slope(change, float(low), float(high), relative, spread)


def before_the_fit(
    keypoints: Float64[np.ndarray, " n"], error: Float64[np.ndarray, "seeds n"]
) -> Float64[np.ndarray, "seeds n"]:
    """Correct errors for what the rigid fit hides of them.

    A model is fitted to the truth by a rigid motion before it is compared. That takes 6 of the 3 k degrees
    of freedom of k keypoints, so equal errors appear as sqrt(1 - 2 / k) of their size: few keypoints look
    better than they are.
    """
    freed: Float64[np.ndarray, "seeds n"] = error / np.sqrt(1 - 2 / keypoints)
    return freed


def _slopes(
    x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, "draws seeds n"]
) -> Float64[np.ndarray, " draws"]:
    """Least squares per draw, through the means of the columns with a value; NaN for fewer than two."""
    finite = np.isfinite(y)
    counts = finite.sum(axis=1)
    known = counts > 0
    means = np.where(finite, y, 0).sum(axis=1) / np.maximum(counts, 1)
    columns = np.maximum(known.sum(axis=1), 1)
    dx = np.where(known, x - ((known * x).sum(axis=1) / columns)[:, None], 0)
    slopes: Float64[np.ndarray, " draws"] = np.full(len(y), np.nan)
    enough = known.sum(axis=1) >= 2
    slopes[enough] = (dx * means)[enough].sum(axis=1) / (dx**2)[enough].sum(axis=1)
    return slopes
