"""Check of a BOP dataset as `export.bop` lays it out: the root, and what its scenes have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.export.checks.bop_scene import SceneIndex, check_scene
from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.rules import Rules, at_least, pixel, place, positive, rigid, sized
from rpl_data.export.dialect import SPLITS
from rpl_data.json_arrays import Json, each, text
from rpl_data.meshes import load_mesh
from rpl_data.types import DataError

CAMERA: Rules = {
    "fx": positive, "fy": positive, "cx": pixel, "cy": pixel,
    "width": at_least(1), "height": at_least(1), "depth_scale": positive,
}  # fmt: skip
AXES = "xyz"
MODEL: Rules = {
    "diameter": positive,
    **{f"min_{axis}": place for axis in AXES},
    **{f"size_{axis}": positive for axis in AXES},
}
SYMMETRIES: Rules = {
    "symmetries_discrete": each(rigid),
    "symmetries_continuous": each(lambda entry: [sized(3)(entry[key]) for key in ("axis", "offset")]),
}
SIZE_SHARE = 1e-3
"""By how much of its diameter a mesh may differ from what models_info.json says of it."""
TARGETS = {"test_targets_bop19.json": ("obj_id", "inst_count"), "test_targets_bop24.json": ()}


def looks_like_bop(folder: Path) -> bool:
    """Whether a folder is a whole dataset; a single split or scene is a recording like others."""
    return (folder / "camera.json").is_file() and any((folder / name).is_dir() for name in SPLITS)


def looks_like_bop_onboarding(folder: Path) -> bool:
    """Whether a folder has static onboarding videos."""
    return (folder / "onboarding_static").is_dir()


def check_bop_onboarding(findings: Findings) -> None:
    """Check each video, and that names.json says what it shows."""
    names = findings.json_objects("names.json")
    folders = {path.name for path in (findings.folder / "onboarding_static").glob("*") if path.is_dir()}
    for name in sorted(folders | names.keys()):
        if name not in folders:
            findings.add("names.json", name, "", f"there is no folder onboarding_static/{name}")
            continue
        if findings.fields(names, {name: lambda entry: None}, "names.json", ""):
            findings.fields(names[name], {"object": text, "scene": text}, "names.json", name)
        check_scene(findings, f"onboarding_static/{name}")


def check_bop(findings: Findings) -> None:
    """Check the camera, the models, every scene, and the targets."""
    findings.fields(findings.json_objects("camera.json"), CAMERA, "camera.json", "")
    models = {kind: _check_models(findings, kind) for kind in ("models", "models_eval")}
    if models["models"].keys() != models["models_eval"].keys():
        findings.add(
            "models_eval/models_info.json", "", "", "it has other objects than models/models_info.json"
        )
    scenes = {}
    for split in SPLITS:
        for folder in sorted((findings.folder / split).glob("[0-9]*")):
            scenes[split, folder.name] = check_scene(findings, f"{split}/{folder.name}")
    if not scenes:
        findings.add("", "", "", f"no scene in any of {', '.join(SPLITS)}")
    tests = {
        int(name): scene for (split, name), scene in scenes.items() if split == "test" and name.isdecimal()
    }
    for file, more in TARGETS.items():
        if tests or (findings.folder / file).exists():
            _check_targets(findings, file, more, tests)


def _check_models(findings: Findings, kind: str) -> dict[str, Any]:
    folder, file = findings.folder / kind, f"{kind}/models_info.json"
    info = findings.json_objects(file)
    for number, entry in info.items():
        if not number.isdecimal():
            findings.add(file, f"object {number}", "", "expected the object's number as key")
        elif findings.fields(entry, MODEL, file, f"object {number}"):
            given = {key: rule for key, rule in SYMMETRIES.items() if key in entry}
            findings.fields(entry, given, file, f"object {number}")
            _check_model(findings, kind, int(number), entry)
    for path in sorted(folder.glob("*.ply")):
        number = path.stem.removeprefix("obj_")
        if not number.isdecimal() or str(int(number)) not in info:
            findings.add(file, "", path.stem, f"missing, though there is {kind}/{path.name}")
    return info


def _check_model(findings: Findings, kind: str, number: int, entry: Json) -> None:
    """A mesh can be read, in millimetres, and has the size that is written of it."""
    file, record = f"{kind}/obj_{number:06d}.ply", f"object {number}"
    try:
        vertices = load_mesh(findings.folder / file).vertices
    except DataError as error:
        findings.add(file, "", "", str(error).replace(f"{findings.folder}/", ""))
        return
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    slack = entry["diameter"] * (SIZE_SHARE if kind == "models" else 0.1)  # simplifying moves corners
    if not size.max() - slack <= entry["diameter"] <= np.linalg.norm(size) + slack:
        findings.add(
            f"{kind}/models_info.json", record, "diameter", f"{entry['diameter']:g} is not that of {file}"
        )
        return
    for key, values in (("min", low), ("size", size)):
        for axis, value in zip(AXES, values, strict=True):
            field = f"{key}_{axis}"
            if abs(entry[field] - value) > slack:
                what = f"expected {value:g} mm as {file} has it, found {entry[field]:g}"
                findings.add(f"{kind}/models_info.json", record, field, what)


def _check_targets(
    findings: Findings, file: str, more: tuple[str, ...], scenes: dict[int, SceneIndex]
) -> None:
    targets = findings.json(file)
    if targets is None:
        return
    if not isinstance(targets, list):
        findings.add(file, "", "", f"expected a list, found {type(targets).__name__}")
        return
    rules = {key: at_least(0) for key in ("scene_id", "im_id")} | {key: at_least(1) for key in more}
    for row, target in enumerate(targets):
        if not findings.fields(target, rules, file, f"target {row}"):
            continue
        scene = scenes.get(target["scene_id"])
        if scene is None:
            findings.add(
                file, f"target {row}", "scene_id", f"there is no scene test/{target['scene_id']:06d}"
            )
        elif target["im_id"] not in scene:
            findings.add(file, f"target {row}", "im_id", f"its scene has no image {target['im_id']}")
        elif more and scene[target["im_id"]].count(target["obj_id"]) < target["inst_count"]:
            what = f"image {target['im_id']} does not show that many of object {target['obj_id']}"
            findings.add(file, f"target {row}", "obj_id, inst_count", what)
