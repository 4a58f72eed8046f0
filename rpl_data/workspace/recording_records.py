"""Convert recordings, without their trajectories, to JSON-ready dictionaries and back."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from rpl_data.json_arrays import Json, each, flag, number, optional, taken, text, whole
from rpl_data.types import DepthCamera, DepthCoding, DepthWarp, Frame, Intrinsics, Recording, Scene


def recording_to_json(recording: Recording) -> Json:
    """Convert a recording, without its trajectory, to a dictionary."""
    scene = recording.scene
    return {
        "name": scene.name,
        "source": scene.source,
        "intrinsics": _intrinsics_to_json(scene.intrinsics),
        "metres_per_unit": scene.metres_per_unit,
        "registered": scene.registered,
        "no_depth_units": list(scene.no_depth_units),
        "depth_warp": None if scene.depth_warp is None else asdict(scene.depth_warp),
        "depth_coding": asdict(scene.depth_coding),
        "depth_camera": None if scene.depth_camera is None else _depth_camera_to_json(scene.depth_camera),
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
    scene = Scene(
        name=taken(data, "name", text),
        intrinsics=taken(data, "intrinsics", _intrinsics_from_json),
        metres_per_unit=taken(data, "metres_per_unit", number),
        frames=taken(data, "frames", each(_frame_from_json)),
        registered=taken(data, "registered", flag),
        no_depth_units=taken(data, "no_depth_units", each(whole)),
        source=taken(data, "source", text),
        depth_warp=_warp_from_json(data.get("depth_warp")),
        depth_coding=_coding_from_json(data.get("depth_coding", {})),
        depth_camera=_depth_camera_from_json(data.get("depth_camera")),
    )
    if not scene.frames:
        raise ValueError("frames: there are none")
    return Recording(scene, None, taken(data, "skipped", each(text)), taken(data, "notes", each(text)))


def _intrinsics_to_json(intrinsics: Intrinsics) -> Json:
    return asdict(intrinsics) | {"distortion": list(intrinsics.distortion)}


def _intrinsics_from_json(data: Json) -> Intrinsics:
    found = {name: taken(data, name, number) for name in ("fx", "fy", "cx", "cy")}
    width, height = taken(data, "width", whole), taken(data, "height", whole)
    if min(width, height, found["fx"], found["fy"]) <= 0:
        raise ValueError("width, height, fx and fy must be positive")
    return Intrinsics(**found, width=width, height=height, distortion=taken(data, "distortion", each(number)))


def _coding_from_json(data: Json) -> DepthCoding:
    return DepthCoding(**{name: taken(data, name, flag) for name in data})


def _frame_from_json(data: Json) -> Frame:
    path = taken(data, "depth", optional(text))
    return Frame(
        taken(data, "index", whole),
        taken(data, "timestamp_s", number),
        Path(taken(data, "color", text)),
        None if path is None else Path(path),
    )


def _warp_from_json(data: Json | None) -> DepthWarp | None:
    """The warp of the depth image; None when there is none, as in files of older versions."""
    if data is None:
        return None
    along_u_px, along_v_px = taken(data, "shift_px", each(number))
    return DepthWarp(taken(data, "zoom", number), (along_u_px, along_v_px))


def _depth_camera_to_json(camera: DepthCamera) -> Json:
    matrix = None if camera.color_from_depth is None else list(camera.color_from_depth)
    return {"intrinsics": _intrinsics_to_json(camera.intrinsics), "color_from_depth": matrix}


def _depth_camera_from_json(data: Json | None) -> DepthCamera | None:
    """The camera of the depth images; None where it is that of the colour images, as in older files."""
    if data is None:
        return None
    matrix = taken(data, "color_from_depth", optional(each(number)))
    if matrix is not None and len(matrix) != 16:
        raise ValueError(f"color_from_depth: expected 16 numbers, found {len(matrix)}")
    return DepthCamera(taken(data, "intrinsics", _intrinsics_from_json), matrix)
