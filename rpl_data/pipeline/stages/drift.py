"""Stage `drift`: measure how far the camera poses of each recording drift."""

from __future__ import annotations

from rpl_data.drift.drift import drift_to_json, measure_drift
from rpl_data.files import write_json
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.correction import LEAST_TIED, correct
from rpl_data.pipeline.ledger import Advance, Outcome, Step

VERSION = 2
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def drift_steps(context: Context) -> list[Step]:
    """Plan the steps that measure how far the poses of each recording drift, from its depth images."""
    return [_drift_step(context, name) for name in context.videos()]


def _drift_step(context: Context, name: str) -> Step:
    workspace = context.workspace

    def run(advance: Advance) -> Outcome:
        scene = workspace.load_scene(name)
        trajectory = workspace.load_trajectory(scene)
        if not context.tracks:  # else the stage `track` has corrected the path already
            found = correct(workspace, scene, trajectory, advance)
            workspace.save_corrected(scene, found.trajectory if found.share_tied >= LEAST_TIED else None)
        corrected = workspace.load_corrected(scene)
        drift = measure_drift(
            scene, trajectory, workspace.depth_reader(scene), corrected=corrected, advance=advance
        )
        write_json(workspace.drift_file(name), drift_to_json(drift))
        return Outcome(len(drift.frames), details={"drift_mm": 1000 * drift.whole_m})

    return step(
        "drift",
        name,
        run,
        version=VERSION,
        after=context.poses_of(name),
        outputs=[workspace.drift_file(name)],
    )
