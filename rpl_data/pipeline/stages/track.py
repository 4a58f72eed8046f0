"""Stage `track`: compute camera poses where a recording has none, and check given ones by the images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rpl_data.geometry import rays, transform
from rpl_data.images import read_depth_m, read_grey
from rpl_data.json_arrays import Json, finite_or_none
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.correction import LEAST_TIED, correct
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.types import (
    Click,
    DataError,
    DepthImage,
    Frame,
    GreyImage,
    ReadDepth,
    Recording,
    Scene,
    Trajectory,
)
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace

VERSION = 3
"""Increase it when the stage writes something else for the same input: its steps then run again."""

AHEAD = 8
"""Number of frames that are decoded in advance while others are tracked."""

KEEP_BELOW_PX = 0.5
"""Given poses are kept when the correction would move the images by less than this."""

AROUND, SMALLEST_REGION_M = 1.8, 0.12
"""Paths are judged within this many times the radius of the clicked keypoints, and at least this radius."""


def track_steps(context: Context) -> list[Step]:
    """Plan the steps that track the camera, one per recording."""
    return [_track_step(context, name) for name in context.videos()] if context.tracks else []


def _track_step(context: Context, name: str) -> Step:
    workspace, wants_given = context.workspace, context.wants_given

    def run(advance: Advance) -> Outcome:
        scene = workspace.load_scene(name)
        given = workspace.load_given(scene) if wants_given else None
        clicks = [c for item in context.object_names for c in workspace.load_annotation(item).clicks]
        if given is None:
            found = compute_path(workspace, scene, advance)
        else:
            found = check_given_path(workspace, scene, given, clicks, advance)
        details = finite_or_none(found.details)  # a figure that could not be judged is no number
        workspace.save_given(Recording(scene, given))
        workspace.save_corrected(scene, found.corrected)
        workspace.save_trajectory(scene, found.trajectory)
        return Outcome(len(scene.frames), tuple(f"scene {name}: {line}" for line in found.lines), details)

    options: Json = {"method": context.recipe.reconstruct.method}
    if wants_given:  # paths are judged around what is clicked: once more when the first clicks are there
        options["judged"] = "around clicks" if _is_clicked(context, name) else "everywhere"
    return step(
        "track",
        name,
        run,
        version=VERSION,
        options=options,
        after=["import"],
        outputs=[workspace.trajectory_file(name)],
    )


def forget_paths(context: Context) -> None:
    """Where the recipe takes the poses as they came, paths that were made of the images make way for them."""
    if not context.tracks:
        for name in context.videos():
            context.workspace.restore_given(name)


def _is_clicked(context: Context, name: str) -> bool:
    """Whether anything was clicked in a recording."""
    workspace = context.workspace
    annotations = [workspace.load_annotation(item) for item in context.object_names]
    return any(scene_of(click.scene) == name for annotation in annotations for click in annotation.clicks)


@dataclass(frozen=True)
class Found:
    """The camera path found for a scene.

    Attributes:
        trajectory: the path to use.
        corrected: the path corrected by its images; None where too few frames are connected.
        lines: lines for the user.
        details: figures for the ledger.
    """

    trajectory: Trajectory
    corrected: Trajectory | None
    lines: tuple[str, ...] = ()
    details: dict[str, Any] = field(default_factory=dict)


def compute_path(workspace: Workspace, scene: Scene, advance: Advance) -> Found:
    """Compute the path from the images alone: track it, then correct it by pairs of frames."""
    from rpl_data.reconstruct.path import collected, losses
    from rpl_data.reconstruct.tracking import track
    from rpl_data.reconstruct.view import REDUCE

    frames = [frame for frame in scene.frames if frame.depth is not None]
    read = workspace.depth_reader(scene, keep=True)

    def again(frame: Frame) -> tuple[GreyImage, DepthImage]:
        return read_grey(frame, reduce=REDUCE), read(frame)

    found = collected(scene, track(scene, decoded(frames, read, advance), again=again))
    corrected = correct(workspace, scene, found.trajectory, advance)
    path = corrected.trajectory
    return Found(path, path, tuple(losses(scene, found)), {"lost": len(found.lost)})


def check_given_path(
    workspace: Workspace, scene: Scene, given: Trajectory, clicks: Sequence[Click], advance: Advance
) -> Found:
    """Keep the given path where the images agree with it; else use the better of it and a computed one."""
    from rpl_data.reconstruct.path_judge import compare_paths, is_better

    corrected = correct(workspace, scene, given, advance)
    tied = corrected.share_tied
    details: dict[str, Any] = {"moved_px": round(corrected.most_px, 2), "tied": round(tied, 2)}
    if tied >= LEAST_TIED and corrected.most_px < KEEP_BELOW_PX:
        return Found(given, corrected.trajectory, (), details | {"path": "given"})
    try:
        other = (
            Found(corrected.trajectory, corrected.trajectory)
            if tied >= LEAST_TIED
            else compute_path(workspace, scene, advance)
        )
    except DataError:
        other = Found(given, given)
    unsure = "too few of its frames see the same to say whether its own poses are right: they are kept"
    if len(other.trajectory.frames) < LEAST_TIED * len(given.frames) or other.trajectory is given:
        return Found(given, None, (unsure,), details | {"path": "given"})
    read = workspace.depth_reader(scene)
    errors = compare_paths(
        scene,
        {"given": given, "ours": other.trajectory},
        lambda frame: (read_grey(frame, reduce=1), read(frame)),
        regions=clicked_regions(scene, given, clicks),
    )
    ours, theirs = errors["ours"], errors["given"]
    details |= {"color_px": [theirs.color_px, ours.color_px], "depth_m": [theirs.depth_m, ours.depth_m]}
    if not ours.are_known:
        return Found(given, None, (unsure,), details | {"path": "given"})
    off = f"are off by {theirs} between frames" if theirs.are_known else "let no two frames show the same"
    figures = f"its own poses {off}, those from its images are off by {ours}"
    if is_better(ours, theirs):
        taken = f"{figures}: the latter are used (`reconstruct: {{method: given}}` keeps its own)"
        return Found(other.trajectory, other.corrected, (taken, *other.lines), details | {"path": "ours"})
    return Found(given, other.corrected, (f"{figures}: its own are kept",), details | {"path": "given"})


def clicked_regions(
    scene: Scene, trajectory: Trajectory, clicks: Sequence[Click]
) -> list[tuple[np.ndarray, float]]:
    """Spheres (centre in the scene frame, radius in metres) around the clicked objects; none without clicks.

    Each comes from one frame, the one with most clicks on the object: other frames may have other pose
    errors.
    """
    found = []
    here = [c for c in clicks if scene_of(c.scene) == scene.name and c.frame in trajectory.frames]
    for name in dict.fromkeys((click.object, click.scene) for click in here):
        mine = [click for click in here if (click.object, click.scene) == name]
        frames = [click.frame for click in mine]
        most = max(sorted(set(frames)), key=frames.count)
        frame = next((f for f in scene.frames if f.index == most and f.depth is not None), None)
        if frame is None:
            continue
        depth_m = read_depth_m(scene, frame)
        uv_px = np.array([(c.u_px, c.v_px) for c in mine if c.frame == most])
        column, row = np.rint(uv_px).astype(int).T
        lifted_m = depth_m[row.clip(0, depth_m.shape[0] - 1), column.clip(0, depth_m.shape[1] - 1)].astype(
            float
        )
        if not (lifted_m > 0).any():
            continue
        # Clicks on edges often hit the background, so all get the median depth.
        points = rays(scene.intrinsics, uv_px) * np.median(lifted_m[lifted_m > 0])
        centre = points.mean(axis=0)
        radius_m = AROUND * float(np.linalg.norm(points - centre, axis=1).max())
        found.append((transform(trajectory.at(most), centre), max(radius_m, SMALLEST_REGION_M)))
    return found


def decoded(
    frames: Sequence[Frame], depths: ReadDepth, advance: Advance
) -> Iterator[tuple[Frame, GreyImage, DepthImage]]:
    """Decode frames to small brightness and depth images, in a thread that works ahead of the caller.

    Args:
        depths: function that reads a depth image.
    """
    from rpl_data.reconstruct.view import REDUCE

    def read(frame: Frame) -> tuple[Frame, GreyImage, DepthImage]:
        return frame, read_grey(frame, reduce=REDUCE), depths(frame)

    with ThreadPoolExecutor(1) as thread:
        waiting = [thread.submit(read, frame) for frame in frames[:AHEAD]]
        try:
            for number in range(len(frames)):
                advance(number, len(frames))
                ready = waiting.pop(0)
                if number + AHEAD < len(frames):
                    waiting.append(thread.submit(read, frames[number + AHEAD]))
                yield ready.result()
        finally:
            for future in waiting:
                future.cancel()
