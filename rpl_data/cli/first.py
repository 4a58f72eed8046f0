"""A recording without a recipe: `rpl init` writes one, and `rpl import` makes do without a file."""

from __future__ import annotations

import sys
from pathlib import Path

from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.types import DataError


def init(
    recipe: Path,
    from_: Path,
    object: str | None = None,
    keypoints: str | None = None,
    format: str | None = None,
    camera: tuple[float, ...] | None = None,
    topics: Topics | None = None,
) -> None:
    """Look at a recording and write its recipe: format and `mend:` filled in from what `rpl check` finds.

    Only faults of which it is sure are put right; what is less sure stands in the recipe as a comment. An
    object that is clicked in the recording's clicks.csv comes into the recipe with its keypoints; otherwise
    its name and keypoints are asked for, or taken from the options. Every frame is labelled where three per
    second would be fewer than 50; else three per second, until `rate:` in the recipe says otherwise.

    Example: rpl init my.yaml --from my-recording --object mug --keypoints handle,rim,foot,logo

    Args:
        recipe: the YAML file to write; one that is there is never replaced.
        from_: the recording: a folder of scenes, one scene, or a file.
        object: what the object is called.
        keypoints: how many keypoints it has, or their names with commas.
        format: how the recording is stored; guessed when left out.
        camera: fx, fy, cx, cy in pixels, as '[600, 600, 320, 240]', then lens distortion; what the recording
            says when left out.
        topics: topics of a ROS bag to use, as '{"color": "/cam1/color/image_raw"}'; found when left out.
    """
    from rpl_data.cli.new_recipe import assumed, next_commands, text_for
    from rpl_data.files import write_text
    from rpl_data.pipeline.first_recipe import HowStored
    from rpl_data.pipeline.recipe_file import recipe_from_text

    if recipe.suffix not in (".yaml", ".yml"):
        raise DataError(f"{recipe}: a recipe is called .yaml; rpl init {recipe.with_suffix('.yaml')}")
    if recipe.exists():
        raise DataError(f"{recipe} is there already and is not replaced; choose another name, or delete it")
    if not recipe.absolute().parent.is_dir():
        raise DataError(f"there is no folder {recipe.parent}; make it first")
    asks = sys.stdin.isatty() and sys.stdout.isatty()
    told = HowStored(format, camera, topics)
    text = text_for(from_, recipe, object=object, keypoints=keypoints, told=told, asks=asks)
    written = recipe_from_text(text, source=str(recipe))  # never one that `rpl build` refuses
    write_text(recipe, text)
    clicked = all(item.clicks for item in written.objects)
    print(f"wrote {recipe}")
    if not (clicked or asks) and (unsaid := assumed(object, keypoints)):
        print(f"it assumes {unsaid}; change {recipe} where that is wrong, before anything is clicked")
    print(next_commands(recipe, clicked=clicked))
