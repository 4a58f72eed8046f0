"""Objects that are moved while a scene is filmed, followed through its frames before they are labelled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rpl_data.geometry import Transform, invert, transform
from rpl_data.images import read_grey
from rpl_data.label.alone import Body, SceneObject
from rpl_data.label.follow import Followed, follow
from rpl_data.meshes import load_mesh
from rpl_data.pipeline.ledger import Advance
from rpl_data.raycast import PixelTable
from rpl_data.types import Frame, Solution, Trajectory, posed_frames
from rpl_data.types.instances import frame_of, instance_of, places_in, scene_of, without_frame
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace

FOLLOWED_M = 0.003
"""Standard deviation per axis of the keypoints of a followed object where no scene tells it: two rendered
objects were off by 1.4 and 3.9 mm."""
TRIED_SCENES, TRIED_AT, TRIED_FRAMES = 4, (0.25, 0.75), 3
"""An object is followed where it stands still, too, for a comparison: in at most so many scenes, from frames
at these shares of each, through so many frames."""
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
) -> tuple[set[int], dict[str, float], list[str]]:
    """Follow the objects of a scene, and keep their paths.

    Returns:
        The frames in which all of them were found; how far off each object's keypoints should be
        (`followed_sigma_m`); and lines for the user that name the other frames.
    """
    found = {frame.index for frame in frames}
    sigmas_m: dict[str, float] = {}
    lines: list[str] = []
    for name in objects:
        solution = workspace.load_placed(name)
        for place, clicked in moved_places(solution, video).items():
            followed = _followed(workspace, video, name, solution, clicked, frames, advance)
            path = {index: invert(pose) for index, pose in sorted(followed.camera_from_object.items())}
            workspace.save_path(name, place, workspace.load_scene(video), _trajectory(path))
            found &= path.keys()
            lines += _said(name, place, followed)
        if moved_places(solution, video):
            sigmas_m[name] = followed_sigma_m(workspace, name)
    return found, sigmas_m, lines


def _followed(
    workspace: Workspace,
    video: str,
    name: str,
    solution: Solution,
    clicked: Sequence[str],
    frames: Sequence[Frame],
    advance: Advance,
) -> Followed:
    trajectory = workspace.load_trajectory(workspace.load_scene(video))
    known = {}
    for place in clicked:
        frame = frame_of(place)
        assert frame is not None
        pose: Transform = invert(trajectory.at(frame)) @ solution.scene_from_object[place]
        known[frame] = pose
    return _follow_from(workspace, video, _body(workspace, name, solution), frames, known, advance)


def _body(workspace: Workspace, name: str, solution: Solution) -> Body:
    mesh = load_mesh(workspace.mesh_file(name))
    return Body.of(SceneObject(solution.model, solution.covariance, mesh, np.eye(4)))


def _follow_from(
    workspace: Workspace,
    scene_name: str,
    body: Body,
    frames: Sequence[Frame],
    known: Mapping[int, Transform],
    advance: Advance = lambda done, total: None,
) -> Followed:
    scene = workspace.load_scene(scene_name)
    camera, read_depth = PixelTable.of(scene.intrinsics), workspace.depth_reader(scene)
    return follow(
        camera, body, frames, known, read_depth, lambda frame: read_grey(frame, reduce=1), advance=advance
    )


def followed_sigma_m(workspace: Workspace, name: str) -> float:
    """How far off the keypoints of an object are that is followed: standard deviation per axis.

    It is measured where the object stands still: there it is followed in the same way, and the clicks of all
    scenes and the camera's path, which following does not use, say where it is. The median of several tries.
    """
    solution, moving = workspace.load_placed(name), workspace.parts().moving
    body = _body(workspace, name, solution)
    still = [place for place in solution.scene_from_object if scene_of(place) not in moving]
    tries = (_tries(workspace, body, solution, place) for place in still[:TRIED_SCENES])
    offsets_m = [one for found in tries for one in found]
    return float(np.median(offsets_m)) if offsets_m else FOLLOWED_M


def _tries(workspace: Workspace, body: Body, solution: Solution, place: str) -> Iterator[float]:
    """Root mean square per axis of how far following moves the keypoints, for each try in a scene."""
    scene = workspace.load_scene(scene_of(place))
    trajectory = workspace.load_trajectory(scene)
    points = solution.model.points_object[solution.model.known]
    posed = posed_frames(scene, trajectory)
    for share in TRIED_AT:
        start = int(share * len(posed))
        frames = posed[start : start + TRIED_FRAMES]
        standing: dict[int, Transform] = {
            frame.index: invert(trajectory.at(frame.index)) @ solution.scene_from_object[place]
            for frame in frames
        }
        first = {frame.index: standing[frame.index] for frame in frames[:1]}
        found = _follow_from(workspace, scene.name, body, frames, first).camera_from_object
        moved_m = [transform(found[index], points) - transform(standing[index], points) for index in found]
        if moved_m:
            yield float(np.sqrt(np.mean(np.square(moved_m))))


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


def moved_objects(workspace: Workspace, name: str, scene: str, sigma_m: float) -> list[SceneObject]:
    """The instances of an object that was followed through a scene, as the labels need them.

    Args:
        sigma_m: how far off its keypoints should be, as `followed_sigma_m` says.
    """
    solution, mesh = workspace.load_placed(name), load_mesh(workspace.mesh_file(name))
    covariance = solution.covariance + sigma_m**2 * np.eye(3)
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
