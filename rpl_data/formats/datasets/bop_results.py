"""Estimated poses as the BOP benchmark takes them: one line per pose.

::

    scene_id,im_id,obj_id,score,R,t,time
    1,3,2,0.97,1 0 0 0 1 0 0 0 1,12.5 -40.2 800.1,-1

R row-major, t in millimetres, ``camera_from_object``; time in seconds per image, -1 = not measured. The name
of a file that is handed in is `<method>_<dataset>-<split>.csv`. Format: `docs/bop_challenge_2019.md` of
https://github.com/thodan/bop_toolkit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rpl_data.files import decoding, read_text, write_text
from rpl_data.geometry import Transform, rigid

HEADER = "scene_id,im_id,obj_id,score,R,t,time"


@dataclass(frozen=True)
class PoseResult:
    """One estimated pose.

    Attributes:
        scene, image, object: BOP's numbers of them.
        score: confidence.
        camera_from_object: the pose, metres.
        seconds: time spent on the image; -1 = not measured.
    """

    scene: int
    image: int
    object: int
    score: float
    camera_from_object: Transform
    seconds: float = -1.0


def write_bop_results(path: Path, results: Iterable[PoseResult]) -> None:
    """Write the file."""
    write_text(path, "\n".join([HEADER, *map(_line, results)]) + "\n")


def _line(result: PoseResult) -> str:
    pose = result.camera_from_object
    rotation, translation_mm = (
        " ".join(map(repr, part.ravel().tolist())) for part in (pose[:3, :3], 1000 * pose[:3, 3])
    )
    numbers = f"{result.scene},{result.image},{result.object},{result.score:.6g}"
    return f"{numbers},{rotation},{translation_mm},{result.seconds:g}"


def read_bop_results(path: Path) -> list[PoseResult]:
    """Read the file.

    Raises:
        DataError: naming the line that is not as the format says.
    """
    results = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip() and line.strip() != HEADER:
            with decoding(f"{path}, line {number}", f"expected {HEADER}"):
                results.append(_result(line))
    return results


def _result(line: str) -> PoseResult:
    scene, image, instance, score, rotation, translation_mm, seconds = line.split(",")
    pose = rigid(
        np.array(rotation.split(), dtype=np.float64).reshape(3, 3),
        np.array(translation_mm.split(), dtype=np.float64).reshape(3) / 1000,
    )
    return PoseResult(int(scene), int(image), int(instance), float(score), pose, float(seconds))
