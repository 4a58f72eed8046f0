"""What new views are made of: objects, plates to put them on, lights and noise, all of the same scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.directions import Directions
from rpl_data.synthesize.body import Body
from rpl_data.synthesize.light import SceneLight
from rpl_data.synthesize.views import view_weights
from rpl_data.types import Intrinsics, Symmetries


@dataclass(frozen=True)
class Plane:
    """The points p before a camera with ``normal @ p == offset_m``; the camera is on the normal's side.

    Attributes:
        normal: unit vector, camera frame.
    """

    normal: Float64[np.ndarray, "3"]
    offset_m: float


@dataclass(frozen=True)
class Plate:
    """A picture that objects are put into.

    Attributes:
        scene, frame: which image it is made of; empty and a number from 0 for a picture of the user's.
        color, depth: files; depth is None where it is not known, and then has no unit.
        camera: its camera.
        up: unit vector against gravity, or out of the table, camera frame.
        table: what objects stand on; None where that is not known: objects then float before the picture.
    """

    scene: str
    frame: int
    color: Path
    depth: Path | None
    metres_per_unit: float | None
    camera: Intrinsics
    up: Float64[np.ndarray, "3"]
    table: Plane | None


@dataclass(frozen=True)
class Subject:
    """An object, and how it may be shown.

    Attributes:
        keypoints: their names.
        views: directions from the object to the camera in the recorded images, object frame.
        shown: for each of `spread_directions`, whether the mesh was seen from there.
        ups: what was up, or out of the table, for each instance in each scene; object frame.
        turn_deg: largest turn of the image against upright.
        nearest_m, farthest_m: recorded distances.
        keypoint_sigma_m: how far off the keypoints may be on the mesh, standard deviation per axis.
        lights: as they were fitted to its colours, by scene.
        symmetries: what leaves it looking the same.
        carved: whether its shape is that of its outlines alone, hollows filled.
    """

    body: Body
    keypoints: tuple[str, ...]
    views: Directions
    shown: Bool[np.ndarray, " d"]
    ups: Directions
    turn_deg: float
    nearest_m: float
    farthest_m: float
    keypoint_sigma_m: float
    lights: Mapping[str, SceneLight]
    symmetries: Symmetries = Symmetries()
    carved: bool = False

    @cached_property
    def likely(self) -> Float64[np.ndarray, " d"]:
        """How likely each of `spread_directions` is drawn."""
        return view_weights(self.views, self.shown)

    def __getstate__(self) -> dict[str, Any]:
        """What worker processes receive: without what each makes for itself."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


@dataclass(frozen=True)
class DepthNoise:
    """Errors of the depth of one object: dark and shiny ones lose more of it than others.

    Attributes:
        sigma: standard deviation, in units of `geometry.depth_sigma_m`.
        lost_inside, lost_at_rim: share of the object's pixels without depth, and of those within `RIM_PX` of
            its outline.
    """

    sigma: float = 1.0
    lost_inside: float = 0.0
    lost_at_rim: float = 0.0


@dataclass(frozen=True)
class Noise:
    """Errors of the camera, as the recorded images show them.

    Attributes:
        color: standard deviation of a pixel, grey levels.
        depth: by the object's name.
    """

    color: float
    depth: Mapping[str, DepthNoise]


@dataclass(frozen=True)
class Studio:
    """All of it.

    Attributes:
        scenes: what everything was made of.
        together: how many objects each recorded image shows.
        centres: where objects are in recorded images, as shares of width and height.
    """

    scenes: tuple[str, ...]
    subjects: Mapping[str, Subject]
    plates: tuple[Plate, ...]
    noise: Noise
    together: tuple[int, ...]
    centres: Float64[np.ndarray, "n 2"]
