"""Stage `label`: label the chosen frames from dense models and poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from rpl_data.files import remove
from rpl_data.geometry import Transform
from rpl_data.images import read_grey
from rpl_data.json_arrays import Json
from rpl_data.label.alone import SceneObject
from rpl_data.label.frame_correction import frame_corrector
from rpl_data.label.label import label_frames, sample_frames
from rpl_data.meshes import load_cloud, load_mesh
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.followed import follow_objects, moved_objects
from rpl_data.pipeline.given_masks import instances_in, mask_options, object_masks
from rpl_data.pipeline.label_tally import LabelTally
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.types import FrameLabel, posed_frames
from rpl_data.types.instances import instance_of, places_in
from rpl_data.workspace.workspace import Workspace

VERSION = 8
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def label_steps(context: Context) -> list[Step]:
    """Plan the labels of the chosen frames, one step per recording."""
    return [_label_step(context, name) for name in context.placed_videos()]


def forget_labels(context: Context) -> None:
    """Remove the labels of recordings in which no object is placed any more.

    Where this build only leaves the recording out, they are set aside: they may be all that is left of it.
    """
    for gone in set(context.workspace.labelled_scene_names()) - set(context.placed_videos()):
        if gone in context.lost:
            context.workspace.set_labels_aside(gone)
        else:
            remove(context.workspace.labels_file(gone))


def _label_step(context: Context, video: str) -> Step:
    workspace, parts, label = context.workspace, context.workspace.parts(), context.recipe.label
    standing = {scene: context.solutions_in(scene) for scene in parts.scenes_of(video)}
    placed = {scene: [item.model.name for item in found] for scene, found in standing.items() if found}
    names = [name for name in context.object_names if any(name in found for found in placed.values())]
    options: Json = {"rate_hz": label.rate_hz}
    options |= {name: context.frames_of(name) for name in placed if name != video}
    if video in parts.moving:
        options |= {"followed": "compared where it stands still"}  # else as labelled by older versions
    if label.dots:
        options |= {"masks": "splat"}
    if context.recipe.refine.frames != "auto":
        options |= {"correct": context.recipe.refine.frames}
    mask_choice, mask_files = mask_options(context, [video])
    before = [step for item in names for step in (context.placed_by(item), f"segment/{item}")]
    return step(
        "label",
        video,
        partial(_label_video, context, video, placed, names),
        version=VERSION,
        options=options | mask_choice,
        sources=mask_files,
        after=[*context.poses_of(video), *before],
        outputs=[workspace.labels_file(video)],
    )


def _label_video(
    context: Context, video: str, placed: Mapping[str, Sequence[str]], names: Sequence[str], advance: Advance
) -> Outcome:
    """Label the frames of a recording, and keep the labels.

    Args:
        placed: by scene of the recording, the objects in it; `names` are all of them.
    """
    workspace, parts = context.workspace, context.workspace.parts()
    scene = workspace.load_scene(video)
    posed = posed_frames(scene, workspace.load_trajectory(scene))
    alone = {name for name in names if len(instances_in(workspace.load_placed(name), video, parts)) == 1}
    tally = LabelTally(scene, names, alone, object_masks(context, video))
    path, said, followed_m = "the camera path", list[str](), dict[str, float]()
    if video in parts.moving:
        found, followed_m, said = follow_objects(workspace, video, placed[video], posed, advance)
        posed, path = [frame for frame in posed if frame.index in found], "the path that was followed"
    frames = sample_frames(posed, rate_hz=context.recipe.label.rate_hz)
    chosen = {name: [f.index for f in frames if parts.scene_at(video, f.index) == name] for name in placed}
    total = sum(map(len, chosen.values()))
    labels = _labels(context, video, placed, chosen, followed_m)
    workspace.save_labels(video, tally.counting(labels, total, advance))
    remove(workspace.earlier_labels_file(video))
    return Outcome(total, (*said, *tally.lines(video, path=path)), tally.details(posed=len(posed)))


def _labels(
    context: Context,
    video: str,
    placed: Mapping[str, Sequence[str]],
    chosen: Mapping[str, Sequence[int]],
    followed_m: Mapping[str, float],
) -> Iterator[FrameLabel]:
    """The labels of the chosen frames of each scene, made in ranges, side by side."""
    dots, correct = context.recipe.label.dots, context.recipe.refine.frames
    for name, indices in chosen.items():
        of_scene = (context.workspace.root, name, video, placed[name], indices)
        ranges = context.pool.ranges(len(indices))
        tasks = [(*of_scene, indices[a:b], dots, correct, followed_m) for a, b in ranges]
        yield from context.pool.stream(label_range, tasks)


def label_range(
    root: Path,
    name: str,
    video: str,
    objects: Sequence[str],
    labelled: Sequence[int],
    indices: Sequence[int],
    dots: bool = False,
    correct: bool | Literal["auto"] = "auto",
    followed_m: Mapping[str, float] = {},
) -> Iterator[FrameLabel]:
    """Label some frames of a scene, under the name of its recording; runs in this or another process.

    Args:
        labelled: all frames of the scene that are labelled, here or elsewhere: the references by which
            single frames are corrected are chosen among them.
        indices: the frames to label.
        correct: as `RefineRecipe.frames`.
        followed_m: how far off the keypoints of objects that are moved should be, by name.
    """
    workspace = Workspace(root)
    scene = workspace.load_scene(name)
    trajectory = workspace.load_trajectory(scene)
    if video in workspace.parts().moving:
        bodies = [body for item in objects for body in moved_objects(workspace, item, name, followed_m[item])]
    else:
        bodies = [body for item in objects for body in scene_objects(workspace, item, name, dots=dots)]
    frames, read = {frame.index: frame for frame in scene.frames}, workspace.depth_reader(scene)
    look = partial(read_grey, reduce=1)
    corrector = None
    if correct:
        usable = [frames[index] for index in labelled]
        corrector = frame_corrector(scene, trajectory, bodies, usable, read, look, unproven=correct is True)
    return label_frames(
        replace(scene, name=video),
        trajectory,
        bodies,
        [frames[index] for index in indices],
        read,
        read_depth_into=workspace.depth_window_reader(scene),
        read_grey=look,
        corrector=corrector,
    )


def scene_objects(
    workspace: Workspace, object_name: str, scene: str, *, dots: bool = False
) -> list[SceneObject]:
    """Load the instances of an object in a scene; with its points, if masks are to be made of them."""
    solution = workspace.load_placed(object_name)
    mesh = load_mesh(workspace.mesh_file(object_name))
    cloud = load_cloud(workspace.cloud_file(object_name)) if dots else None
    found = []
    for place in places_in(scene, solution.scene_from_object):
        pose: Transform = solution.scene_from_object[place]
        strayed_m = solution.trajectory_sigma_m.get(place, 0.0)
        covariance = solution.covariance_at(place) - strayed_m**2 * np.eye(3)
        instance = instance_of(place)
        found.append(SceneObject(solution.model, covariance, mesh, pose, cloud, strayed_m, instance))
    return found
