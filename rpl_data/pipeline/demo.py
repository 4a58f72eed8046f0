"""The recipe of the demo; `datasets/demo.yaml` is the same as a file."""

from __future__ import annotations

from rpl_data.pipeline.recipe import LabelRecipe, Recipe
from rpl_data.twin.spec import TwinSpec

DEMO = Recipe(
    name="demo",
    twin=TwinSpec(
        objects=("carton", "kettle"), scenes=4, seconds=2.0, clicks_per_keypoint=3, click_noise_px=2.0
    ),
    label=LabelRecipe(rate="all"),
)
