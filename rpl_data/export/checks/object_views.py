"""Checks of what model-free estimators read; layouts: `export.foundationpose` and `export.bundlesdf`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rpl_data.export.checks.findings import Findings, stems
from rpl_data.export.checks.rules import camera_matrix
from rpl_data.json_arrays import each, text
from rpl_data.untrusted.yaml_text import read_yaml


def looks_like_foundationpose(folder: Path) -> bool:
    """Whether a folder has objects with chosen views."""
    return any(folder.glob("ob_*/select_frames.yml"))


def check_foundationpose(findings: Findings) -> None:
    """Check each object's views and the list of the objects."""
    names = findings.json_objects("names.json")
    places = {path.name for path in findings.folder.glob("ob_*") if path.is_dir()}
    for place in sorted(places | names.keys()):
        if place not in places:
            findings.add("names.json", "", place, "there is no such folder")
            continue
        findings.fields(names, {place: text}, "names.json", "")
        views = _check_views(
            findings, place, depth="depth_enhanced", mask="mask", pose="cam_in_ob", camera="K.txt"
        )
        _check_chosen(findings, f"{place}/select_frames.yml", views)


def _check_chosen(findings: Findings, file: str, views: int) -> None:
    """The file names the frame of each view."""
    try:
        chosen = read_yaml("\n".join(findings.lines(file)), source=file)
        frames = each(text)(chosen["frames"])
    except (TypeError, KeyError, ValueError) as error:
        if (findings.folder / file).is_file():
            findings.add(
                file, "", "frames", f"expected a list of frames: {' '.join(str(error).split())[:120]}"
            )
        return
    findings.equal(file, "", "frames", len(frames), views, "as many as there are colour images")
    findings.equal(file, "", "frames", len(set(frames)), len(frames), "each once")


def looks_like_bundlesdf(folder: Path) -> bool:
    """Whether a folder has videos of objects; a video by itself is a recording like others."""
    return any(folder.glob("*/*/annotated_poses"))


def check_bundlesdf(findings: Findings) -> None:
    """Check the video of each object and scene."""
    videos = sorted(path for path in findings.folder.glob("*/*") if path.is_dir())
    if not videos:
        findings.add("", "", "", "there is no video, <object>/<scene>/")
    for video in videos:
        place = str(video.relative_to(findings.folder))
        _check_views(findings, place, depth="depth", mask="masks", pose="annotated_poses", camera="cam_K.txt")


def _check_views(findings: Findings, place: str, *, depth: str, mask: str, pose: str, camera: str) -> int:
    """Check the images and poses of a folder, which have the same names; returns how many there are."""
    matrix = findings.numbers(f"{place}/{camera}", 3, 3)
    if matrix is not None:
        findings.rule(f"{place}/{camera}", "", "numbers", camera_matrix, matrix.ravel().tolist())
    colors = stems(findings.folder / place / "rgb", [".png"])
    others = {kind: stems(findings.folder / place / kind) for kind in (depth, mask, pose)}
    for name in sorted(colors.keys() | {name for found in others.values() for name in found}):
        if name not in colors:
            findings.add(f"{place}/rgb/{name}.png", "", "", "missing, though other files have its name")
            continue
        color = findings.image(f"{place}/rgb/{name}.png")
        size = None if color is None else (color.shape[1], color.shape[0])
        like = f"{place}/rgb/{name}.png"
        findings.image(f"{place}/{depth}/{name}.png", size=size, like=like, kind="depth")
        seen = findings.image(f"{place}/{mask}/{name}.png", size=size, like=like, kind="mask")
        if seen is not None and not (np.isin(seen, (0, 255)).all() and seen.any()):
            findings.add(
                f"{place}/{mask}/{name}.png", "", "", "expected 255 where the object is seen, else 0"
            )
        findings.pose(f"{place}/{pose}/{name}.txt")
    if not colors:
        findings.add(f"{place}/rgb", "", "", "no PNG image in it")
    return len(colors)
