"""The contact sheet: labels drawn on small pictures, to check them before they are exported."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from rpl_data.annotate.session import Session
from rpl_data.annotate.stores.pictures import encoded, resized
from rpl_data.images import read_color
from rpl_data.overlay import draw_overlay, view_of
from rpl_data.types import DataError, KeypointModel

SCENES_KEPT = 24
PICTURES_KEPT = 400
WIDTHS_PX = (160, 320, 640, 1280)
DRAWN_PX = 640
"""Pictures are drawn at least this wide and then shrunk, so that marks hide little of them."""
FRAME = re.compile(rb'"frame": (\d+)')
OBJECT = re.compile(rb'"object": "([^"]*)"')
QUALITY = re.compile(rb'"quality": ([0-9.eE+-]+)')


@dataclass(frozen=True)
class Labelled:
    """Summary of a labelled frame.

    Attributes:
        quality: quality of its worst instance, 0 to 1; None when it shows no object.
    """

    frame: int
    objects: tuple[str, ...]
    quality: float | None


class ContactSheet:
    """Labels of a workspace as small pictures; the most recent ones are cached."""

    def __init__(self, session: Session) -> None:
        self._session, self._workspace = session, session.workspace
        self._brief = lru_cache(SCENES_KEPT)(self._read_brief)
        self._models = lru_cache(1)(self._read_models)
        self._picture = lru_cache(PICTURES_KEPT)(self._draw)

    def frames(self, scene: str) -> list[Labelled]:
        """List the labelled frames of a scene; empty when no labels were made."""
        stamp = self._stamp(scene)
        if stamp is None:
            return []
        here = self._session.scenes.get(scene).frames  # a part of a cut recording has only some of them
        return [item for item in self._brief(self._video(scene), stamp) if item.frame in here]

    def jpeg(self, scene: str, frame: int, width_px: int, *, whole: bool = False) -> bytes:
        """Draw a frame with its labels as JPEG, the part around the objects or the whole.

        Raises:
            DataError: it has none.
        """
        stamp = self._stamp(scene)
        if stamp is None:
            raise DataError(f"scene {scene} has no labels yet; make them first")
        width = next((w for w in WIDTHS_PX if w >= width_px), WIDTHS_PX[-1])
        return self._picture(scene, frame, width, whole, stamp)

    def _stamp(self, scene: str) -> tuple[int, int] | None:
        path = self._workspace.labels_file(self._video(scene))
        if scene not in self._session.scenes.names() or not path.exists():
            return None
        status = path.stat()
        return status.st_mtime_ns, status.st_size

    def _video(self, scene: str) -> str:
        return self._workspace.parts().video_of(scene)

    def _read_brief(self, video: str, stamp: tuple[int, int]) -> list[Labelled]:
        """Summarise the frames in one pass over the file, without decoding masks."""
        found = []
        with self._workspace.labels_file(video).open("rb") as file:
            for line in file:
                frame = FRAME.search(line)
                if frame is None:
                    raise DataError(f"the labels of {video} are broken; make them again")
                objects = tuple(sorted({name.decode() for name in OBJECT.findall(line)}))
                quality = [float(value) for value in QUALITY.findall(line)]
                found.append(Labelled(int(frame[1]), objects, min(quality) if quality else None))
        return found

    def _draw(self, scene: str, frame: int, width_px: int, whole: bool, stamp: tuple[int, int]) -> bytes:
        label = self._session.masks.label(scene, frame)
        if label is None:
            raise DataError(f"scene {scene}, frame {frame} has no label")
        posed = self._session.scenes.get(scene)
        view = None if whole else view_of(label, posed.scene.intrinsics)
        color, least_px = read_color(posed.frame(frame)), DRAWN_PX if whole else width_px
        drawn = draw_overlay(color, label, self._models(stamp), view=view, width_px=max(width_px, least_px))
        return encoded(resized(drawn, width_px))

    def _read_models(self, stamp: tuple[int, int]) -> Mapping[str, KeypointModel]:
        names = [n for n in self._session.objects() if self._workspace.solution_file(n).exists()]
        return {name: self._workspace.load_placed(name).model for name in names}
