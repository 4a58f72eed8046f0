"""Checks of models that several layouts have: sizes written of a mesh, and a textured mesh as OBJ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.rules import Rules, place, positive
from rpl_data.json_arrays import Json
from rpl_data.meshes import load_mesh
from rpl_data.types import DataError

AXES = "xyz"
SIZES: Rules = {
    "diameter": positive,
    **{f"min_{axis}": place for axis in AXES},
    **{f"size_{axis}": positive for axis in AXES},
}
"""What models_info.json of BOP, and models_info.yml of LINEMOD, say of an object, in millimetres."""

SIZE_SHARE = 1e-3
"""By how much of its diameter a mesh may differ from what is written of it: more than rounding does."""


def check_sizes(findings: Findings, file: str, entry: Json, info: str, record: str, *, share: float) -> None:
    """A mesh can be read, in millimetres, and has the size that is written of it.

    Args:
        findings: the faults so far.
        file: the mesh, relative to the export.
        entry: what is written of it; it keeps `SIZES`.
        info, record: where that is written.
        share: by how much of its diameter the mesh may differ.
    """
    try:
        vertices = load_mesh(findings.folder / file).vertices
    except DataError as error:
        findings.add(file, "", "", str(error).replace(f"{findings.folder}/", ""))
        return
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    slack = entry["diameter"] * share
    if not size.max() - slack <= entry["diameter"] <= np.linalg.norm(size) + slack:
        findings.add(info, record, "diameter", f"{entry['diameter']:g} is not that of {file}")
        return
    for key, values in (("min", low), ("size", size)):
        for axis, value in zip(AXES, values, strict=True):
            field = f"{key}_{axis}"
            if abs(entry[field] - value) > slack:
                what = f"expected {value:g} mm as {file} has it, found {entry[field]:g}"
                findings.add(info, record, field, what)


def check_obj(findings: Findings, file: str) -> None:
    """A mesh names its material, and that its texture, and both are there, beside it."""
    place = Path(file).parent
    lines = [line.split(maxsplit=1) for line in findings.lines(file)]
    counts = {kind: sum(line[0] == kind for line in lines if line) for kind in ("v", "f")}
    materials = [line[1] for line in lines if len(line) == 2 and line[0] == "mtllib"]
    if not (counts["v"] and counts["f"] and materials) and (findings.folder / file).is_file():
        findings.add(file, "", "v, f, mtllib", "expected vertices, faces and a material")
    for material in (str(place / name) for name in materials):
        if findings.named(material, file, "", "mtllib"):
            words = [line.split(maxsplit=1) for line in findings.lines(material)]
            textures = [line[1] for line in words if len(line) == 2 and line[0] == "map_Kd"]
            if not textures:
                findings.add(material, "", "map_Kd", "expected a texture")
            for texture in (str(place / name) for name in textures):
                if findings.named(texture, material, "", "map_Kd"):
                    findings.image(texture)
