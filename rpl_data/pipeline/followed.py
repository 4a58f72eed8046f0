"""Objects that are moved while a scene is filmed, followed through its frames before they are labelled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rpl_data.geometry import Transform, invert
from rpl_data.images import read_grey
from rpl_data.label.alone import Body, SceneObject
from rpl_data.label.follow import Followed, follow
from rpl_data.meshes import load_mesh
from rpl_data.pipeline.ledger import Advance
from rpl_data.raycast import PixelTable
from rpl_data.types import Frame, Solution, Trajectory
from rpl_data.types.instances import frame_of, instance_of, places_in, without_frame
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace

FOLLOWED_M = 0.003
"""Standard deviation per axis of the keypoints of an object drawn to its mesh in a frame: the position
of a rendered carton was off by 1.4 mm, that of a kettle with a poorer mesh by 3.9 mm."""
NAMED = 6
"""Lost frames named per line."""


def moved_places(solution: Solution, scene: str) -> dict[str, list[str]]:
    """The instances of an object that are moved in a scene, each with its places in clicked frames."""
    found: dict[str, list[str]] = {}
    for place in places_in(scene, solution.scene_from_object):
        found.setdefault(without_frame(place), []).append(place)
    return found


def follow_objects(
    workspace: Workspace, video: str, objects: Sequence[str], frames: Sequence[Frame], advance: Advance
) -> tuple[set[int], list[str]]:
    """Follow the objects of a scene, and keep their paths.

    Returns:
        The frames in which all of them were found, and lines for the user that name the others.
    """
    found = {frame.index for frame in frames}
    lines: list[str] = []
    for name in objects:
        solution = workspace.load_placed(name)
        for place, clicked in moved_places(solution, video).items():
            followed = _followed(workspace, video, name, solution, clicked, frames, advance)
            path = {index: invert(pose) for index, pose in sorted(followed.camera_from_object.items())}
            workspace.save_path(name, place, workspace.load_scene(video), _trajectory(path))
            found &= path.keys()
            lines += _said(name, place, followed)
    return found, lines


def _followed(
    workspace: Workspace,
    video: str,
    name: str,
    solution: Solution,
    clicked: Sequence[str],
    frames: Sequence[Frame],
    advance: Advance,
) -> Followed:
    scene = workspace.load_scene(video)
    trajectory = workspace.load_trajectory(scene)
    known = {}
    for place in clicked:
        frame = frame_of(place)
        assert frame is not None
        pose: Transform = invert(trajectory.at(frame)) @ solution.scene_from_object[place]
        known[frame] = pose
    item = SceneObject(solution.model, solution.covariance, load_mesh(workspace.mesh_file(name)), np.eye(4))
    return follow(
        PixelTable.of(scene.intrinsics),
        Body.of(item),
        frames,
        known,
        workspace.depth_reader(scene),
        lambda frame: read_grey(frame, reduce=1),
        advance=advance,
    )


def _trajectory(poses: Mapping[int, Transform]) -> Trajectory:
    return Trajectory(np.array(list(poses), dtype=np.int64), np.array(list(poses.values())).reshape(-1, 4, 4))


def _said(name: str, place: str, followed: Followed) -> Iterator[str]:
    """How far an object was followed, and why not farther."""
    total = len(followed.camera_from_object) + len(followed.lost)
    if not followed.lost:
        yield f"scene {place}: {name} is followed through all {counted(total, 'frame')}"
        return
    yield (
        f"scene {place}: {name} is followed through {len(followed.camera_from_object)} of "
        f"{counted(total, 'frame')}; the others are not labelled: click it in one of them, on at least three "
        "keypoints, to follow it from there"
    )
    for why, count in Counter(followed.lost.values()).most_common():
        frames = sorted(index for index, reason in followed.lost.items() if reason == why)
        named = ", ".join(map(str, frames[:NAMED])) + (", ..." if count > NAMED else "")
        yield f"scene {place}: {name} is lost in {counted(count, 'frame')} ({named}): {why}"


def moved_objects(workspace: Workspace, name: str, scene: str) -> list[SceneObject]:
    """The instances of an object that was followed through a scene, as the labels need them."""
    solution, mesh = workspace.load_placed(name), load_mesh(workspace.mesh_file(name))
    covariance = solution.covariance + FOLLOWED_M**2 * np.eye(3)
    recorded = workspace.load_scene(scene)
    return [
        SceneObject(
            solution.model,
            covariance,
            mesh,
            np.eye(4),
            instance=instance_of(place),
            path=workspace.load_path(name, place, recorded),
        )
        for place in moved_places(solution, scene)
    ]
