"""A studio in a folder: `studio.json` with the meshes and pictures that it names beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import decoding, file_hash, read_json, write_json
from rpl_data.json_arrays import Json
from rpl_data.symmetries import symmetries_from_json, symmetries_to_json
from rpl_data.synthesize.body import Body
from rpl_data.synthesize.light import SceneLight
from rpl_data.synthesize.painted import load_painted, save_painted
from rpl_data.synthesize.studio import DepthNoise, Noise, Plane, Plate, Studio, Subject
from rpl_data.types import DataError, Intrinsics

STUDIO_FILE = "studio.json"


def save_studio(folder: Path, studio: Studio, made_of: Json) -> None:
    """Write a studio; its plates' files must lie in the folder already.

    Args:
        made_of: kept beside it, for whoever asks whether it is up to date.
    """
    for name, subject in studio.subjects.items():
        save_painted(folder / f"{name}.npz", subject.body.painted)
    content = {
        "made_of": made_of,
        "scenes": list(studio.scenes),
        "subjects": {name: _subject_to_json(one) for name, one in studio.subjects.items()},
        "plates": [_plate_to_json(folder, one) for one in studio.plates],
        "noise": asdict(studio.noise),
        "together": list(studio.together),
        "centres": studio.centres.tolist(),
    }
    write_json(folder / STUDIO_FILE, content, indent=None)


def studio_made_of(folder: Path) -> Any:
    """What a studio says it was made of; None where there is none."""
    file = folder / STUDIO_FILE
    return read_json(file).get("made_of") if file.exists() else None


def studio_hash(folder: Path) -> str:
    """Stands for what the views of a folder that `rpl synthesize` wrote are rendered from, SHA-256."""
    return file_hash(folder / "studio" / STUDIO_FILE)


def load_studio(folder: Path) -> Studio:
    """Read a studio.

    Raises:
        DataError: there is none, or a file of it is damaged.
    """
    file = folder / STUDIO_FILE
    if not file.exists():
        raise DataError(f"{folder} holds nothing to render from ({STUDIO_FILE}); run `rpl synthesize` first")
    content = read_json(file)
    with decoding(file, "make it again with `rpl synthesize --again true`"):
        return Studio(
            scenes=tuple(content["scenes"]),
            subjects={
                name: _subject_from_json(folder, name, one) for name, one in content["subjects"].items()
            },
            plates=tuple(_plate_from_json(folder, one) for one in content["plates"]),
            noise=_noise_from_json(content["noise"]),
            together=tuple(content["together"]),
            centres=np.array(content["centres"], dtype=float).reshape(-1, 2),
        )


def _subject_to_json(subject: Subject) -> Json:
    points = subject.body.points_object
    return {
        "points_object": [None if np.isnan(row).any() else row.tolist() for row in points],
        "keypoints": list(subject.keypoints),
        "symmetries": symmetries_to_json(subject.symmetries),
        "lights": {
            scene: {"up": light.up.tolist(), "coefficients": light.coefficients.tolist()}
            for scene, light in subject.lights.items()
        },
        "views": subject.views.tolist(),
        "shown": np.flatnonzero(subject.shown).tolist(),
        "directions": len(subject.shown),
        "ups": subject.ups.tolist(),
        **{
            name: getattr(subject, name)
            for name in ("turn_deg", "nearest_m", "farthest_m", "keypoint_sigma_m", "carved")
        },
    }


def _subject_from_json(folder: Path, name: str, stored: Mapping[str, Any]) -> Subject:
    points = np.array([[np.nan] * 3 if row is None else row for row in stored["points_object"]], dtype=float)
    shown = np.zeros(stored["directions"], bool)
    shown[stored["shown"]] = True
    return Subject(
        body=Body(name, load_painted(folder / f"{name}.npz"), points.reshape(-1, 3)),
        keypoints=tuple(stored["keypoints"]),
        views=np.array(stored["views"], dtype=float).reshape(-1, 3),
        shown=shown,
        ups=np.array(stored["ups"], dtype=float).reshape(-1, 3),
        turn_deg=stored["turn_deg"],
        nearest_m=stored["nearest_m"],
        farthest_m=stored["farthest_m"],
        keypoint_sigma_m=stored["keypoint_sigma_m"],
        symmetries=symmetries_from_json(stored["symmetries"]),
        carved=stored["carved"],
        lights={
            scene: SceneLight(
                np.array(light["up"], dtype=float), np.array(light["coefficients"], dtype=float)
            )
            for scene, light in stored["lights"].items()
        },
    )


def _noise_from_json(stored: Mapping[str, Any]) -> Noise:
    return Noise(stored["color"], {name: DepthNoise(**one) for name, one in stored["depth"].items()})


def _plate_to_json(folder: Path, plate: Plate) -> Json:
    return {
        "scene": plate.scene,
        "frame": plate.frame,
        "color": plate.color.relative_to(folder).as_posix(),
        "depth": None if plate.depth is None else plate.depth.relative_to(folder).as_posix(),
        "metres_per_unit": plate.metres_per_unit,
        "camera": asdict(plate.camera),
        "up": plate.up.tolist(),
        "table": None if plate.table is None else [*plate.table.normal.tolist(), plate.table.offset_m],
    }


def _plate_from_json(folder: Path, stored: Mapping[str, Any]) -> Plate:
    camera, table = dict(stored["camera"]), stored["table"]
    camera["distortion"] = tuple(camera["distortion"])
    return Plate(
        scene=stored["scene"],
        frame=stored["frame"],
        color=folder / stored["color"],
        depth=None if stored["depth"] is None else folder / stored["depth"],
        metres_per_unit=stored["metres_per_unit"],
        camera=Intrinsics(**camera),
        up=np.array(stored["up"], dtype=float),
        table=None if table is None else Plane(np.array(table[:3], dtype=float), float(table[3])),
    )
