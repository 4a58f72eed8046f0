"""Which slips of a click nothing would contradict.

A slip changes the residual of its click by only a share of itself: scene and keypoint follow it by the
rest. By how much a click must slip before its contradiction is strong enough to be said is its minimal
detectable bias (Baarda, A testing procedure for use in geodetic networks, 1968).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.solve.explanations import contradiction
from rpl_data.solve.refit import Fit, unknowns_covariance
from rpl_data.types import Click, Statement
from rpl_data.types.instances import frame_of, without_frame
from rpl_data.wording import counted

SLIP_PX = 15.0
"""A slip that should not go unnoticed."""
POWER_SIGMAS = 0.84
"""A contradiction so much stronger than the bar is said four times in five, as noise may weaken it."""


def unnoticed_slips_px(fit: Fit) -> Float64[np.ndarray, " m"]:
    """How far each click may slip in its worst direction before that is said four times in five.

    A slip b raises the fall of the cost without the click by b' R b / sigma^2, where R is the 2x2 redundancy
    of its position.
    """
    rows = fit.rows[:, :2]
    covariance = unknowns_covariance(fit)[fit.columns[:, :, None], fit.columns[:, None, :]]
    redundancy = np.eye(2) - rows @ covariance @ rows.swapaxes(1, 2)
    least = np.linalg.eigvalsh(redundancy)[:, 0]
    needed = np.sqrt(contradiction(len(rows))) + POWER_SIGMAS
    slips_px: Float64[np.ndarray, " m"] = fit.sigma_px * needed / np.sqrt(np.clip(least, 1e-4, 1))
    return slips_px


def unjudged(fit: Fit, clicks: Sequence[Click], keypoints: Sequence[str]) -> Iterator[Statement]:
    """One statement about the clicks that would not be contradicted if they were wrong; the weakest first."""
    slips_px = unnoticed_slips_px(fit)
    weak = [n for n in np.argsort(-slips_px, kind="stable").tolist() if slips_px[n] > SLIP_PX]
    if not weak:
        return
    worst = clicks[weak[0]]
    more = f"click keypoint {keypoints[worst.keypoint]} in scene {worst.scene} again, in another frame than "
    more += str(worst.frame)
    if frame_of(worst.scene) is not None:  # an object that is moved has another pose in another frame
        more = f"click more keypoints in frame {worst.frame} of scene {without_frame(worst.scene)}"
    text = (
        f"{counted(len(weak), 'click')} of {len(clicks)} cannot be judged: were one of them {SLIP_PX:.0f} px "
        f"off, no other click would show it; {more}, to check the weakest of them"
    )
    yield Statement("unjudged", tuple(clicks[n] for n in weak), text)
