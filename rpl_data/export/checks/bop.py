"""Check of a BOP dataset as `export.bop` lays it out: the root, and what its scenes have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rpl_data.export.bop_onboarding import DYNAMIC, STATIC
from rpl_data.export.checks.bop_scene import SceneIndex, check_scene
from rpl_data.export.checks.findings import Findings
from rpl_data.export.checks.models import SIZE_SHARE, SIZES, check_sizes
from rpl_data.export.checks.rules import Rules, at_least, pixel, positive, rigid, sized
from rpl_data.export.dialect import SPLITS
from rpl_data.json_arrays import each, text

CAMERA: Rules = {
    "fx": positive, "fy": positive, "cx": pixel, "cy": pixel,
    "width": at_least(1), "height": at_least(1), "depth_scale": positive,
}  # fmt: skip
SYMMETRIES: Rules = {
    "symmetries_discrete": each(rigid),
    "symmetries_continuous": each(lambda entry: [sized(3)(entry[key]) for key in ("axis", "offset")]),
}
SIZE_SHARES = {"models": SIZE_SHARE, "models_eval": 0.1}
"""By how much of its diameter a mesh may differ from models_info.json: simplifying moves corners."""
TARGETS = {"test_targets_bop19.json": ("obj_id", "inst_count"), "test_targets_bop24.json": ()}


def looks_like_bop(folder: Path) -> bool:
    """Whether a folder is a whole dataset; a single split or scene is a recording like others."""
    return (folder / "camera.json").is_file() and any((folder / name).is_dir() for name in SPLITS)


def looks_like_bop_onboarding(folder: Path) -> bool:
    """Whether a folder has onboarding videos."""
    return (folder / STATIC).is_dir() or (folder / DYNAMIC).is_dir()


def check_bop_onboarding(findings: Findings) -> None:
    """Check each video, and that names.json says what it shows."""
    names = findings.json_objects("names.json")
    folders = {
        path.name: kind
        for kind in (STATIC, DYNAMIC)
        for path in (findings.folder / kind).glob("*")
        if path.is_dir()
    }
    for name in sorted(folders.keys() | names.keys()):
        if name not in folders:
            kind = STATIC if name.endswith(("_up", "_down")) else DYNAMIC
            findings.add("names.json", name, "", f"there is no folder {kind}/{name}")
            continue
        if findings.fields(names, {name: lambda entry: None}, "names.json", ""):
            findings.fields(names[name], {"object": text, "scene": text}, "names.json", name)
        check_scene(findings, f"{folders[name]}/{name}")


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
        elif findings.fields(entry, SIZES, file, f"object {number}"):
            given = {key: rule for key, rule in SYMMETRIES.items() if key in entry}
            findings.fields(entry, given, file, f"object {number}")
            mesh = f"{kind}/obj_{int(number):06d}.ply"
            check_sizes(findings, mesh, entry, file, f"object {number}", share=SIZE_SHARES[kind])
    for path in sorted(folder.glob("*.ply")):
        number = path.stem.removeprefix("obj_")
        if not number.isdecimal() or str(int(number)) not in info:
            findings.add(file, "", path.stem, f"missing, though there is {kind}/{path.name}")
    return info


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
