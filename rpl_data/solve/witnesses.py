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
from dataclasses import dataclass

from scipy.stats import chi2

from rpl_data.solve.noise import PRIOR_RESIDUALS

FREEDOMS_PER_SCENE = 6
"""Of a scene's pose relative to the others."""
BY_CHANCE = 0.02
"""Sound clicks and surfaces rise higher than what is called a contradiction at most so often."""


@dataclass(frozen=True)
class Contradiction:
    """By how much the clicks fit worse where the surfaces put the scenes.

    Attributes:
        rise: of the clicks' cost, in squared standard deviations.
        scenes: how many are registered on one another.
    """

    rise: float
    scenes: int

    @property
    def factor(self) -> float:
        """By how much to widen stated errors; never less than 1.

        With few scenes the rise is uncertain, so that both are as good as stated counts as some freedoms
        more.
        """
        if self._freedoms <= 0:
            return 1.0
        return math.sqrt(max(1.0, (PRIOR_RESIDUALS + self.rise) / (PRIOR_RESIDUALS + self._freedoms)))

    @property
    def beyond_chance(self) -> bool:
        """Whether it is more than sound clicks and surfaces show by chance, and so worth saying."""
        return self._freedoms > 0 and self.rise > float(chi2.ppf(1 - BY_CHANCE, df=self._freedoms))

    @property
    def _freedoms(self) -> int:
        return FREEDOMS_PER_SCENE * (self.scenes - 1)
