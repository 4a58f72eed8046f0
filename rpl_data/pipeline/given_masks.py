"""The masks that the recipe names for a recording, and which of them is which object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from rpl_data.formats.masks.given import GivenMasks, MaskImage, open_masks
from rpl_data.json_arrays import Json
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.ledger import stamps
from rpl_data.pipeline.recipe import MaskSource
from rpl_data.types import DataError, Scene, Solution
from rpl_data.types.instances import instance_of, without_frame
from rpl_data.workspace.parts import Parts
from rpl_data.workspace.workspace import Workspace

AROUND_PX = 5
"""A click on the outline belongs to the mask that has most pixels this near to it."""
CLEAR_SHARE = 0.6
"""Of the clicks of an object that must fall on one mask."""
LEAST_CLICKS = 3
"""On a mask, before they say whose it is."""


@dataclass(frozen=True)
class ObjectMasks:
    """The masks of a recording, with the key of each object in them.

    Attributes:
        keys: by object; objects without masks are absent.
        notes: lines for the user.
    """

    masks: GivenMasks
    keys: dict[str, str]
    notes: tuple[str, ...]

    def mask(self, name: str, frame: int, scene: Scene) -> MaskImage | None:
        """The mask of an object in a frame, empty where the others have one and it has none.

        None where the frame has no masks, or the object has none in the recording.
        """
        found = self.masks.at(frame) if name in self.keys else None
        if found is None:
            return None
        empty = np.zeros((scene.intrinsics.height, scene.intrinsics.width), bool)
        return found.get(self.keys[name], empty)


def mask_source(context: Context, video: str) -> MaskSource | None:
    """Where the recipe has masks of a recording; None where it has none."""
    read_from = context.workspace.load_scene(video).source
    sources = [
        source
        for source in context.scene_sources
        if str(source.path) in read_from and (source.names is None or video in source.names)
    ]
    if len(context.scene_sources) == 1:
        sources = list(context.scene_sources)
    nearest = max(sources, key=lambda source: len(str(source.path)), default=None)
    return None if nearest is None else nearest.masks


def mask_options(context: Context, videos: Sequence[str]) -> tuple[Json, Json]:
    """The options and the sources of steps that use the masks of recordings; empty without any."""
    found = {video: source for video in videos if (source := mask_source(context, video)) is not None}
    if not found:
        return {}, {}
    options = {video: asdict(source) | {"path": str(source.path)} for video, source in found.items()}
    files: Json = {}
    for path in sorted({source.path for source in found.values()}):
        files |= stamps(path)
    return {"masks": options}, files


def object_masks(context: Context, video: str) -> ObjectMasks | None:
    """Open the masks of a recording, and find out which is which object; None where there are none.

    Raises:
        DataError: no mask is named like a frame, or the recipe names an object that it does not have.
    """
    source, workspace = mask_source(context, video), context.workspace
    if source is None:
        return None
    sharing = [other for other in workspace.video_names() if mask_source(context, other) == source]
    with_some = [
        other
        for other in sharing
        if (source.path / other).exists() or (source.path / f"{other}.json").exists()
    ]
    if with_some and video not in with_some:
        return ObjectMasks(GivenMasks({}, ()), {}, (f"{source.path} has no masks of this scene",))
    alone = sharing == [video]
    masks = open_masks(source.path, source.format, workspace.load_scene(video), alone=alone)
    names = context.object_names
    unknown = sorted(set(source.objects or ()) - set(names))
    if unknown:
        raise DataError(
            f"masks.objects names {', '.join(unknown)}, which is no object of the recipe; it has "
            f"{', '.join(names)}"
        )
    if source.objects is not None:
        keys = {name: str(key) for name, key in source.objects.items()}
        return ObjectMasks(masks, keys, masks.notes)
    keys, lines = _keys_by_clicks(workspace, video, masks, names)
    return ObjectMasks(masks, keys, (*masks.notes, *lines))


def instances_in(solution: Solution, video: str, parts: Parts) -> set[str]:
    """Names of an object's instances in a recording; of a moved one without the clicked frames."""
    places = (place for place in solution.scene_from_object if parts.video_of(place) == video)
    return {instance_of(without_frame(place) if video in parts.moving else place) for place in places}


def _keys_by_clicks(
    workspace: Workspace, video: str, masks: GivenMasks, names: Sequence[str]
) -> tuple[dict[str, str], list[str]]:
    """The key of each object: its own name, or that of the mask on which its clicks fall; and lines."""
    votes = {name: Counter(_keys_at_clicks(workspace, video, masks, name)) for name in names}
    seen = {key for count in votes.values() for key in count}
    keys = {name: name for name in names if name in seen}
    lines = []
    for name, count in votes.items():
        if name in keys or not count:
            continue
        key, most = count.most_common(1)[0]
        if most >= LEAST_CLICKS and most >= CLEAR_SHARE * count.total() and key not in keys.values():
            keys[name] = key
            lines.append(
                f"given mask {key} is taken for {name}: {most} of its {count.total()} clicks fall on it"
            )
        else:
            lines.append(
                f"no given mask is clearly that of {name} by its clicks; write `objects: {{{name}: ...}}` "
                "under `masks:` in the recipe"
            )
    return keys, lines


def _keys_at_clicks(workspace: Workspace, video: str, masks: GivenMasks, name: str) -> Iterator[str]:
    """For each click of an object in a frame with masks, the key of the mask with most pixels around it."""
    parts = workspace.parts()
    for click in map(parts.click_in_video, workspace.load_annotation(name).clicks):
        found = masks.at(click.frame) if click.scene == video else None
        u, v = round(click.u_px), round(click.v_px)
        rows = slice(max(v - AROUND_PX, 0), max(v + AROUND_PX + 1, 0))
        columns = slice(max(u - AROUND_PX, 0), max(u + AROUND_PX + 1, 0))
        near = {key: int(mask[rows, columns].sum()) for key, mask in (found or {}).items()}
        best = max(near, key=lambda key: near[key], default=None)
        if best is not None and near[best]:
            yield best
