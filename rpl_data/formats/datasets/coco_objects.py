"""The objects of our dialect of COCO: categories, and what the extra key `rpl` says of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rpl_data.geometry import Transform
from rpl_data.json_arrays import Json, matrix_from_json, numbers, optional, rows_from_json, rows_to_json
from rpl_data.symmetries import symmetries_from_json, symmetries_to_json
from rpl_data.types import KeypointModel, Symmetries


@dataclass(frozen=True)
class CocoObject:
    """An object as described in the file.

    Attributes:
        mesh: path of its mesh, relative to the JSON file's folder; None when there is none.
        symmetries: what leaves the object looking the same; `symmetry_transforms` lists it.
        grasp: `object_from_grasp` where the user marked one: z out of the surface, x along it.
        frame: `frame_from_object`: where the file's object frame is not that of the workspace, this takes
            points from the workspace's to the file's.
    """

    model: KeypointModel
    mesh: str | None = None
    symmetries: Symmetries = Symmetries()
    grasp: Transform | None = None
    frame: Transform | None = None


def category_to_coco(number: int, model: KeypointModel) -> Json:
    """Make the category of an object; `number` is its id."""
    return {
        "id": number,
        "name": model.name,
        "supercategory": "object",
        "keypoints": list(model.keypoints),
        "skeleton": [[a + 1, b + 1] for a, b in model.skeleton],  # COCO counts from 1 here
    }


def object_to_coco(number: int, item: CocoObject) -> Json:
    """Make the entry of an object in the extra key `rpl`."""
    return {
        "name": item.model.name,
        "category_id": number,
        "points_object": rows_to_json(item.model.points_object),
        "mesh": item.mesh,
        **symmetries_of_entry(item.symmetries),
        **({} if item.frame is None else {"frame_from_object": numbers(item.frame)}),
        **({} if item.grasp is None else {"object_from_grasp": numbers(item.grasp)}),
    }


def symmetries_of_entry(symmetries: Symmetries) -> Json:
    """The keys of an entry that say how an object is symmetric."""
    found = symmetries_to_json(symmetries)
    return {"symmetries": found.pop("symmetries_discrete", []), **found}


def symmetries_of_object(described: Json) -> Symmetries:
    """Read these keys."""
    return symmetries_from_json(described | {"symmetries_discrete": described["symmetries"]})


def objects_from_coco(data: Mapping[str, Any]) -> list[CocoObject]:
    """Read the objects of a file, in the order of their category ids."""
    described = {item["category_id"]: item for item in data["rpl"]["objects"]}
    categories = sorted(data["categories"], key=lambda category: int(category["id"]))
    return [_object_from_coco(category, described[category["id"]]) for category in categories]


def _object_from_coco(category: Json, described: Json) -> CocoObject:
    model = KeypointModel(
        name=category["name"],
        keypoints=tuple(category["keypoints"]),
        points_object=rows_from_json(described["points_object"], 3),
        skeleton=tuple((a - 1, b - 1) for a, b in category["skeleton"]),
    )
    return CocoObject(
        model,
        mesh=described["mesh"],
        symmetries=symmetries_of_object(described),
        grasp=optional(matrix_from_json)(described.get("object_from_grasp")),
        frame=optional(matrix_from_json)(described.get("frame_from_object")),
    )
