"""Stage `label`: label the chosen frames from dense models and poses."""

from __future__ import annotations

from collections import Counter
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
from rpl_data.label.mask_check import MaskCheck
from rpl_data.meshes import load_cloud, load_mesh
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.followed import follow_objects, moved_objects
from rpl_data.pipeline.given_masks import instances_in, mask_options, object_masks
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.types import FrameLabel, posed_frames
from rpl_data.types.instances import instance_of, places_in
from rpl_data.wording import counted
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
    workspace, rate_hz, dots = context.workspace, context.recipe.label.rate_hz, context.recipe.label.dots
    correct = context.recipe.refine.frames
    parts = workspace.parts()
    standing = {scene: context.solutions_in(scene) for scene in parts.scenes_of(video)}
    placed = {scene: [item.model.name for item in found] for scene, found in standing.items() if found}
    names = [name for name in context.object_names if any(name in found for found in placed.values())]

    def run(advance: Advance) -> Outcome:
        counts: Counter[str] = Counter()
        moved_px: dict[str, list[float]] = {}
        scene = workspace.load_scene(video)
        given, check = object_masks(context, video), MaskCheck()
        posed = posed_frames(scene, workspace.load_trajectory(scene))
        alone = {name for name in names if len(instances_in(workspace.load_placed(name), video, parts)) == 1}
        followed, followed_m = list[str](), dict[str, float]()
        if video in parts.moving:
            found, followed_m, followed = follow_objects(workspace, video, placed[video], posed, advance)
            posed = [frame for frame in posed if frame.index in found]
        frames = sample_frames(posed, rate_hz=rate_hz)
        chosen = {
            name: [f.index for f in frames if parts.scene_at(video, f.index) == name] for name in placed
        }
        total = sum(map(len, chosen.values()))

        def labels() -> Iterator[FrameLabel]:
            for name, indices in chosen.items():
                ranges = context.pool.ranges(len(indices))
                of_scene = (workspace.root, name, video, placed[name], indices)
                tasks = [(*of_scene, indices[a:b], dots, correct, followed_m) for a, b in ranges]
                yield from context.pool.stream(label_range, tasks)

        def tallied() -> Iterator[FrameLabel]:
            for done, label in enumerate(labels(), start=1):
                advance(done, total)
                counts.update(instance.object for instance in label.instances)
                for instance in label.instances:
                    if instance.corrected_px is not None:
                        moved_px.setdefault(instance.object, []).append(instance.corrected_px)
                    # Which of several instances a given mask is of is not known.
                    if given is not None and instance.object in given.keys and instance.object in alone:
                        mask = given.mask(instance.object, label.frame, scene)
                        check.add(instance.object, label.frame, instance.mask, mask)
                yield label

        workspace.save_labels(video, tallied())
        remove(workspace.earlier_labels_file(video))
        notes = [] if given is None else [f"scene {video}: {line}" for line in given.notes]
        notes += [
            f"scene {video}: it shows several {name}, so given masks neither check them nor vote on "
            "their shape: which instance a mask is of is not known"
            for name in names
            if given is not None and name in given.keys and name not in alone
        ]
        lines = [*notes, *check.lines(video)]
        path = "the path that was followed" if followed else "the camera path"
        lines += [
            corrected_line(video, item, moved_px[item], counts[item], path) for item in sorted(moved_px)
        ]
        details = {
            "instances": {item: counts[item] for item in names},
            "posed": len(posed),
            "corrected": {item: len(found) for item, found in moved_px.items()},
            **({} if given is None else {"given_masks": check.details()}),
        }
        return Outcome(total, (*followed, *lines), details)

    before = [step for item in names for step in (context.placed_by(item), f"segment/{item}")]
    options: Json = {"rate_hz": rate_hz} | {name: context.frames_of(name) for name in placed if name != video}
    if video in parts.moving:
        options |= {"followed": "compared where it stands still"}  # else as labelled by older versions
    if dots:
        options |= {"masks": "splat"}
    if correct != "auto":
        options |= {"correct": correct}
    output = workspace.labels_file(video)
    mask_choice, mask_files = mask_options(context, [video])
    return step(
        "label",
        video,
        run,
        version=VERSION,
        options=options | mask_choice,
        sources=mask_files,
        after=[*context.poses_of(video), *before],
        outputs=[output],
    )


def corrected_line(video: str, item: str, moved_px: Sequence[float], labels: int, path: str) -> str:
    """Says how many labels of an object were corrected in their frames, and by how much."""
    by = f"{np.median(moved_px):.1f} px"
    if len(moved_px) > 1:
        by += f" (median), {max(moved_px):.1f} px at most"
    others = f"; the other labels keep to {path}" if len(moved_px) < labels else ""
    return (
        f"scene {video}: {item} is corrected in {len(moved_px)} of {counted(labels, 'frame')} by what is "
        f"printed on it, by {by}{others}"
    )


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
