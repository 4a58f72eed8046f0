"""Write the labels of scenes to a COCO folder: train, val and test files, with the images beside them.

The folder is renamed when it is complete. Labels are read in one pass; memory does not grow with the masks.
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO

from rpl_data.export.coco_images import is_as_stored, put_color, put_depth
from rpl_data.export.folder import Filling, Images, replacing
from rpl_data.export.split import FrameKey, SplitName, SplitRule, assigned_splits, choose_splits
from rpl_data.export.view_distances import ViewDirection, ViewDistance, view_direction, view_distances
from rpl_data.formats.datasets.coco import CocoObject, image_to_coco, instance_to_coco, writing_coco
from rpl_data.geometry import Transform
from rpl_data.json_arrays import Json
from rpl_data.types import (
    DataError,
    Frame,
    FrameLabel,
    KeypointModel,
    Scene,
    Symmetries,
    Trajectory,
)
from rpl_data.wording import counted


@dataclass(frozen=True)
class ExportScene:
    """A labelled scene.

    Attributes:
        labels: one per frame to export; may be an iterator, which is read once.
    """

    scene: Scene
    trajectory: Trajectory
    labels: Iterable[FrameLabel]


@dataclass(frozen=True)
class ExportSummary:
    """Counts and messages about an export.

    Attributes:
        images: number of images per split; a split without images has no file.
        instances: number of instances per split and object.
        scenes: names of the scenes in each split.
        invisible: number of instances left out because none of their pixels is visible.
        links: number of files that were cloned, copied, hard-linked, symlinked.
        views: distance of the views of val and test from those of training, per split.
        messages: lines for the user.
        low_quality: number of labels per object that were left out for their quality.
    """

    images: Mapping[SplitName, int]
    instances: Mapping[SplitName, Mapping[str, int]]
    scenes: Mapping[SplitName, tuple[str, ...]]
    invisible: int
    links: Mapping[str, int]
    views: Mapping[SplitName, ViewDistance]
    messages: tuple[str, ...]
    low_quality: Mapping[str, int] = field(default_factory=dict)


def export_coco(
    folder: Path,
    scenes: Sequence[ExportScene],
    models: Sequence[KeypointModel],
    *,
    split: SplitRule | Callable[[FrameKey], SplitName],
    meshes: Mapping[str, Path] | None = None,
    grasps: Mapping[str, Transform] | None = None,
    symmetries: Mapping[str, Symmetries] | None = None,
    frames: Mapping[str, Transform] | None = None,
    as_in: Path | None = None,
    images: Images = "copy",
) -> ExportSummary:
    """Write `folder`: {train,val,test}.json, images/<scene>/, depth/<scene>/, meshes/ and nothing else.

    Args:
        folder: folder to write; its old content is replaced.
        scenes: the scenes with their labels.
        models: the objects; category ids are 1, 2, ... in this order.
        split: rule for which frames train, validate and test; or a function that says it.
        meshes: files of dense models by object name; put there as meshes/<object><suffix>.
        grasps: `object_from_grasp` by object name.
        symmetries: what leaves the objects looking the same, by object name.
        frames: `frame_from_object` by object name, where models and poses are not in the workspace's frame.
        as_in: an exported folder whose split and image ids are kept (for labels made from truth); frames that
            it does not have are left out, and the images are links to its own.
        images: `link` takes no space, but a program that writes into an image then changes the recording.

    Raises:
        DataError: an image is missing, a label names an unknown object or frame, nothing is labelled, or the
            folder cannot be written; the folder that was there is then unchanged.
    """
    fixed = None if as_in is None else assigned_splits(as_in)
    with replacing(folder) as building, tempfile.TemporaryFile("w+", dir=building) as spool:
        files = Filling(images)
        objects = _objects(building, models, meshes or {}, files)
        objects = [
            replace(
                item,
                grasp=(grasps or {}).get(item.model.name),
                symmetries=(symmetries or {}).get(item.model.name, Symmetries()),
                frame=(frames or {}).get(item.model.name),
            )
            for item in objects
        ]
        collected = _collect(building, spool, scenes, objects, files, fixed, as_in)
        messages: tuple[str, ...] = ()
        if fixed is not None:
            splits = {key: name for key, (name, _) in fixed.items()}
        elif isinstance(split, SplitRule):
            splits, messages = choose_splits(collected.frames, split)
        else:
            splits = {key: split(key) for key in collected.frames}
        summary = _write_splits(building, spool, objects, splits, collected, files, messages)
    return summary


@dataclass(frozen=True)
class _Collected:
    """What one pass over the labels keeps in memory: names and viewing directions, no masks.

    Attributes:
        frames: names of the objects in every frame.
    """

    frames: Mapping[FrameKey, frozenset[str]]
    views: tuple[ViewDirection, ...]
    invisible: int


def _collect(
    building: Path,
    spool: IO[str],
    scenes: Sequence[ExportScene],
    objects: Sequence[CocoObject],
    files: Filling,
    fixed: Mapping[FrameKey, tuple[SplitName, int]] | None,
    as_in: Path | None,
) -> _Collected:
    """Put the images there, and write one line per frame, image and annotations, to the file `spool`.

    The split depends on all frames, so no line can go to its file before the last label was read.
    """
    frames: dict[FrameKey, frozenset[str]] = {}
    views: list[ViewDirection] = []
    invisible = annotation_id = 0
    categories = {item.model.name: number for number, item in enumerate(objects, start=1)}
    for item in scenes:
        by_index = {frame.index: frame for frame in item.scene.frames}
        for label in item.labels:
            key = (item.scene.name, label.frame)
            if fixed is not None and key not in fixed:
                continue
            image_id = len(frames) + 1 if fixed is None else fixed[key][1]
            frame = _frame(item.scene, by_index, label)
            annotations = []
            for instance in label.instances:
                _check_object(instance.object, categories, key)
                entry = instance_to_coco(annotation_id + 1, image_id, categories[instance.object], instance)
                if entry is None:
                    invisible += 1
                    continue
                annotation_id += 1
                annotations.append(entry)
                if not instance.crowd:
                    views.append(view_direction(key, frame.timestamp_s, instance))
            shown = sum(not entry["iscrowd"] for entry in annotations)
            frames[key] = frozenset(view.object for view in views[len(views) - shown :])
            image = _image(building, item, frame, image_id, files, as_in)
            spool.write(json.dumps([image, annotations], allow_nan=False) + "\n")
    if not frames:
        raise DataError("there is no labelled frame to export; run the label stage first")
    return _Collected(frames, tuple(views), invisible)


def _frame(scene: Scene, by_index: Mapping[int, Frame], label: FrameLabel) -> Frame:
    if label.scene != scene.name or label.frame not in by_index:
        raise DataError(
            f"a label of scene {label.scene}, frame {label.frame} was given for scene {scene.name}, which "
            f"has {counted(len(by_index), 'frame')} and not this one; label the scene again"
        )
    return by_index[label.frame]


def _check_object(name: str, categories: Mapping[str, int], key: FrameKey) -> None:
    if name not in categories:
        raise DataError(
            f"scene {key[0]}, frame {key[1]}: label of an unknown object {name!r}; "
            f"known: {', '.join(categories)}"
        )


def _image(
    building: Path, item: ExportScene, frame: Frame, image_id: int, files: Filling, as_in: Path | None
) -> Json:
    """Make the entry of an image, and put its files into the folder."""
    scene = item.scene
    name = f"images/{scene.name}/{frame.index:06d}{frame.color.suffix}"
    depth_name = None
    if frame.depth is not None:
        suffix = frame.depth.suffix if is_as_stored(scene) else ".png"
        depth_name = f"depth/{scene.name}/{frame.index:06d}{suffix}"
    if as_in is not None:
        for shared in filter(None, (name, depth_name)):
            files.share(as_in / shared, building / shared)
    else:
        put_color(frame, building / name, files)
        if depth_name is not None:
            put_depth(scene, frame, building / depth_name, files)
    return image_to_coco(
        image_id,
        frame,
        scene=scene.name,
        intrinsics=scene.intrinsics,
        scene_from_camera=item.trajectory.at(frame.index),
        file_name=name,
        depth_file_name=depth_name,
        metres_per_unit=scene.metres_per_unit,
    )


def _objects(
    building: Path,
    models: Sequence[KeypointModel],
    meshes: Mapping[str, Path],
    files: Filling,
) -> list[CocoObject]:
    objects = []
    for model in models:
        mesh = None
        if model.name in meshes:
            mesh = f"meshes/{model.name}{meshes[model.name].suffix}"
            files.put(meshes[model.name], building / mesh)
        objects.append(CocoObject(model, mesh))
    return objects


def _write_splits(
    building: Path,
    spool: IO[str],
    objects: Sequence[CocoObject],
    splits: Mapping[FrameKey, SplitName],
    collected: _Collected,
    files: Filling,
    messages: Sequence[str],
) -> ExportSummary:
    """Distribute the lines of the spool to the files of the splits."""
    frames = {key: splits[key] for key in collected.frames}
    names: list[SplitName] = [n for n in ("train", "val", "test") if n in frames.values()]
    spool.seek(0)
    with ExitStack() as stack:
        writers = {n: stack.enter_context(writing_coco(building / f"{n}.json", objects)) for n in names}
        for line in spool:
            image, annotations = json.loads(line)
            writers[frames[image["scene"], image["frame"]]].add(image, annotations)
    count = Counter((frames[view.frame], view.object) for view in collected.views)
    return ExportSummary(
        images={n: sum(1 for split in frames.values() if split == n) for n in names},
        instances={n: {o.model.name: count[n, o.model.name] for o in objects} for n in names},
        scenes={n: tuple(dict.fromkeys(key[0] for key in frames if frames[key] == n)) for n in names},
        invisible=collected.invisible,
        links=dict(files.counts),
        views=view_distances(collected.views, frames),
        messages=(*messages, *files.messages()),
    )
