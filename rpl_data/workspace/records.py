"""Convert the records of `types` to JSON-ready dictionaries and back; nothing here touches a file.

Matrices are row-major lists; NaN (a keypoint without a position) becomes null.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path

import numpy as np

from rpl_data.json_arrays import Json, asdict_values, matrix_from_json, numbers, rows_from_json, rows_to_json
from rpl_data.types import (
    Click,
    ClickResidual,
    DepthWarp,
    Frame,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    NextClick,
    Recording,
    Scene,
    Solution,
    SquareBox,
    Statement,
)


def recording_to_json(recording: Recording) -> Json:
    """Convert a recording, without its trajectory, to a dictionary."""
    scene = recording.scene
    return {
        "name": scene.name,
        "source": scene.source,
        "intrinsics": asdict(scene.intrinsics) | {"distortion": list(scene.intrinsics.distortion)},
        "metres_per_unit": scene.metres_per_unit,
        "registered": scene.registered,
        "no_depth_units": list(scene.no_depth_units),
        "depth_warp": None if scene.depth_warp is None else asdict(scene.depth_warp),
        "skipped": list(recording.skipped),
        "notes": list(recording.notes),
        "frames": [
            {
                "index": frame.index,
                "timestamp_s": frame.timestamp_s,
                "color": str(frame.color),
                "depth": None if frame.depth is None else str(frame.depth),
            }
            for frame in scene.frames
        ],
    }


def recording_from_json(data: Json) -> Recording:
    """Convert what `recording_to_json` returned back to a recording, without a trajectory."""
    intrinsics = Intrinsics(**data["intrinsics"] | {"distortion": tuple(data["intrinsics"]["distortion"])})
    frames = tuple(
        Frame(
            f["index"], f["timestamp_s"], Path(f["color"]), None if f["depth"] is None else Path(f["depth"])
        )
        for f in data["frames"]
    )
    scene = Scene(
        name=data["name"],
        intrinsics=intrinsics,
        metres_per_unit=data["metres_per_unit"],
        frames=frames,
        registered=data["registered"],
        no_depth_units=tuple(data["no_depth_units"]),
        source=data["source"],
        depth_warp=_warp_from_json(data.get("depth_warp")),
    )
    return Recording(scene, None, tuple(data["skipped"]), tuple(data["notes"]))


def _warp_from_json(data: Json | None) -> DepthWarp | None:
    """The warp of the depth image; None when there is none, as in files of older versions."""
    return None if data is None else DepthWarp(data["zoom"], tuple(data["shift_px"]))


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
        "click_sigma_px": solution.click_sigma_px,
        "depth_sigma_ratio": solution.depth_sigma_ratio,
        "next_clicks": [asdict(click) for click in solution.next_clicks],
        "statements": [asdict(statement) for statement in solution.statements],
    }


def solution_from_json(data: Json) -> Solution:
    """Convert what `solution_to_json` returned back to a solution.

    Files of older versions lack the noise and what follows from it.
    """
    model = KeypointModel(
        name=data["object"],
        keypoints=tuple(data["keypoints"]),
        points_object=rows_from_json(data["points_object"], 3),
        skeleton=tuple((a, b) for a, b in data["skeleton"]),
    )
    residuals = tuple(ClickResidual(**r | {"click": Click(**r["click"])}) for r in data["residuals"])
    return Solution(
        model=model,
        covariance=rows_from_json(data["covariance"], 9).reshape(-1, 3, 3),
        scene_from_object={name: matrix_from_json(m) for name, m in data["scene_from_object"].items()},
        residuals=residuals,
        warnings=tuple(data["warnings"]),
        covariance_in_scene={
            name: rows_from_json(rows, 9).reshape(-1, 3, 3)
            for name, rows in data.get("covariance_in_scene", {}).items()
        },
        click_sigma_px=data.get("click_sigma_px"),
        depth_sigma_ratio=data.get("depth_sigma_ratio"),
        statements=tuple(
            Statement(s["kind"], tuple(Click(**c) for c in s["clicks"]), s["text"], s["evidence"])
            for s in data.get("statements", ())
        ),
        next_clicks=tuple(NextClick(**click) for click in data.get("next_clicks", ())),
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
    instances = tuple(_instance_from_json(instance) for instance in data["instances"])
    return FrameLabel(data["scene"], data["frame"], data["timestamp_s"], instances)


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
    }


def _instance_from_json(data: Json) -> InstanceLabel:
    return InstanceLabel(
        object=data["object"],
        camera_from_object=matrix_from_json(data["camera_from_object"]),
        keypoints_px=rows_from_json(data["keypoints_px"], 2),
        visibility=np.array(data["visible"], dtype=np.int64),
        sigma_px=np.array([math.nan if s is None else s for s in data["sigma_px"]], dtype=float),
        square_box=SquareBox(*data["square_box"]),
        box=None if data["box"] is None else tuple(data["box"]),
        box_full=tuple(data["box_full"]),
        mask=data["mask"],
        mask_full=data["mask_full"],
        visib_fract=data["visib_fract"],
        truncated=data["truncated"],
        quality=data["quality"],
    )
