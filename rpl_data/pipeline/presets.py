"""Methods: one name at the top of a recipe (`method: paper`) for a choice in every stage.

`paper` is the chain of the paper, as a baseline: given trajectories as they are, the depth of the clicked
pixel, Eq. 2 by SLSQP, nothing refined, region growing as in PCL, masks of projected points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rpl_data.pipeline.recipe import Recipe
from rpl_data.types import DataError

NEVER_MM = 1e6
"""No trajectory drifts a kilometre, so no recording is cut."""
METHODS: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "ours": {},
    "paper": {
        "reconstruct": {"method": "given", "max_drift_mm": NEVER_MM},
        "solve": {"method": "slsqp"},
        "refine": {"scenes": False, "frames": False},
        "segment": {"method": "smooth"},
        "label": {"method": "splat"},
        "export": {"min_quality": 0.0},
    },
}
"""What each method sets in the options of the stages."""


def fill_in(data: Mapping[str, Any], *, source: str) -> dict[str, Any]:
    """Replace the key `method` of a parsed recipe by the options it stands for; those written there stay.

    Raises:
        DataError: there is no such method.
    """
    method = data.get("method", "ours")
    if not isinstance(method, str) or method not in METHODS:
        names = " or ".join(f"`{name}`" for name in METHODS)
        raise DataError(f"{source}: method must be {names}, not {method!r}")
    filled = {key: value for key, value in data.items() if key != "method"}
    for stage, options in METHODS[method].items():
        own = filled.get(stage, {})
        if isinstance(own, Mapping):  # else it is refused where types are checked
            filled[stage] = {**options, **own}
    return filled


def by_method(recipe: Recipe, method: str) -> Recipe:
    """The recipe with the options of a method, whatever it had there."""
    stages = {stage: replace(getattr(recipe, stage), **options) for stage, options in METHODS[method].items()}
    return replace(recipe, **stages)
