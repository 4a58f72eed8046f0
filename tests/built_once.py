"""Folders made once for all worker processes of a run, and copies of workspaces that are up to date."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from rpl_data.workspace.workspace import Workspace

RECIPE = """
name: tiny
scenes: [{path: recording, metres_per_unit: 0.001}]
objects: [{name: carton, keypoints: [KEYPOINTS], clicks: recording/clicks.csv}]
label: {rate: all}
"""


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that the first process to ask for it has filled; the others wait. Nobody may change it."""
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # the workers' folders lie side by side in it
    folder, done = base / f"once-{name}", base / f"once-{name}.done"
    with (base / f"once-{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def moved_copy(folder: Path, to: Path) -> Path:
    """A copy of a folder with a workspace: all steps that hold in the one hold in the other.

    What a workspace depends on, it names by absolute paths; those in the folder become those of the copy.
    """
    shutil.copytree(folder, to)
    for path in [*to.rglob("*.json"), *to.rglob("recipe.yaml")]:
        text = path.read_text()
        if str(folder) in text:
            path.write_text(text.replace(str(folder), str(to)))
    return to


def plain_recipe(folder: Path) -> Path:
    """What a person would write for the tiny recording in a folder."""
    names = Workspace(folder / "recording/truth").load_solution("carton").model.keypoints
    path = folder / "recipe.yaml"
    path.write_text(RECIPE.replace("KEYPOINTS", ", ".join(names)))
    return path
