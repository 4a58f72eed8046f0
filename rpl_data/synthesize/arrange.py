"""Put objects before a plate: which, from which side, and where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.directions import spread_directions
from rpl_data.geometry import Transform, rays, rigid
from rpl_data.raycast import PixelTable
from rpl_data.synthesize.render import Alone, Placed, alone
from rpl_data.synthesize.studio import Plate, Studio, Subject
from rpl_data.synthesize.views import MOST_UNSEEN, STANDING, is_shown, looking, standing

TRIES = 40
"""Draws of an object's pose before the image goes without it."""
CLOSER, FARTHER = 0.85, 1.2
"""Distances may differ from the recorded ones by these factors."""
APART = 0.5
"""Least distance of two objects, in lengths of the sum of their radii."""


def draw_objects(
    studio: Studio, names: Sequence[str], made: Mapping[str, int], rng: np.random.Generator
) -> list[str]:
    """Draw as many objects as a recorded image shows, those that were made least first."""
    count = min(int(rng.choice(studio.together)), len(names))
    order = rng.permutation(len(names))
    return [names[n] for n in sorted(order, key=lambda n: made[names[n]])][:count]


def arrange(
    studio: Studio,
    plate: Plate,
    table: PixelTable,
    names: Sequence[str],
    rng: np.random.Generator,
    skipped: Counter[str],
) -> list[tuple[str, Placed, Alone]]:
    """Place objects before a plate.

    Args:
        table: rays of the plate's camera.
        names: the objects to place; one that finds no place in `TRIES` draws is left out.
        skipped: counts why draws were dropped.
    """
    found: list[tuple[str, Placed, Alone]] = []
    for name in names:
        subject = studio.subjects[name]
        for _ in range(TRIES):
            pose = draw_pose(studio, subject, plate, rng)
            if pose is None:
                skipped["no room on the table"] += 1
                continue
            placed = Placed(subject.body, pose)
            if any(_touch(placed, other) for _, other, _ in found):
                skipped["in another object"] += 1
                continue
            seen = alone(table, placed)
            if seen is None or seen.unseen > MOST_UNSEEN:
                skipped["unseen surface"] += seen is not None
                continue
            found.append((name, placed, seen))
            break
    return found


def draw_pose(studio: Studio, subject: Subject, plate: Plate, rng: np.random.Generator) -> Transform | None:
    """Draw the pose of an object; None where it would be nearer or farther than it ever was."""
    share = studio.centres[int(rng.integers(len(studio.centres)))] + rng.normal(0, 0.03, 2)
    pixel = share.clip(0.03, 0.97) * [plate.camera.width - 1, plate.camera.height - 1]
    ray = rays(plate.camera, pixel[None])[0]
    rotation = draw_rotation(subject, plate.up, ray, rng)
    if rotation is None:
        return None
    near_m, far_m = CLOSER * subject.nearest_m, FARTHER * subject.farthest_m
    if plate.table is None:
        distance_m = rng.uniform(near_m, far_m)
        return rigid(rotation, ray / np.linalg.norm(ray) * distance_m)
    lowest_m = float((subject.body.hull @ rotation.T @ plate.table.normal).min())
    along = float(plate.table.normal @ ray)
    z_m = (plate.table.offset_m - lowest_m) / along if along < -1e-3 else -1.0
    if not near_m <= z_m * np.linalg.norm(ray) <= far_m:
        return None
    return rigid(rotation, ray * z_m)


def draw_rotation(
    subject: Subject,
    up_camera: Float64[np.ndarray, "3"],
    ray: Float64[np.ndarray, "3"],
    rng: np.random.Generator,
) -> Float64[np.ndarray, "3 3"] | None:
    """Draw how an object is turned to the camera; None where that shows what no camera saw."""
    up = subject.ups[int(rng.integers(len(subject.ups)))]
    if rng.uniform() < STANDING:
        rotation = standing(up, up_camera, rng.uniform(0, 2 * np.pi))
        towards = -rotation.T @ (ray / np.linalg.norm(ray))
        return rotation if is_shown(towards, subject.shown) else None
    if not subject.likely.any():
        return None
    view = spread_directions(len(subject.likely))[int(rng.choice(len(subject.likely), p=subject.likely))]
    turn = np.deg2rad(subject.turn_deg)
    return looking(view, up, ray, rng.uniform(-turn, turn))


def _touch(one: Placed, other: Placed) -> bool:
    """Whether two objects are nearer than their sizes allow."""
    apart = np.linalg.norm(one.camera_from_object[:3, 3] - other.camera_from_object[:3, 3])
    return bool(apart < APART * (one.body.radius_m + other.body.radius_m))
