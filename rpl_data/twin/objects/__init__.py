"""The objects of a twin: built-in shapes, each hard in its own way, and textured meshes from files."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from rpl_data.twin.objects.bottle import bottle
from rpl_data.twin.objects.bracket import bracket
from rpl_data.twin.objects.carton import carton
from rpl_data.twin.objects.cup import cup
from rpl_data.twin.objects.drill import drill
from rpl_data.twin.objects.junction_box import junction_box
from rpl_data.twin.objects.kettle import kettle
from rpl_data.twin.objects.mesh_file import object_of_file
from rpl_data.twin.objects.model import TwinObject, spread_order, with_landmarks
from rpl_data.twin.spec import Thing
from rpl_data.types import DataError

__all__ = ["OBJECTS", "TwinObject", "build", "spread_order"]

OBJECTS: dict[str, Callable[[], TwinObject]] = {
    "carton": carton,
    "kettle": kettle,
    "bottle": bottle,
    "drill": drill,
    "cup": cup,
    "bracket": bracket,
    "junction_box": junction_box,
}
"""The built-in shapes."""


@lru_cache(maxsize=32)
def build(thing: str | Thing) -> TwinObject:
    """Build the object: a `Thing`, or a built-in shape by its name.

    Raises:
        DataError: no such shape, no such mesh, or more landmarks asked for than there are.
    """
    thing = Thing(thing) if isinstance(thing, str) else thing
    if thing.mesh is not None:
        landmarks = 9 if thing.landmarks is None else thing.landmarks
        return object_of_file(thing.name, thing.mesh, landmarks, gloss=thing.gloss)
    shape = thing.shape or thing.name
    if shape not in OBJECTS:
        raise DataError(
            f"there is no twin object {shape!r}; expected one of {', '.join(OBJECTS)}, or give its `mesh:`"
        )
    one = OBJECTS[shape]()
    if thing.landmarks is None:
        return one.renamed(thing.name)
    if not isinstance(thing.landmarks, int):
        raise DataError(f"twin object {thing.name} has its own landmarks; give a number, not positions")
    return with_landmarks(one, thing.landmarks).renamed(thing.name)
