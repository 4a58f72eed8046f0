"""Convert the records of `types` to JSON-ready dictionaries and back; nothing here touches a file.

Matrices are row-major lists; NaN (a keypoint without a position) becomes null.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import cast, get_args

import numpy as np

from rpl_data.json_arrays import (
    Json,
    asdict_values,
    each,
    flag,
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
from rpl_data.types import (
    Box,
    Click,
    ClickResidual,
    FrameLabel,
    InstanceLabel,
    KeypointModel,
    NextClick,
    Rle,
    Solution,
    SquareBox,
    Statement,
    StatementKind,
)
from rpl_data.untrusted.rle import pixels_of_rle


def solution_to_json(solution: Solution) -> Json:
    """Convert a solution; each covariance becomes a row of 9 numbers per keypoint."""
    model = solution.model
    return {
        "object": model.name,
        "keypoints": list(model.keypoints),
        "skeleton": [list(pair) for pair in model.skeleton],
        "points_object": rows_to_json(model.points_object),
        "covariance": rows_to_json(solution.covariance.reshape(-1, 9)),
        "scene_from_object": {name: numbers(matrix) for name, matrix in solution.scene_from_object.items()},
        "residuals": [asdict(residual) for residual in solution.residuals],
        "warnings": list(solution.warnings),
        "covariance_in_scene": {
            name: rows_to_json(found.reshape(-1, 9)) for name, found in solution.covariance_in_scene.items()
        },
        "trajectory_sigma_m": dict(solution.trajectory_sigma_m),
        "click_sigma_px": solution.click_sigma_px,
        "depth_sigma_ratio": solution.depth_sigma_ratio,
        "next_clicks": [asdict(click) for click in solution.next_clicks],
        "statements": [asdict(statement) for statement in solution.statements],
        "one_side": list(solution.one_side),
        "checked": solution.checked,
    }


def solution_from_json(data: Json) -> Solution:
    """Convert what `solution_to_json` returned back to a solution.

    Files of older versions lack the noise and what follows from it.
    """
    keypoints = taken(data, "keypoints", each(text))
    model = KeypointModel(
        name=taken(data, "object", text),
        keypoints=keypoints,
        points_object=taken(data, "points_object", lambda rows: rows_from_json(rows, 3)),
        skeleton=tuple((a, b) for a, b in taken(data, "skeleton", each(each(whole)))),
    )
    covariance = taken(data, "covariance", lambda rows: rows_from_json(rows, 9)).reshape(-1, 3, 3)
    if not len(keypoints) == len(model.points_object) == len(covariance):
        raise ValueError("keypoints, points_object and covariance are not equally many")
    if any(not 0 <= end < len(keypoints) for pair in model.skeleton for end in pair):
        raise ValueError("skeleton: it names a keypoint that is not there")
    one_side = each(whole)(data.get("one_side", []))
    if any(not 0 <= k < len(keypoints) for k in one_side):
        raise ValueError("one_side: it names a keypoint that is not there")
    return Solution(
        model=model,
        covariance=covariance,
        scene_from_object={
            name: taken(data["scene_from_object"], name, matrix_from_json)
            for name in taken(data, "scene_from_object", dict)
        },
        residuals=taken(data, "residuals", each(residual_from_json)),
        warnings=taken(data, "warnings", each(text)),
        covariance_in_scene={
            name: rows_from_json(rows, 9).reshape(-1, 3, 3)
            for name, rows in data.get("covariance_in_scene", {}).items()
        },
        trajectory_sigma_m={
            name: number(sigma_m) for name, sigma_m in data.get("trajectory_sigma_m", {}).items()
        },
        click_sigma_px=optional(number)(data.get("click_sigma_px")),
        depth_sigma_ratio=optional(number)(data.get("depth_sigma_ratio")),
        statements=each(statement_from_json)(data.get("statements", [])),
        next_clicks=each(next_click_from_json)(data.get("next_clicks", [])),
        one_side=one_side,
        checked=flag(data.get("checked", True)),
    )


def statement_from_json(data: Json) -> Statement:
    """Convert the dictionary of a statement back."""
    return Statement(
        taken(data, "kind", _statement_kind),
        taken(data, "clicks", each(_click_from_json)),
        taken(data, "text", text),
        taken(data, "evidence", number),
    )


def _statement_kind(value: object) -> StatementKind:
    for kind in get_args(StatementKind):
        if kind == value:
            return cast(StatementKind, kind)
    raise ValueError(f"{value!r:.60} is no kind of statement")


def next_click_from_json(data: Json) -> NextClick:
    """Convert the dictionary of a further click back."""
    return NextClick(
        taken(data, "scene", text),
        taken(data, "frame", whole),
        taken(data, "keypoint", whole),
        taken(data, "gain_mm", number),
        taken(data, "left_mm", number),
    )


def residual_from_json(data: Json) -> ClickResidual:
    """Convert the dictionary of a click's residual back."""
    click = taken(data, "click", _click_from_json)
    numbers = {name: taken(data, name, optional(number)) for name in ("error_m", "depth_m")}
    taken(data, "error_px", number)
    taken(data, "outlier", flag)
    return ClickResidual(**data | numbers | {"click": click})


