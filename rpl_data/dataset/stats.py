"""What is in a dataset: counts, visibility, distances, and from which sides the objects are seen."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.dataset.source import Source, content_hash, parts_of, recorded_hash, source_at
from rpl_data.directions import COVERED_DEG, gaps_deg
from rpl_data.geometry import invert
from rpl_data.json_arrays import Json, matrix_from_json

QUANTILES = (("least", 0), ("p10", 10), ("median", 50), ("p90", 90), ("most", 100))


@dataclass
class _Tally:
    """The numbers of one object, or of one scene, or of a split."""

    visible: list[float] = field(default_factory=list)
    quality: list[float] = field(default_factory=list)
    distances_m: list[float] = field(default_factory=list)
    towards: list[Float64[np.ndarray, "3"]] = field(default_factory=list)
    keypoints: Counter[int] = field(default_factory=Counter)
    scenes: Counter[str] = field(default_factory=Counter)


def dataset_stats(path: Path) -> Json:
    """Count what a dataset holds, as JSON.

    Returns:
        `images`, `annotations` and `ignored` (crowds) per split; `scenes`: images and instances per object;
        `objects`: instances, how much of them is visible, quality, distance of the object's origin from the
        camera in metres (quantiles each), share of the keypoints seen, hidden and unlabelled, and `views`:
        the share of all directions from which the object is seen within 15 degrees, and by how many degrees
        the direction farthest from any view misses one; `content_hash`; `as_recorded`: whether the version
        file has the same, None without such a file.
    """
    source = source_at(path)
    images: Counter[str] = Counter()
    annotations: Counter[str] = Counter()
    ignored: Counter[str] = Counter()
    scenes: dict[str, Json] = {}
    objects: dict[str, _Tally] = {}
    for part in parts_of(source):
        names = {category["id"]: category["name"] for category, _ in part.objects}
        objects |= {name: _Tally() for name in names.values() if name not in objects}
        for image in part.images:
            images[part.split] += 1
            scene = scenes.setdefault(image["scene"], {"split": set(), "images": 0, "instances": Counter()})
            scene["split"].add(part.split)
            scene["images"] += 1
            for label in part.annotations.get(image["id"], ()):
                if label.get("iscrowd"):
                    ignored[part.split] += 1
                    continue
                annotations[part.split] += 1
                name = names[label["category_id"]]
                scene["instances"][name] += 1
                _count(objects[name], label, image["scene"])
    return {
        "images": dict(images),
        "annotations": dict(annotations),
        "ignored": dict(ignored),
        "scenes": {
            name: {**found, "split": sorted(found["split"]), "instances": dict(found["instances"])}
            for name, found in sorted(scenes.items())
        },
        "objects": {name: _described(tally) for name, tally in objects.items()},
        **_version(source),
    }


def _count(tally: _Tally, label: Json, scene: str) -> None:
    camera_from_object = matrix_from_json(label["camera_from_object"])
    camera_object = invert(camera_from_object)[:3, 3]
    distance_m = float(np.linalg.norm(camera_object))
    tally.visible.append(label["visib_fract"])
    tally.quality.append(label["quality"])
    tally.distances_m.append(distance_m)
    tally.towards.append(camera_object / max(distance_m, 1e-9))
    tally.keypoints.update(int(v) for v in label["keypoints"][2::3])
    tally.scenes[scene] += 1


def _described(tally: _Tally) -> Json:
    total = sum(tally.keypoints.values())
    share = {v: round(tally.keypoints[v] / total, 4) if total else None for v in (2, 1, 0)}
    return {
        "instances": len(tally.visible),
        "scenes": len(tally.scenes),
        "visible": _quantiles(tally.visible),
        "quality": _quantiles(tally.quality),
        "distance_m": _quantiles(tally.distances_m),
        "keypoints": {"seen": share[2], "hidden": share[1], "unlabelled": share[0]},
        "views": _coverage(tally),
    }


def _quantiles(values: list[float]) -> Json | None:
    """Least, most and some between; None of nothing."""
    if not values:
        return None
    return {name: round(float(np.percentile(values, share)), 4) for name, share in QUANTILES}


def _coverage(tally: _Tally) -> Json | None:
    """How much of the sphere of viewing directions is covered; None of nothing."""
    if not tally.towards:
        return None
    found_deg = gaps_deg(np.array(tally.towards))
    return {
        "covered": round(float((found_deg <= COVERED_DEG).mean()), 4),
        "widest_gap_deg": round(float(found_deg.max()), 1),
    }


def _version(source: Source) -> Json:
    found, recorded = content_hash(source.folder), recorded_hash(source.folder)
    same = None if recorded is None else recorded == found
    return {"content_hash": found, "as_recorded": same}
