"""A camera path as its own images correct it, for the stages that use or judge it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rpl_data.images import read_grey
from rpl_data.pipeline.ledger import Advance
from rpl_data.types import Scene, Trajectory
from rpl_data.workspace.workspace import Workspace

if TYPE_CHECKING:
    from rpl_data.reconstruct.path_correction import CorrectedPath

LEAST_TIED = 0.9
"""Share of the frames that must be joined by pairs whose images could be aligned, or tracked, for a path of
ours to be one: between pieces it knows nothing."""


def correct(workspace: Workspace, scene: Scene, trajectory: Trajectory, advance: Advance) -> CorrectedPath:
    """The path as pairs of frames correct it."""
    from rpl_data.reconstruct.path_correction import correct_path
    from rpl_data.reconstruct.view import REDUCE, Viewer

    viewer, read = Viewer(scene.intrinsics), workspace.depth_reader(scene, keep=True)
    return correct_path(
        scene,
        trajectory,
        lambda frame: viewer.look(read_grey(frame, reduce=REDUCE), read(frame)),
        advance=advance,
    )