def _click_from_json(data: Json) -> Click:
    return Click(
        taken(data, "object", text),
        taken(data, "keypoint", whole),
        taken(data, "scene", text),
        taken(data, "frame", whole),
        taken(data, "u_px", number),
        taken(data, "v_px", number),
    )


def frame_label_to_json(label: FrameLabel) -> Json:
    """Convert the labels of one frame to the content of one line of `labels/<scene>.jsonl`."""
    return {
        "scene": label.scene,
        "frame": label.frame,
        "timestamp_s": label.timestamp_s,
        "instances": [_instance_to_json(instance) for instance in label.instances],
    }


def frame_label_from_json(data: Json) -> FrameLabel:
    """Convert what `frame_label_to_json` returned back to a label."""
    return FrameLabel(
        taken(data, "scene", text),
        taken(data, "frame", whole),
        taken(data, "timestamp_s", number),
        taken(data, "instances", each(_instance_from_json)),
    )


def _instance_to_json(instance: InstanceLabel) -> Json:
    return {
        "object": instance.object,
        "camera_from_object": numbers(instance.camera_from_object, 9),
        "keypoints_px": rows_to_json(instance.keypoints_px, 3),
        "visible": [int(v) for v in instance.visibility],
        "sigma_px": [round(float(s), 3) if math.isfinite(s) else None for s in instance.sigma_px],
        "square_box": numbers(np.array(asdict_values(instance.square_box)), 3),
        "box": None if instance.box is None else list(instance.box),
        "box_full": list(instance.box_full),
        "mask": instance.mask,
        "mask_full": instance.mask_full,
        "visib_fract": round(instance.visib_fract, 4),
        "truncated": instance.truncated,
        "quality": round(instance.quality, 4),
        "corrected_px": None if instance.corrected_px is None else round(instance.corrected_px, 3),
        **({"instance": instance.instance} if instance.instance else {}),
    }


def _instance_from_json(data: Json) -> InstanceLabel:
    label = InstanceLabel(
        object=taken(data, "object", text),
        camera_from_object=taken(data, "camera_from_object", matrix_from_json),
        keypoints_px=taken(data, "keypoints_px", lambda rows: rows_from_json(rows, 2)),
        visibility=np.array(taken(data, "visible", each(whole)), dtype=np.int64),
        sigma_px=np.array([math.nan if s is None else number(s) for s in data["sigma_px"]], dtype=float),
        square_box=SquareBox(*taken(data, "square_box", each(number))),
        box=taken(data, "box", optional(_box_from_json)),
        box_full=taken(data, "box_full", _box_from_json),
        mask=taken(data, "mask", _rle_from_json),
        mask_full=taken(data, "mask_full", _rle_from_json),
        visib_fract=taken(data, "visib_fract", number),
        truncated=taken(data, "truncated", flag),
        quality=taken(data, "quality", number),
        corrected_px=optional(number)(data.get("corrected_px")),
        instance=text(data.get("instance", "")),
    )
    if not len(label.keypoints_px) == len(label.visibility) == len(label.sigma_px):
        raise ValueError("keypoints_px, visible and sigma_px are not equally many")
    return label


def _box_from_json(values: list[float]) -> Box:
    left, top, right, bottom = each(number)(values)
    return left, top, right, bottom


def _rle_from_json(data: Json) -> Rle:
    """A packed mask; ValueError where its runs are not those of an image of its size."""
    height, width = taken(data, "size", each(whole))
    counts = taken(data, "counts", text)
    if pixels_of_rle(counts) != height * width or min(height, width) < 0:
        raise ValueError(f"counts: they are not those of {width} x {height} pixels")
    return {"size": [height, width], "counts": counts}
