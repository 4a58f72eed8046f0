"""Place objects by trained networks in scenes that nobody clicked, and find labels that disagree."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform
from rpl_data.images import read_color
from rpl_data.pipeline.automatic import find_step
from rpl_data.pipeline.build import alone_in, context_of, recipe_of, run_step
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.ledger import Outcome
from rpl_data.pipeline.progress import Progress, Tell
from rpl_data.pipeline.register import object_named
from rpl_data.pipeline.symmetry import frame_change, symmetry_turns
from rpl_data.pose.agreement import (
    FEWEST_TO_JUDGE,
    NO_TURN,
    agreements,
    keypoint_distance_m,
    labels_stray,
    nearest_pose,
)
from rpl_data.symmetries import moved_symmetries, symmetries_of, symmetry_transforms
from rpl_data.types import (
    ColorImage,
    DataError,
    DepthImage,
    Intrinsics,
    KeypointModel,
    NetworkView,
    UnsureError,
    posed_frames,
)
from rpl_data.types.instances import places_in
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace

TURN_STEP = 0.03
"""Between two turns about an axis of full rotation, as a part of the diameter: poses agree within five times
as much."""

Look = Callable[[ColorImage, Intrinsics, DepthImage | None], Mapping[str, Transform]]
"""From an image to `camera_from_object` of the objects in it, in the frames of the networks' models."""


@dataclass(frozen=True)
class Networks:
    """Trained networks that estimate poses in single images.

    Attributes:
        models: the keypoint models they were trained with, by object.
        names: the checkpoints, by object.
        look: from an image to poses.
    """

    models: Mapping[str, KeypointModel]
    names: Mapping[str, str]
    look: Look


def propose(
    workspace: Workspace,
    networks: Networks,
    *,
    scenes: Sequence[str] = (),
    frames: int = 24,
    tell: Tell = lambda progress: None,
) -> Iterator[str]:
    """Look at scenes with networks; place what has no labels there, compare the rest. Lines for the user.

    A scene is placed as `rpl register --auto` places it: the networks' poses are proposals beside those of
    shape, and colours and free space decide.

    Args:
        scenes: their names; all when empty.
        frames: how many images per scene are looked at, spread over it.

    Raises:
        DataError: no such scene, or a network for an object that is not in the recipe, not solved yet, or
            solved with other keypoints.
    """
    check_asked(workspace, networks, scenes)
    for scene in scenes or workspace.scene_names():
        with alone_in(workspace):  # a build may not change labels and frames meanwhile; placing locks itself
            seen = look_at_scene(workspace, networks, scene, frames=frames, tell=tell)
            for name, view in seen.items():
                workspace.save_network_views(name, {**workspace.load_network_views(name), scene: view})
        for name, view in seen.items():
            placed = workspace.load_placed(name).scene_from_object
            if scene in placed:
                yield compared_line(workspace, name, scene, view)
            elif places_in(scene, placed):
                yield (
                    f"{name} in scene {scene}: it is labelled there as several instances, or as one that is "
                    "moved, so a single pose is neither compared nor placed"
                )
            else:
                yield from _placed(workspace, name, scene, networks, view, tell)


def check_asked(workspace: Workspace, networks: Networks, scenes: Sequence[str]) -> None:
    """DataError where scenes or networks are not those of the workspace, before any image is looked at."""
    known = workspace.scene_names()
    unknown = [scene for scene in scenes if scene not in known]
    if unknown:
        raise DataError(
            f"there is no scene {', '.join(unknown)} in {workspace.root}; it has {', '.join(known)}"
        )
    context = context_of(workspace)
    for name, trained in networks.models.items():
        object_named(context, name)
        now = workspace.load_placed(name).model.keypoints
        if trained.keypoints != now:
            raise DataError(
                f"{networks.names[name]}: the network knows {name} by the keypoints "
                f"{', '.join(trained.keypoints)}, and the workspace by {', '.join(now)}; train again"
            )


