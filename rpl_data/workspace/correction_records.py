"""Convert corrections to JSON-ready dictionaries and back; nothing here touches a file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rpl_data.json_arrays import Json, each, flag, number, optional, taken, text, whole
from rpl_data.types import Correction, Rle
from rpl_data.untrusted.rle import pixels_of_rle


def corrections_to_json(corrections: Sequence[Correction]) -> list[Json]:
    """Convert corrections, one record per scene, frame, object and instance."""
    return [
        {
            "scene": one.scene,
            "frame": one.frame,
            "object": one.object,
            "deleted": one.deleted,
            "crowd": one.crowd,
            "mask": None if one.mask is None else dict(one.mask),
            "keypoints": {name: list(values) for name, values in one.keypoints.items()},
            **({"instance": one.instance} if one.instance else {}),
        }
        for one in corrections
    ]


def corrections_from_json(data: Any) -> list[Correction]:
    """Convert what `corrections_to_json` returned back."""
    return list(each(_correction)(data))


def _correction(data: Json) -> Correction:
    return Correction(
        scene=taken(data, "scene", text),
        frame=taken(data, "frame", whole),
        object=taken(data, "object", text),
        deleted=taken(data, "deleted", flag),
        crowd=taken(data, "crowd", flag),
        mask=taken(data, "mask", optional(_mask)),
        keypoints=taken(data, "keypoints", lambda found: {text(k): _keypoint(v) for k, v in found.items()}),
        instance=text(data.get("instance", "")),
    )


def _mask(data: Json) -> Rle:
    height, width = taken(data, "size", each(whole))
    counts = taken(data, "counts", text)
    if pixels_of_rle(counts) != height * width:
        raise ValueError(f"its runs are not those of {width} x {height} pixels")
    return {"size": [height, width], "counts": counts}


def _keypoint(values: Any) -> tuple[float, float, int]:
    u, v, seen = each(number)(values)
    if seen not in (0, 1, 2):
        raise ValueError(f"a keypoint with v = {seen:g}; expected 0, 1 or 2")
    return u, v, int(seen)
