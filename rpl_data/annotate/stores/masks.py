"""Masks of the latest labels as overlays for the picture; each label is read when it is needed."""

from __future__ import annotations

import json
import re
from functools import lru_cache

import cv2
import numpy as np

from rpl_data.overlay import instance_number
from rpl_data.types import FrameLabel
from rpl_data.workspace.records import frame_label_from_json
from rpl_data.workspace.workspace import Workspace

COLORS_BGRA = ((208, 224, 53, 255), (60, 160, 255, 255), (230, 110, 240, 255), (90, 220, 120, 255))
"""Of the instance without a name, of `2`, and so on."""
FRAME = re.compile(rb'"frame": (\d+)')
SCENES_KEPT = 24


class MaskStore:
    """Finds labels by their offset in the file, so that a scene of 9,000 frames is never held in memory."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._offsets = lru_cache(SCENES_KEPT)(self._read_offsets)

    def png(self, scene: str, frame: int, object_name: str) -> bytes | None:
        """Draw the visible mask as a PNG, transparent elsewhere; None when there is no such label."""
        label = self.label(scene, frame)
        instances = [i for i in label.instances if i.object == object_name] if label else []
        if not instances:
            return None
        from pycocotools import mask as coco

        picture = np.zeros((*instances[0].mask["size"], 4), dtype=np.uint8)
        for instance in instances:
            color = COLORS_BGRA[instance_number(instance.instance) % len(COLORS_BGRA)]
            picture[coco.decode(instance.mask) > 0] = color
        return cv2.imencode(".png", picture)[1].tobytes()

    def label(self, scene: str, frame: int) -> FrameLabel | None:
        """Read the label of a frame; None when there is none."""
        video = self.workspace.parts().video_of(scene)  # a recording that was cut has one file of labels
        path = self.workspace.labels_file(video)
        if scene not in self.workspace.scene_names() or not path.exists():
            return None
        status = path.stat()
        offset = self._offsets(video, status.st_mtime_ns, status.st_size).get(frame)
        if offset is None:
            return None
        with path.open("rb") as file:
            file.seek(offset)
            return frame_label_from_json(json.loads(file.readline()))

    def _read_offsets(self, video: str, *stamp: int) -> dict[int, int]:
        """Byte offset of each frame's line in the file."""
        offsets, at = {}, 0
        with self.workspace.labels_file(video).open("rb") as file:
            for line in file:
                found = FRAME.search(line[:200])
                if found:
                    offsets[int(found[1])] = at
                at += len(line)
        return offsets
