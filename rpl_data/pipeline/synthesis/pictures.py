"""One rendered image with its labels, drawn from a seed and its number alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from rpl_data.geometry import resized
from rpl_data.images import read_pixels
from rpl_data.pipeline.synthesis.labels import rendered_label
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.arrange import arrange, draw_objects
from rpl_data.synthesize.compose import depth_over, laid_over, shadowed
from rpl_data.synthesize.light import draw_lights
from rpl_data.synthesize.render import draw, finer_table
from rpl_data.synthesize.studio import Plate, Studio
from rpl_data.types import ColorImage, DataError, DepthUnits, InstanceLabel, Intrinsics


@dataclass(frozen=True)
class Picture:
    """A rendered image.

    Attributes:
        depth: in the plate's unit; None where the plate has none.
        skipped: how often a draw was dropped, by the reason.
    """

    plate: Plate
    color: ColorImage
    depth: DepthUnits | None
    instances: tuple[InstanceLabel, ...]
    skipped: Counter[str]


@lru_cache(maxsize=4)
def tables(camera: Intrinsics) -> tuple[PixelTable, PixelTable]:
    """Rays through the pixels of a camera, and through the finer grid that colours are drawn on."""
    return PixelTable.of(camera), finer_table(camera)


def picture(
    studio: Studio,
    names: Sequence[str],
    number: int,
    *,
    seed: int,
    made: Counter[str],
    width_px: int | None = None,
) -> Picture:
    """Render an image.

    Args:
        names: objects that may be in it.
        number: of the image; with the seed it fixes everything that is drawn at random.
        made: instances of each object in the images before.
        width_px: width of the image; that of the plate when left out.

    Raises:
        DataError: the plate cannot be read.
    """
    rng = np.random.default_rng((seed, number))
    plate = _sized(studio.plates[int(rng.integers(len(studio.plates)))], width_px)
    table, finer = tables(plate.camera)
    skipped: Counter[str] = Counter()
    objects = arrange(studio, plate, table, draw_objects(studio, names, made, rng), rng, skipped)
    lights = draw_lights({name: studio.subjects[name].lights for name in names}, plate.up, rng)
    placed = [each for _, each, _ in objects]
    background = shadowed(plate_color(plate), table, placed, plate.table, lights[names[0]])
    color = laid_over(background, draw(finer, placed, lights), studio.noise, rng)
    depth = None
    if plate.depth is not None and plate.metres_per_unit is not None:
        behind_m = plate_depth(plate).astype(np.float32) * np.float32(plate.metres_per_unit)
        seen = [(alone, studio.noise.depth[name]) for name, _, alone in objects]
        depth_m = depth_over(behind_m, seen, rng)
        depth = (depth_m / plate.metres_per_unit).round().clip(0, np.iinfo(np.uint16).max).astype(np.uint16)
    instances = tuple(rendered_label(table, each, objects, studio.subjects[each[0]]) for each in objects)
    return Picture(plate, color, depth, instances, skipped)


def _sized(plate: Plate, width_px: int | None) -> Plate:
    """The plate with the camera of the smaller or larger image."""
    if width_px is None or width_px == plate.camera.width:
        return plate
    height_px = max(1, round(plate.camera.height * width_px / plate.camera.width))
    return replace(plate, camera=resized(plate.camera, width=width_px, height=height_px))


def plate_color(plate: Plate) -> ColorImage:
    """The picture behind the objects, as large as its camera says."""
    image = read_pixels(plate.color)
    if image is None:
        raise DataError(f"cannot read {plate.color}: it is missing or damaged; give --again true")
    size = (plate.camera.width, plate.camera.height)
    if image.shape[1::-1] == size:
        return image
    way = cv2.INTER_AREA if size[0] < image.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=way))


def plate_depth(plate: Plate) -> DepthUnits:
    """The depth behind the objects in the plate's unit, as large as its camera says."""
    file: Path = plate.depth  # type: ignore[assignment]
    units = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if units is None:
        raise DataError(f"cannot read {file}: it is missing or damaged; give --again true")
    size = (plate.camera.width, plate.camera.height)
    # Not INTER_NEAREST, which takes the upper left of the pixels, half of one off their middle.
    return np.asarray(cv2.resize(units, size, interpolation=cv2.INTER_NEAREST_EXACT))
