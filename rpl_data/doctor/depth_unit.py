"""Judge the unit of depth by the numbers themselves: their bit pattern, and what is plausible on a table.

Poses judge it better (`corrections`); this is for a recording without any, or whose camera stands still.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from rpl_data.doctor.corrections import usual_factor
from rpl_data.doctor.findings import Finding, option
from rpl_data.formats.recordings.plausibility import has_turned_bits, share_of_multiples, usual_units_m
from rpl_data.recordings.mend import Mend
from rpl_data.types import Scene

USUAL_MEDIAN_M = 0.7
"""Usual distance of what one films on a table."""

NOTHING_NEARER_M = 1.1
"""If hardly anything is nearer than this, nobody filmed a table within his reach."""

HALF_NEARER_M = 0.28
"""If half of everything is nearer than this, no usual camera could have measured it."""

TURNED_FACTOR = 1 / 8
TURNED_SURE, UNIT_SURE = 0.95, 0.6

Depths = Float32[np.ndarray, "n height width"]


def by_the_numbers(scene: Scene, depths_m: Depths) -> list[Finding]:
    """Find turned bits or a wrong unit without poses; nothing where the distances suit a table.

    Args:
        scene: the scene.
        depths_m: some of its depth images in metres, 0 = none.
    """
    measured_m = depths_m[depths_m > 0]
    if not len(measured_m):
        return []
    near_m, median_m = np.percentile(measured_m[:: max(1, len(measured_m) // 100_000)], (5, 50))
    if is_turned(scene, depths_m) and _misfit(median_m * TURNED_FACTOR) < _misfit(median_m):
        return [turned_bits(scene, depths_m, TURNED_SURE)]
    if near_m <= NOTHING_NEARER_M and median_m >= HALF_NEARER_M:
        return []
    factor = _likely_factor(scene, depths_m, float(median_m))
    what = (
        f"half of all depths are beyond {median_m:.2f} m and 5 % nearer than {near_m:.2f} m, which is "
        f"{'far' if near_m > NOTHING_NEARER_M else 'near'} for a table, and there is nothing else to judge "
        "the unit by"
    )
    if factor is None:
        return [Finding("depth scale", what, UNIT_SURE, "check metres_per_unit, unless you filmed a room")]
    mend = Mend(depth_factor=factor)
    unit_m = scene.metres_per_unit * factor
    todo = (
        f"unless that is right, {option(mend)}: one unit is then {unit_m:g} m and the median "
        f"{median_m * factor:.2f} m"
    )
    return [Finding("depth scale", what, UNIT_SURE, todo, mend)]


def is_turned(scene: Scene, depths_m: Depths) -> bool:
    """Whether the stored numbers look as bits turned by 3 make them."""
    return has_turned_bits(_stored(scene, depths_m))


def turned_bits(scene: Scene, depths_m: Depths, sure: float) -> Finding:
    """The finding for a scene that `is_turned`."""
    share = share_of_multiples(_stored(scene, depths_m), 8)
    mend = Mend(depth_bits_turned=True)
    what = f"{share:.0%} of the depths are multiples of 8: their bits are turned by 3, as SUN3D stores them"
    return Finding("turned bits", what, sure, option(mend), mend)


def with_turned_bits(scene: Scene, depths_m: Depths, found: list[Finding]) -> list[Finding]:
    """Replace a scale of 1/8 that the poses show by turned bits, where the numbers show those."""
    if not is_turned(scene, depths_m):
        return found
    return [
        turned_bits(scene, depths_m, finding.sure)
        if finding.mend is not None
        and finding.kind == "depth scale"
        and abs(np.log(finding.mend.depth_factor / TURNED_FACTOR)) < np.log(1.2)
        else finding
        for finding in found
    ]


def _stored(scene: Scene, depths_m: Depths) -> np.ndarray:
    """Some of the stored numbers, as they are in the files."""
    some = depths_m.reshape(-1)[:: max(1, depths_m.size // 200_000)]
    return np.rint(some / np.float32(scene.metres_per_unit)).astype(np.int64)


def _likely_factor(scene: Scene, depths_m: Depths, median_m: float) -> float | None:
    """Factor to the usual unit that suits a table best, of those that the numbers' pattern leaves."""
    units = usual_units_m(_stored(scene, depths_m))
    factors = [unit / scene.metres_per_unit for unit in units]
    best = min(factors, key=lambda factor: _misfit(median_m * factor))
    return usual_factor(best) if _misfit(median_m * best) < 0.5 * _misfit(median_m) else None


def _misfit(median_m: float) -> float:
    return float(abs(np.log(median_m / USUAL_MEDIAN_M)))
