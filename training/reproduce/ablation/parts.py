"""The parts of the chain that a recipe can switch, each with what stands in its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from rpl_data.pipeline.presets import by_method
from rpl_data.pipeline.recipe import LabelRecipe, Recipe, RefineRecipe, SegmentRecipe, Solve

PARTS: Mapping[str, Callable[[Recipe], Recipe]] = {
    "all": lambda recipe: recipe,
    "no_refine": lambda recipe: replace(recipe, refine=RefineRecipe(scenes=False, frames=False)),
    "papers_solve": lambda recipe: replace(recipe, solve=Solve("slsqp")),
    "papers_segmentation": lambda recipe: replace(recipe, segment=SegmentRecipe("smooth")),
    "papers_masks": lambda recipe: replace(recipe, label=LabelRecipe(recipe.label.rate, "splat")),
    "poses_as_given": lambda recipe: replace(recipe, reconstruct=replace(recipe.reconstruct, method="given")),
    "papers_chain": lambda recipe: by_method(recipe, "paper"),
}
"""The whole chain; then one part taken away or replaced by the paper's; at last all of them."""
