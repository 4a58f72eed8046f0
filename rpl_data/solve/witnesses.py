"""How far two witnesses of the same poses contradict each other: the clicks, and the scenes' surfaces.

Registered on their surfaces, the scenes fit their clicks worse than the clicks' own solution does. Were both
as good as they are said to be, the rise of the clicks' cost would be a chi-squared number with six degrees of
freedom per scene after the first. A larger one says that one of the two is farther off than is stated: clicks
that are wrong alike, depth that errs alike all over a face or lies beside its colour, a camera path that
turns. The residuals of the clicks alone do not show that, for the solution follows what all of them share.
Which of the two is wrong is not known either, so all that is stated is widened by the root of rise over
freedoms (Birge, Physical Review 40, 1932; the scale factor of the Particle Data Group's averages).
"""

from __future__ import annotations

import math

from rpl_data.solve.noise import PRIOR_RESIDUALS

FREEDOMS_PER_SCENE = 6
"""Of a scene's pose relative to the others."""


def scale_factor(rise: float, scenes: int) -> float:
    """By how much to widen stated errors; never less than 1.

    With few scenes the rise is uncertain, so that both are as good as stated counts as some freedoms more.

    Args:
        rise: of the clicks' cost, in squared standard deviations.
        scenes: how many are registered on one another.
    """
    freedoms = FREEDOMS_PER_SCENE * (scenes - 1)
    if freedoms <= 0:
        return 1.0
    return math.sqrt(max(1.0, (PRIOR_RESIDUALS + rise) / (PRIOR_RESIDUALS + freedoms)))
