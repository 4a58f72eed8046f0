"""Symmetries of an object as rigid transforms, in other frames, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import Transform, from_rotvec, invert, rigid, rotation_angle_rad, transform
from rpl_data.json_arrays import Json, each, matrix_from_json, number, numbers, taken
from rpl_data.types import DataError, Symmetries, SymmetryAxis, Turns

BOP_STEP = 0.01
"""Largest deviation between two steps of a continuous symmetry, as a part of the object's diameter."""


def symmetry_transforms(
    symmetries: Symmetries, *, max_deviation: float = BOP_STEP
) -> Float64[np.ndarray, "n 4 4"]:
    """List the rigid transforms after which the object looks the same; the identity is the first.

    With `camera_from_object` of a pose, `camera_from_object @ symmetry` looks the same for each of them. An
    axis of full rotation becomes equal steps, and every step is combined with every discrete symmetry, as
    `get_symmetry_transformations` of the bop_toolkit does.

    Args:
        symmetries: of the object, in the object frame, metres.
        max_deviation: how far a point at the object's edge moves from one step to the next at most, as a part
            of the diameter; 0.01 gives 315 steps.
    """
    discrete = [np.eye(4), *(np.reshape(values, (4, 4)) for values in symmetries.discrete)]
    steps = [step for axis in symmetries.continuous for step in _steps(axis, max_deviation)]
    return np.array([step @ fixed for fixed in discrete for step in steps or [np.eye(4)]])


def _steps(axis: SymmetryAxis, max_deviation: float) -> list[Transform]:
    count = math.ceil(math.pi / max_deviation)
    return [turn(axis, 2 * math.pi * number / count) for number in range(count)]


def turn(axis: SymmetryAxis, angle_rad: float) -> Transform:
    """Rotation of the object frame by an angle about an axis."""
    turned = from_rotvec(angle_rad * np.array(axis.direction), np.zeros(3))
    point = np.array(axis.point_m)
    return rigid(turned[:3, :3], point - turned[:3, :3] @ point)


SAME_TURN_DEG = 10.0
"""Axes are found to a degree or two; different turns of up to 12 about one axis are 30 degrees apart."""
MOST_TURNS = 60
"""Of solids without an axis of full rotation, the icosahedron has most."""


def symmetries_of(turns: Sequence[Turns]) -> Symmetries:
    """What leaves an object looking the same, from the equal turns about its axes.

    Turns about several axes are listed with all that follow from them: what looks the same after one turn and
    after another does so after both.

    Raises:
        DataError: ever more turns follow, which no object has.
    """
    given = [
        turn(one.axis, 2 * math.pi * step / one.turns)
        for one in turns
        if one.turns
        for step in range(1, one.turns)
    ]
    most = max((one.turns or 1 for one in turns), default=1)
    same_rad = min(math.radians(SAME_TURN_DEG), 0.4 * 2 * math.pi / most)
    discrete = _with_products(given, same_rad=same_rad, most=max(MOST_TURNS, 2 * most))
    return Symmetries(
        tuple(tuple(numbers(one)) for one in discrete),
        tuple(one.axis for one in turns if one.turns is None),
    )


def _with_products(given: Sequence[Transform], *, same_rad: float, most: int) -> list[Transform]:
    """The transforms and all their products but the identity, those given first.

    Two whose rotations differ by less than `same_rad` are one.
    """
    found = [np.eye(4)]
    for one in found:  # which grows meanwhile
        for by in given:
            made = by @ one
            if all(rotation_angle_rad(made[:3, :3].T @ other[:3, :3]) > same_rad for other in found):
                found.append(made)
        if len(found) > most:
            raise DataError(
                f"symmetry: turns about these axes would make an object look the same in more than {most} "
                "poses, so some axis is wrong: correct `symmetry` in the recipe, or confirm fewer axes by "
                "`rpl symmetry`"
            )
    return found[1:]


def moved_turns(turns: Sequence[Turns], other_from_object: Transform) -> tuple[Turns, ...]:
    """Express axes in another frame of the same object."""
    return tuple(Turns(moved_axis(one.axis, other_from_object), one.turns) for one in turns)


def moved_symmetries(symmetries: Symmetries, other_from_object: Transform) -> Symmetries:
    """Express symmetries in another frame of the same object."""
    object_from_other = invert(other_from_object)
    return Symmetries(
        discrete=tuple(
            tuple(numbers(other_from_object @ np.reshape(values, (4, 4)) @ object_from_other))
            for values in symmetries.discrete
        ),
        continuous=tuple(moved_axis(axis, other_from_object) for axis in symmetries.continuous),
    )


def moved_axis(axis: SymmetryAxis, other_from_object: Transform) -> SymmetryAxis:
    """Express an axis in another frame of the same object."""
    direction = other_from_object[:3, :3] @ np.array(axis.direction)
    return SymmetryAxis(_three(direction), _three(transform(other_from_object, np.array(axis.point_m))))


def _three(values: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def symmetries_to_json(symmetries: Symmetries, *, unit_m: float = 1.0) -> Json:
    """Write them with the keys of BOP's `models_info.json`; a key without symmetries is left out.

    Args:
        symmetries: in the object frame.
        unit_m: metres per unit of the translations and offsets written; 0.001 = millimetres.
    """
    factors = np.ones((4, 4))
    factors[:3, 3] = 1 / unit_m  # the translation alone has a unit
    discrete = [numbers(factors * np.reshape(values, (4, 4))) for values in symmetries.discrete]
    continuous = [axis_to_json(axis, unit_m=unit_m) for axis in symmetries.continuous]
    return ({"symmetries_discrete": discrete} if discrete else {}) | (
        {"symmetries_continuous": continuous} if continuous else {}
    )


def axis_to_json(axis: SymmetryAxis, *, unit_m: float = 1.0) -> Json:
    """Write an axis as BOP does: its direction, and a point on it."""
    return {"axis": list(axis.direction), "offset": [value / unit_m for value in axis.point_m]}


def symmetries_from_json(data: Json) -> Symmetries:
    """Read what `symmetries_to_json` wrote in metres; missing keys stand for none."""
    return Symmetries(
        discrete=tuple(
            tuple(numbers(matrix)) for matrix in each(matrix_from_json)(data.get("symmetries_discrete", []))
        ),
        continuous=each(axis_from_json)(data.get("symmetries_continuous", [])),
    )


def axis_from_json(data: Json) -> SymmetryAxis:
    """Read an axis; ValueError where it has no direction."""
    direction = np.array(taken(data, "axis", _vector))
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise ValueError("axis: its direction is 0, 0, 0")
    return SymmetryAxis(_three(direction / length), taken(data, "offset", _vector))


def _vector(values: Any) -> tuple[float, float, float]:
    x, y, z = each(number)(values)
    return x, y, z
