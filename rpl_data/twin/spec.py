"""What a twin is made of: one frozen dataclass, writable as YAML."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from rpl_data.twin.sensor import ColorSensor, DepthSensor
from rpl_data.types import DataError, Intrinsics


@dataclass(frozen=True)
class TwinSpec:
    """A synthetic recording.

    Attributes:
        objects: names from `twin.objects.OBJECTS`; all of them stand in every scene.
        scenes: how many videos; each has other resting poses, another support, light and background.
        seconds: length of a video.
        rate_hz: frames a second.
        width, height: image size in pixels; the field of view stays that of a D435's colour camera.
        clicks_per_keypoint: in how many well-spread frames of a scene each seen keypoint is clicked.
        click_noise_px: standard deviation of a click, each axis.
        seed: of everything random.
        clutter: other things on the table.
        sweep_deg: how far around the objects the camera goes.
        distance_m, elevation_deg: bounds between which the camera wanders.
        depth_sensor, color_sensor: errors of the images.
    """

    objects: tuple[str, ...] = ("carton", "kettle")
    scenes: int = 4
    seconds: float = 8.0
    rate_hz: float = 30.0
    width: int = 640
    height: int = 480
    clicks_per_keypoint: int = 3
    click_noise_px: float = 2.0
    seed: int = 0
    clutter: int = 5
    sweep_deg: float = 160.0
    distance_m: tuple[float, float] = (0.6, 0.8)
    elevation_deg: tuple[float, float] = (30.0, 55.0)
    depth_sensor: DepthSensor = field(default_factory=DepthSensor)
    color_sensor: ColorSensor = field(default_factory=ColorSensor)

    @property
    def frames(self) -> int:
        """Frames of a video."""
        return round(self.seconds * self.rate_hz)

    @property
    def times_s(self) -> Float64[np.ndarray, " frames"]:
        """Time of each frame, whole microseconds as associations.txt holds them."""
        return np.round(np.arange(self.frames) / self.rate_hz, 6)

    @property
    def scene_names(self) -> tuple[str, ...]:
        """00, 01, ..."""
        return tuple(f"{number:02d}" for number in range(self.scenes))

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera: 55 degrees wide, as a D435's colour camera at 640 x 480 (f = 615 px)."""
        focal_px = 615.0 / 640.0 * self.width
        centre = (self.width - 1) / 2 + 0.01 * self.width, (self.height - 1) / 2 - 0.01 * self.height
        return Intrinsics(focal_px, focal_px, *centre, self.width, self.height)

    def check(self) -> None:
        """Refuse what makes no recording; DataError names the field."""
        wrong = {
            "objects (name at least one, each once)": len(set(self.objects)) != len(self.objects)
            or not self.objects,
            "scenes (at least 1)": self.scenes < 1,
            "seconds x rate_hz (at least 2 frames)": self.frames < 2,
            "width, height (at least 16)": min(self.width, self.height) < 16,
            "clicks_per_keypoint (at least 1)": self.clicks_per_keypoint < 1,
            "click_noise_px (not negative)": self.click_noise_px < 0,
            "seed (not negative)": self.seed < 0,
        }
        found = [name for name, bad in wrong.items() if bad]
        if found:
            raise DataError(f"this twin cannot be made; correct {', '.join(found)}; got {self}")
