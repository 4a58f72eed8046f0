"""The clicks of a workspace, lifted to space: what the solve and the registration of scenes start from."""

from __future__ import annotations

from collections.abc import Collection

from rpl_data.clicks.lift import lift_clicks
from rpl_data.types import Click, DataError, Observation, Scene, Trajectory
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace


def observe(
    workspace: Workspace, object_name: str, *, scene: str | None = None, without: Collection[str] = ()
) -> list[Observation]:
    """The clicks of an object (in one scene, or all), lifted; those in frames without a pose are left out.

    Args:
        workspace: where they are.
        object_name: of the object.
        scene: only the clicks in this scene.
        without: recordings whose clicks are left out.

    Raises:
        DataError: there are none, or a click cannot be lifted.
    """
    clicks = workspace.load_annotation(object_name).clicks
    if scene is not None:
        clicks = tuple(click for click in clicks if click.scene == scene)
    parts = workspace.parts()
    clicks = tuple(click for click in clicks if parts.video_of(click.scene) not in without)
    where = f" in scene {scene}" if scene else ""
    if not clicks:
        raise DataError(
            f"object {object_name} has no clicks{where}; mark them with `rpl annotate {workspace.root}`, "
            "name a CSV file with `clicks:` in the recipe, or run "
            f"`rpl clicks import FILE.csv --workspace {workspace.root}`"
        )
    scenes = {name: workspace.load_scene(name) for name in workspace.scene_names()}
    clicked = {c.scene for c in clicks if scene_of(c.scene) in scenes}
    scenes |= {place: scenes[scene_of(place)] for place in clicked}
    trajectories = {place: workspace.load_trajectory(scenes[place]) for place in clicked}
    posed = [
        c for c in clicks if not (c.scene in scenes and _lost(c, scenes[c.scene], trajectories[c.scene]))
    ]
    if not posed:
        raise DataError(
            f"object {object_name}: all {len(clicks)} clicks{where} are in frames whose pose is not known; "
            "click in others"
        )
    return lift_clicks(posed, scenes, trajectories, workspace.depth_reader)


def _lost(click: Click, scene: Scene, trajectory: Trajectory) -> bool:
    """The clicked frame lies within the recording, but has no pose or was left out for having none."""
    within = scene.frames and scene.frames[0].index <= click.frame <= scene.frames[-1].index
    return bool(within) and click.frame not in trajectory.frames
