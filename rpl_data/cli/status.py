"""`rpl status`: what a workspace holds, and what the next build would run."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from rpl_data.cli.building import HERE
from rpl_data.clicks.log import Annotation
from rpl_data.wording import counted


def status(workspace: Path = HERE) -> None:
    """Say what a workspace holds, which stages are up to date, and what the next build would run.

    It changes nothing.

    Example: rpl status --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
    """
    from rpl_data.pipeline.build import STAGES, recipe_of, stale_steps
    from rpl_data.pipeline.placements import placement_lines
    from rpl_data.pipeline.synthesis.training import outdated_line
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    found = stale_steps(recipe_of(place), place)
    print(place)
    for name in place.object_names():
        print(_object_line(name, place.load_annotation(name)))
    for stage in STAGES:
        steps = found.get(stage)
        if steps is None:
            print(f"{stage:8s}  waits for the stages before it")
        elif not steps:
            print(f"{stage:8s}  not asked for")
        else:
            stale = [item or stage for item, holds in steps if not holds]
            print(f"{stage:8s}  {'to run: ' + ', '.join(stale) if stale else 'up to date'}")
    for line in placement_lines(place):
        print(line)
    outdated = outdated_line(place)
    if outdated is not None:
        print(outdated)


def _object_line(name: str, marked: Annotation) -> str:
    """Keypoints of an object, and its clicks by scene."""
    by_scene = Counter(click.scene for click in marked.clicks)
    clicks = ", ".join(f"{count} in {scene}" for scene, count in sorted(by_scene.items()))
    return f"    {name}: {counted(len(marked.keypoints), 'keypoint')}, clicks: {clicks or 'none'}"
