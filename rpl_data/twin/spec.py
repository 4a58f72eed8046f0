"""The specification of a twin: one frozen dataclass, which can be written as YAML."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.twin.annotator import Mistakes
from rpl_data.twin.sensor import Sensor
from rpl_data.types import DataError, Intrinsics


@dataclass(frozen=True)
class Thing:
    """An object of a twin. A name alone will do when nothing else is needed.

    Attributes:
        name: name of the object in the dataset; without `mesh` or `shape` also the name of a built-in shape.
        shape: a built-in shape, one of `twin.objects.OBJECTS`, when the object is to have another name.
        mesh: an OBJ, PLY or GLB file in metres, with a texture or coloured vertices.
        landmarks: number of landmarks or, for a mesh, their positions in its frame. A built-in shape uses its
            first ones, all when left out; for a mesh, corners and edges are chosen, 9 when left out.
        gloss: gloss of a mesh, 0 (paper) to 1 (polished metal).
    """

    name: str
    shape: str | None = None
    mesh: Path | None = None
    landmarks: int | tuple[tuple[float, float, float], ...] | None = None
    gloss: float = 0.15


@dataclass(frozen=True)
class Cast:
    """Scenes that contain the same objects.

    Attributes:
        objects: their names; a name twice is two instances of that object.
        count: number of such scenes.
        seconds: length of each; the twin's when left out.
        moving: the first object is carried about and turned while it is filmed.
    """

    objects: tuple[str, ...]
    count: int = 1
    seconds: float | None = None
    moving: bool = False


@dataclass(frozen=True)
class TwinSpec:
    """A synthetic recording.

    Attributes:
        objects: names of built-in shapes (`twin.objects.OBJECTS`), or `Thing`s.
        scenes: number of videos, each with all objects; or a list of `Cast`s that says which objects are in
            how many. Each scene has other resting poses, another table, light and background.
        seconds: length of a video.
        rate_hz: frames per second that the camera takes.
        keep_hz: frames per second that are written, out of those; all when left out. A long orbit is cheap
            at 3.
        width, height: image size in pixels; the field of view stays that of a D435's colour camera.
        clicks_per_keypoint: in how many well-spread frames of a scene each visible keypoint is clicked.
        click_noise_px: standard deviation of a click, per axis.
        mistakes: clicks that are missing, swapped or on the background; none when left out.
        seed: seed of everything random.
        clutter: number of other things on the table.
        plain_room: table, floor and walls of one even colour each: nothing for a tracker to hold on to.
        sweep_deg: angle of the camera's orbit around the objects.
        distance_m, elevation_deg: bounds between which the camera moves.
        sensor: errors of the images; each effect has its own switch.
    """

    objects: tuple[str | Thing, ...] = ("carton", "kettle")
    scenes: int | tuple[Cast, ...] = 4
    seconds: float = 8.0
    rate_hz: float = 30.0
    keep_hz: float | None = None
    width: int = 640
    height: int = 480
    clicks_per_keypoint: int = 3
    click_noise_px: float = 2.0
    mistakes: Mistakes = Mistakes()
    seed: int = 0
    clutter: int = 5
    plain_room: bool = False
    sweep_deg: float = 160.0
    distance_m: tuple[float, float] = (0.6, 0.8)
    elevation_deg: tuple[float, float] = (30.0, 55.0)
    sensor: Sensor = field(default_factory=Sensor)

    @property
    def things(self) -> tuple[Thing, ...]:
        """The objects, including those given by name only."""
        return tuple(Thing(thing) if isinstance(thing, str) else thing for thing in self.objects)

    @property
    def casts(self) -> tuple[Cast, ...]:
        """The cast of each scene, one per scene."""
        if isinstance(self.scenes, int):
            return (Cast(tuple(thing.name for thing in self.things)),) * self.scenes
        return tuple(cast for cast in self.scenes for _ in range(cast.count))

    @property
    def scene_names(self) -> tuple[str, ...]:
        """00, 01, ..."""
        return tuple(f"{number:02d}" for number in range(len(self.casts)))

    def times_s(self, scene: int) -> Float64[np.ndarray, " frames"]:
        """Time of each frame of a scene, in whole microseconds, as associations.txt holds them."""
        length_s = self.casts[scene].seconds or self.seconds
        kept_hz = min(self.keep_hz or self.rate_hz, self.rate_hz)
        ticks = np.round(np.arange(round(length_s * kept_hz)) * self.rate_hz / kept_hz)
        return np.round(ticks / self.rate_hz, 6)

    def frames(self, scene: int) -> int:
        """Number of frames of a scene."""
        return len(self.times_s(scene))

    @property
    def lag_s(self) -> float:
        """Age of a depth image relative to its colour image."""
        return self.sensor.lag_frames / self.rate_hz

    @property
    def total_frames(self) -> int:
        """Number of frames of all scenes."""
        return sum(self.frames(scene) for scene in range(len(self.casts)))

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera: 55 degrees wide, as a D435's colour camera at 640 x 480 (f = 615 px)."""
        focal_px = 615.0 / 640.0 * self.width
        centre = (self.width - 1) / 2 + 0.01 * self.width, (self.height - 1) / 2 - 0.01 * self.height
        return Intrinsics(focal_px, focal_px, *centre, self.width, self.height)

    def check(self) -> None:
        """Refuse a spec that makes no recording, with a DataError that names the field."""
        names = [thing.name for thing in self.things]
        cast_names = {name for cast in self.casts for name in cast.objects}
        wrong = {
            "objects (name at least one, each once)": len(set(names)) != len(names) or not names,
            "objects (either `shape` or `mesh`)": any(thing.shape and thing.mesh for thing in self.things),
            "scenes (at least 1)": not self.casts,
            f"scenes (every object in at least one, and no other than {', '.join(names)})": bool(self.casts)
            and cast_names != set(names),
            "scenes (at least one object in each)": any(not cast.objects for cast in self.casts),
            "rate_hz, keep_hz (positive)": min(self.rate_hz, self.keep_hz or self.rate_hz) <= 0,
            "width, height (at least 16)": min(self.width, self.height) < 16,
            "clicks_per_keypoint (at least 1)": self.clicks_per_keypoint < 1,
            "click_noise_px (not negative)": self.click_noise_px < 0,
            "mistakes (shares, 0 to 1)": not all(0 <= share <= 1 for share in astuple(self.mistakes)),
            "seed (not negative)": self.seed < 0,
        }
        found = [name for name, bad in wrong.items() if bad]
        if not found and min(self.frames(scene) for scene in range(len(self.casts))) < 2:
            found = ["seconds x rate_hz or keep_hz (at least 2 frames)"]
        if found:
            raise DataError(f"this twin cannot be made; correct {', '.join(found)}; got {self}")
