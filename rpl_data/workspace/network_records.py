"""Convert what networks saw to JSON-ready dictionaries and back; nothing here touches a file."""

from __future__ import annotations

from collections.abc import Mapping

from rpl_data.json_arrays import (
    Json,
    each,
    matrix_from_json,
    number,
    numbers,
    optional,
    rows_from_json,
    rows_to_json,
    taken,
    text,
    whole,
)
from rpl_data.types import NetworkView


def network_views_to_json(views: Mapping[str, NetworkView]) -> Json:
    """Convert what networks saw of an object, by scene."""
    return {
        scene: {
            "looked": one.looked,
            "found": one.found,
            "frames": list(one.frames),
            "off_m": list(one.off_m),
            "scene_from_object": None if one.scene_from_object is None else numbers(one.scene_from_object),
            "points_object": rows_to_json(one.points_object),
            "network": one.network,
        }
        for scene, one in views.items()
    }


def network_views_from_json(data: Json) -> dict[str, NetworkView]:
    """Convert what `network_views_to_json` returned back."""
    return {
        scene: NetworkView(
            taken(one, "looked", whole),
            taken(one, "found", whole),
            taken(one, "frames", each(whole)),
            taken(one, "off_m", each(number)),
            taken(one, "scene_from_object", optional(matrix_from_json)),
            taken(one, "points_object", lambda rows: rows_from_json(rows, 3)),
            taken(one, "network", text),
        )
        for scene, one in data.items()
    }