def look_at_scene(
    workspace: Workspace, networks: Networks, scene: str, *, frames: int, tell: Tell = lambda progress: None
) -> dict[str, NetworkView]:
    """What the networks see in a scene, by object."""
    recorded = workspace.load_scene(scene)
    trajectory = workspace.load_trajectory(recorded)
    posed = posed_frames(recorded, trajectory)
    if not posed:
        raise DataError(f"scene {scene} has no frame with a pose; run `rpl track` on {workspace.root}")
    chosen = posed[:: -(-len(posed) // frames)]
    depths = workspace.depth_reader(recorded)
    poses: dict[str, list[Transform]] = {name: [] for name in networks.models}
    numbers: dict[str, list[int]] = {name: [] for name in networks.models}
    began_s = time.monotonic()
    for done, frame in enumerate(chosen):
        tell(Progress("propose", scene, "runs", done, len(chosen)))
        depth = depths(frame) if frame.depth is not None else None
        for name, pose in networks.look(read_color(frame), recorded.intrinsics, depth).items():
            poses[name].append(trajectory.at(frame.index) @ pose)
            numbers[name].append(frame.index)
    took_s = time.monotonic() - began_s
    tell(Progress("propose", scene, "ran", seconds=took_s, outcome=Outcome(frames=len(chosen))))
    context = context_of(workspace)
    found = {}
    for name, seen in poses.items():
        same = _same_poses(context, name, networks.models[name])
        view = _view(networks, name, len(chosen), np.array(numbers[name]), seen, same)
        found[name] = _turned_to_labels(workspace, name, scene, view, same)
    return found


def _same_poses(context: Context, name: str, model: KeypointModel) -> Float64[np.ndarray, "s 4 4"]:
    """The turns after which an object looks the same, in the frame of a network's model."""
    symmetries = symmetries_of(symmetry_turns(context, object_named(context, name)))
    if not symmetries.discrete and not symmetries.continuous:
        return NO_TURN
    then_from_now = frame_change(model, context.workspace.load_placed(name).model)
    return symmetry_transforms(moved_symmetries(symmetries, then_from_now), max_deviation=TURN_STEP)


def _turned_to_labels(
    workspace: Workspace, name: str, scene: str, view: NetworkView, same: Float64[np.ndarray, "s 4 4"]
) -> NetworkView:
    """The view with the pose, of those that look the same, which is nearest to the labels."""
    placed = workspace.load_placed(name)
    if view.scene_from_object is None or scene not in placed.scene_from_object:
        return view
    labelled, points = placed.scene_from_object[scene], placed.model.points_object
    nearest = nearest_pose(view.scene_from_object, view.points_object, same, to=labelled, points_to=points)
    return replace(view, scene_from_object=nearest)


def _view(
    networks: Networks,
    name: str,
    looked: int,
    numbers: np.ndarray,
    poses: Sequence[Transform],
    same: Float64[np.ndarray, "s 4 4"],
) -> NetworkView:
    points = networks.models[name].points_object
    known = points[np.isfinite(points).all(axis=1)]
    groups = agreements(np.array(poses).reshape(-1, 4, 4), known, same)
    if not groups:
        return NetworkView(looked, len(poses), (), (), None, points, networks.names[name])
    best = groups[0]
    return NetworkView(
        looked,
        len(poses),
        tuple(numbers[best.members].tolist()),
        tuple(best.off_m.tolist()),
        best.scene_from_object,
        points,
        networks.names[name],
    )


def compared_line(workspace: Workspace, name: str, scene: str, view: NetworkView) -> str:
    """How far a network and the labels of a scene are apart."""
    if view.scene_from_object is None:
        return (
            f"{name} in scene {scene}: nothing to compare, since the poses of too few of "
            f"{counted(view.looked, 'frame')} agree ({view.found} had one)"
        )
    solution = workspace.load_placed(name)
    apart_m = keypoint_distance_m(
        view.scene_from_object,
        view.points_object,
        solution.scene_from_object[scene],
        solution.model.points_object,
    )
    verdict = ""
    if len(view.off_m) < FEWEST_TO_JUDGE:
        verdict = ", too few to judge the labels by"
    elif labels_stray(apart_m, view.off_m):
        verdict = "; look at that scene, for one of the two is wrong"
    return (
        f"{name} in scene {scene}: the network puts it {1e3 * apart_m:.0f} mm from its labels, by "
        f"{len(view.frames)} of {counted(view.looked, 'frame')} that agree to "
        f"{1e3 * float(np.median(view.off_m)):.0f} mm{verdict}"
    )


def _placed(
    workspace: Workspace, name: str, scene: str, networks: Networks, view: NetworkView, tell: Tell
) -> Iterator[str]:
    """Place the object in the scene, if the evidence supports it."""
    proposed: list[Transform] = []
    if view.scene_from_object is not None:
        model = workspace.load_placed(name).model
        now_from_then = frame_change(model, networks.models[name])
        proposed.append(view.scene_from_object @ np.linalg.inv(now_from_then))
    agree = f"{len(view.frames)} of {counted(view.looked, 'frame')} agree on a pose"
    try:
        entry = run_step(
            recipe_of(workspace),
            workspace,
            lambda context, advance: find_step(context, name, scene, advance, proposed=proposed),
            title=("register", name),
            tell=tell,
        )
    except UnsureError as unsure:
        tell(Progress("register", name, "failed"))
        yield f"{unsure} (by the network, {agree})"
        return
    yield from (f"{line}; by the network, {agree}" for line in entry.outcome.messages)
