"""Convert placements to JSON-ready dictionaries and back; nothing here touches a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import cast, get_args

from rpl_data.json_arrays import (
    Json,
    each,
    matrix_from_json,
    number,
    numbers,
    rows_from_json,
    rows_to_json,
    taken,
    text,
)
from rpl_data.types import PlacedHow, Placement
from rpl_data.workspace.records import next_click_from_json, residual_from_json, statement_from_json


def placements_to_json(placements: Mapping[str, Placement]) -> Json:
    """Convert the placements of an object, by scene; each covariance becomes a row of 9 numbers."""
    return {
        scene: {
            "how": one.how,
            "checked": one.checked,
            "scene_from_object": numbers(one.scene_from_object),
            "points_object": rows_to_json(one.points_object),
            "covariance_in_scene": rows_to_json(one.covariance_in_scene.reshape(-1, 9)),
            "residuals": [asdict(residual) for residual in one.residuals],
            "path_key": one.path_key,
            "trajectory_sigma_m": one.trajectory_sigma_m,
            "statements": [asdict(statement) for statement in one.statements],
            "next_clicks": [asdict(click) for click in one.next_clicks],
        }
        for scene, one in placements.items()
    }


def placements_from_json(data: Json) -> dict[str, Placement]:
    """Convert what `placements_to_json` returned back."""
    return {scene: taken(data, scene, _placement) for scene in data}


def _placement(data: Json) -> Placement:
    points = taken(data, "points_object", lambda rows: rows_from_json(rows, 3))
    covariance = taken(data, "covariance_in_scene", lambda rows: rows_from_json(rows, 9)).reshape(-1, 3, 3)
    if len(points) != len(covariance):
        raise ValueError("points_object and covariance_in_scene are not equally many")
    return Placement(
        scene_from_object=taken(data, "scene_from_object", matrix_from_json),
        points_object=points,
        covariance_in_scene=covariance,
        residuals=taken(data, "residuals", each(residual_from_json)),
        how=taken(data, "how", _how),
        checked=taken(data, "checked", text),
        path_key=taken(data, "path_key", text),
        trajectory_sigma_m=taken(data, "trajectory_sigma_m", number),
        statements=taken(data, "statements", each(statement_from_json)),
        next_clicks=taken(data, "next_clicks", each(next_click_from_json)),
    )


def _how(value: object) -> PlacedHow:
    for how in get_args(PlacedHow):
        if how == value:
            return cast(PlacedHow, how)
    raise ValueError(f"{value!r:.60} is no way to place an object")
