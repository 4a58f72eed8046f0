"""Compose a scene of a twin on a table. The table frame has z up and z = 0 on the table's top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from rpl_data.geometry import Transform, rigid
from rpl_data.twin import surfaces, textures
from rpl_data.twin.light import TO_LINEAR, Light
from rpl_data.twin.objects import TwinObject
from rpl_data.twin.resting import resting_rotations
from rpl_data.twin.surfaces import Surface

TABLE_SIZE_M = (1.10, 0.80, 0.03)
FLOOR_M = -0.74
ROOM_M = 5.0


@dataclass(frozen=True)
class TwinScene:
    """Everything that the renderer needs of a scene.

    Attributes:
        surfaces: surfaces in the table frame; the objects come first, in order.
        table_from_object: pose of each object.
        target_m: the point that the camera looks at.
    """

    surfaces: tuple[Surface, ...]
    table_from_object: tuple[Transform, ...]
    light: Light
    target_m: Float64[np.ndarray, "3"]


def compose(
    objects: Sequence[TwinObject],
    *,
    rng: np.random.Generator,
    number: int,
    turns: Sequence[int],
    clutter: int,
    plain: bool = False,
) -> TwinScene:
    """Put objects at rest on a table; the table changes with `number`, resting poses with `turns`.

    Args:
        turns: in how many earlier scenes each object stood.
        clutter: number of other things on the table.
        plain: table, floor and walls without texture.
    """
    positions = _positions(rng, [_footprint_m(o.surface.vertices) for o in objects])
    poses = [_placed(rng, *each) for each in zip(objects, positions, turns, strict=True)]
    things = [thing.surface.moved(pose) for thing, pose in zip(objects, poses, strict=True)]
    taken = [(pose[:2, 3], _footprint_m(thing.vertices)) for pose, thing in zip(poses, things, strict=True)]
    for _ in range(clutter):
        things.extend(_clutter(rng, taken))
    furniture = _furniture(rng, number, plain=plain)
    light = _light(rng, furniture[0])
    centre = np.concatenate([thing.vertices for thing in things[: len(objects)]])
    target = (centre.min(axis=0) + centre.max(axis=0)) / 2
    return TwinScene((*things, *furniture), tuple(poses), light, target)


def carried(scene: TwinScene, share: float) -> TwinScene:
    """The scene after a share (0 to 1) of its time: a hand that nobody sees carries its first object.

    It is lifted, taken some centimetres about, tilted and turned, and set down elsewhere.
    """
    start = scene.table_from_object[0]
    turn = Rotation.from_rotvec(
        [0.35 * np.sin(2 * np.pi * share), 0.25 * np.sin(3 * np.pi * share), 1.2 * np.sin(np.pi * share)]
    )
    shift = np.array([0.06 * np.sin(2 * np.pi * share), 0.05 * share, 0.07 * np.sin(np.pi * share)])
    middle = scene.surfaces[0].vertices.mean(axis=0)
    move = rigid(turn.as_matrix(), middle + shift - turn.as_matrix() @ middle)
    return replace(
        scene,
        surfaces=(scene.surfaces[0].moved(move), *scene.surfaces[1:]),
        table_from_object=(move @ start, *scene.table_from_object[1:]),
    )


def _light(rng: np.random.Generator, table: Surface) -> Light:
    """A warm lamp over the table, a window on some side, and the light that the table reflects."""
    turn, rise = rng.uniform(0, 2 * np.pi), rng.uniform(0.25, 0.6)
    day = rng.uniform(0.1, 0.35)
    return Light(
        position_m=np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(1.3, 1.8)]),
        radius_m=rng.uniform(0.06, 0.16),
        strength=rng.uniform(0.85, 1.05) - 1.2 * day,
        ambient=rng.uniform(0.25, 0.38),
        color=np.array([1.0, rng.uniform(0.90, 1.0), rng.uniform(0.72, 0.98)]),
        window=np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)]),
        daylight=day,
        below=TO_LINEAR[table.texture[::8, ::8]].mean(axis=(0, 1)).astype(float),
    )


# Placing ------------------------------------------------------------------------------------------


def _footprint_m(vertices: Float64[np.ndarray, "n 3"]) -> float:
    """Radius around the mean vertex of the space a thing needs, whichever way it lies."""
    return float(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max())


def _positions(rng: np.random.Generator, radii_m: Sequence[float]) -> list[Float64[np.ndarray, "2"]]:
    """Positions on the table: one in the middle, or several on a circle without touching."""
    if len(radii_m) == 1:
        return [rng.uniform(-0.03, 0.03, 2)]
    closest_m = sum(sorted(radii_m)[-2:]) + 0.01
    circle_m = closest_m / (2 * np.sin(np.pi / len(radii_m)))
    angles = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(len(radii_m)) / len(radii_m)
    return [circle_m * np.array([np.cos(angle), np.sin(angle)]) for angle in angles]


def _placed(
    rng: np.random.Generator, thing: TwinObject, position: Float64[np.ndarray, "2"], turn: int
) -> Transform:
    """`table_from_object` with a resting pose that changes from turn to turn, and a random heading."""
    choices = resting_rotations(thing.surface.vertices)[:6]
    heading = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).as_matrix()
    rotation = heading @ choices[turn % len(choices)]
    turned = thing.surface.vertices @ rotation.T
    middle = turned.mean(axis=0)
    return rigid(rotation, np.array([position[0] - middle[0], position[1] - middle[1], -turned[:, 2].min()]))


def _clutter(rng: np.random.Generator, taken: list[tuple[Float64[np.ndarray, "2"], float]]) -> list[Surface]:
    """A book, a tin or a ball where nothing stands yet; empty when no free position was found."""
    for _ in range(40):
        position = rng.uniform(-1, 1, 2) * (np.array(TABLE_SIZE_M[:2]) / 2 - 0.1)
        size_m = rng.uniform(0.04, 0.075)
        if all(np.linalg.norm(position - centre) > size_m * 1.3 + radius + 0.02 for centre, radius in taken):
            taken.append((position, size_m * 1.3))
            return [_thing(rng, size_m).moved(rigid(_heading(rng), np.array([*position, 0.0])))]
    return []


def _heading(rng: np.random.Generator) -> Float64[np.ndarray, "3 3"]:
    matrix: Float64[np.ndarray, "3 3"] = Rotation.from_euler(
        "z", rng.uniform(0, 360), degrees=True
    ).as_matrix()
    return matrix


def _thing(rng: np.random.Generator, size_m: float) -> Surface:
    """A thing that stands on z = 0 with its axis at x = y = 0, within `size_m` of that axis."""
    image = textures.print_of(rng, 320, 320)
    kind = rng.choice(["book", "tin", "ball"])
    if kind == "book":
        height = rng.uniform(0.02, 0.05)
        part = surfaces.joined(
            surfaces.box((size_m * 2, size_m * 1.4, height), [surfaces.WHOLE] * 6, cells=1, gloss=0.05), image
        )
        return replace(part, vertices=part.vertices + [0, 0, height / 2])
    if kind == "tin":
        r, top = size_m * 0.6, rng.uniform(0.06, 0.12)
        profiles = [[(0.0, top), (r, top)], [(r, top), (r, 0.0)]]
        return surfaces.joined([surfaces.patch(surfaces.lathe_grid(p), gloss=0.2) for p in profiles], image)
    angle = np.linspace(0, np.pi, 24)
    r = size_m * 0.6
    profile = np.stack([r * np.sin(angle), r + r * np.cos(angle)], -1)
    return surfaces.joined([surfaces.patch(surfaces.lathe_grid(profile.tolist()), gloss=0.1)], image)


# Furniture ----------------------------------------------------------------------------------------


def _furniture(rng: np.random.Generator, number: int, *, plain: bool) -> list[Surface]:
    """The table, the floor and four walls."""
    names = list(textures.SUPPORTS)
    top = textures.even(rng) if plain else textures.SUPPORTS[names[number % len(names)]](rng)
    below = (0.0, 0.0, -TABLE_SIZE_M[2] / 2)
    slab = surfaces.box(TABLE_SIZE_M, [surfaces.WHOLE] * 6, centre_m=below, cells=1, gloss=0.05)
    table = surfaces.joined(slab, top)
    h = ROOM_M / 2
    floor = surfaces.quad([(-h, h, FLOOR_M), (h, h, FLOOR_M), (-h, -h, FLOOR_M), (h, -h, FLOOR_M)], cells=1)
    covering = textures.tiles if rng.random() < 0.5 else textures.wood
    floor_texture, paint = (textures.even, textures.even) if plain else (covering, textures.plaster)
    walls = [_wall(turn, h) for turn in range(4)]
    return [table, surfaces.joined([floor], floor_texture(rng)), surfaces.joined(walls, paint(rng))]


def _wall(turn: int, half_m: float) -> Surface:
    """A wall of the room, seen from inside."""
    z0, z1 = FLOOR_M, FLOOR_M + 2.6
    corners = np.array(
        [(-half_m, half_m, z1), (half_m, half_m, z1), (-half_m, half_m, z0), (half_m, half_m, z0)]
    )
    quarter = Rotation.from_euler("z", 90 * turn, degrees=True).as_matrix()
    return surfaces.quad((corners @ quarter.T).tolist(), cells=1)
