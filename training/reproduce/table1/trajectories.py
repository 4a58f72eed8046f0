"""The same recording with other camera paths: drifting, or tracked by ourselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from rpl_data.formats.recordings.pose_lines import read_pose_lines
from rpl_data.formats.recordings.rpl import write_poses
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.recipe import Recipe, SceneSource
from rpl_data.twin.drift import Drift, drifted
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

from .rows import Trajectories

POSES = "camera.poses"


def with_trajectories(workspace: Workspace, kind: Trajectories, folder: Path, *, seed: int) -> Recipe:
    """The recipe of a built twin, changed to take its camera paths from elsewhere; pixels stay in place.

    Args:
        folder: where a drifting recording is written: links to the pixels, and poses of its own.

    Raises:
        DataError: the workspace is no twin, so its true paths are not known.
    """
    context = context_of(workspace)
    if context.recipe.twin is None:
        raise DataError(
            f"{workspace.root} is not a twin: {kind} trajectories are compared where the true ones are known"
        )
    changed = replace(
        context.recipe,
        twin=None,
        scenes=context.scene_sources,
        objects=context.objects,
        truth=workspace.truth,
    )
    if kind == "tracked":
        return replace(changed, reconstruct=replace(changed.reconstruct, method="track"))
    write_drifting(workspace, folder, Drift(), seed=seed)
    return replace(changed, scenes=(SceneSource(folder, metres_per_unit=0.001),))


def write_drifting(workspace: Workspace, folder: Path, drift: Drift, *, seed: int) -> None:
    """Write a twin's recording with links to the same pixels, and with camera paths that drift."""
    folder.mkdir(parents=True, exist_ok=True)
    _link(workspace.recording / "camera.txt", folder)
    for number, name in enumerate(workspace.scene_names()):
        for part in sorted((workspace.recording / name).iterdir()):
            if part.name != POSES:
                _link(part, folder / name)
        times_s, poses = read_pose_lines(workspace.recording / name / POSES)
        strayed = drifted(poses, times_s, drift, rng=np.random.default_rng([seed, 4, number]))
        if not _has(folder / name / POSES, strayed):  # written only when changed, or all is built again
            write_poses(folder / name, times_s.tolist(), strayed)


def _has(file: Path, poses: Float64[np.ndarray, "n 4 4"]) -> bool:
    """Whether the file holds these poses, to the digits that such files have."""
    if not file.exists():
        return False
    found = read_pose_lines(file)[1]
    return found.shape == poses.shape and np.allclose(found, poses, rtol=0, atol=1e-7)


def _link(target: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    link = folder / target.name
    if not link.is_symlink():
        link.symlink_to(target.resolve())
