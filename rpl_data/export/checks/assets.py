"""Check of objects as assets; the layout is described in `export.assets`."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.models import check_obj
from rpl_data.export.checks.rules import Rules, at_least, between, one_of, positive, rigid, sized
from rpl_data.files import FAULTS, read_bytes
from rpl_data.json_arrays import Json, flag, optional, text
from rpl_data.meshes import load_mesh
from rpl_data.types import DataError

LARGEST_M = 1e3


def _keypoints(values: Any) -> None:
    """Rule: a point, or null, by keypoint."""
    for name, point in values.items():
        try:
            optional(sized(3, between(-LARGEST_M, LARGEST_M)))(point)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error


RULES: Rules = {
    "name": text,
    "unit": one_of(["metre"], "metre"),
    "frame": text,
    "frame_from_object": rigid,
    "guessed": optional(between(0, 1)),
    "size_m": sized(3, positive),
    "keypoints_m": _keypoints,
    "triangles": at_least(1),
    "closed": flag,
    "open_edges": at_least(0),
}


def looks_like_assets(folder: Path) -> bool:
    """Whether a folder has an object in metres and in millimetres."""
    return any(folder.glob("*_m.glb")) and any(folder.glob("*_mm.ply"))


def check_assets(findings: Findings) -> None:
    """Check each object's facts and files."""
    endings = (".json", "_m.glb", "_m.obj", "_mm.ply")
    names = {
        path.name.removesuffix(ending) for ending in endings for path in findings.folder.glob(f"*{ending}")
    }
    if not names:
        findings.add("", "", "", "there is no object")
    for name in sorted(names):
        facts = findings.json_objects(f"{name}.json")
        sound = bool(facts) and findings.fields(facts, RULES, f"{name}.json", "")
        if sound:
            findings.equal(f"{name}.json", "", "name", facts["name"], name, "as the file is called")
            closed = facts["open_edges"] == 0
            findings.equal(
                f"{name}.json", "", "closed, open_edges", facts["closed"], closed, "as open_edges says"
            )
        _check_ply(findings, name, facts if sound else None)
        _check_glb(findings, f"{name}_m.glb")
        check_obj(findings, f"{name}_m.obj")


def _check_ply(findings: Findings, name: str, facts: Json | None) -> None:
    """The mesh in millimetres is as large as is written of it."""
    file = f"{name}_mm.ply"
    try:
        mesh = load_mesh(findings.folder / file)
    except DataError as error:
        findings.add(file, "", "", str(error).replace(f"{findings.folder}/", ""))
        return
    if facts is None:
        return
    findings.equal(
        f"{name}.json", "", "triangles", facts["triangles"], len(mesh.triangles), f"those of {file}"
    )
    size_m = np.ptp(mesh.vertices, axis=0) / 1000
    if not np.allclose(size_m, facts["size_m"], rtol=1e-3):
        what = f"expected {size_m.tolist()}, as {file} has it in mm, found {facts['size_m']}"
        findings.add(f"{name}.json", "", "size_m", what)


def _check_glb(findings: Findings, file: str) -> None:
    """The file is as long as its header says (glTF 2.0, section 4.4, of the Khronos Group)."""
    try:
        content = read_bytes(findings.folder / file)
        magic, version, length = struct.unpack("<4sII", content[:12])
        if (magic, version, length) != (b"glTF", 2, len(content)):
            raise ValueError(f"expected glTF 2 of {length} bytes, found {len(content)}")
    except DataError:
        findings.add(file, "", "", "missing")
    except (struct.error, *FAULTS) as error:
        findings.add(file, "", "", f"no whole GLB file: {error}")
