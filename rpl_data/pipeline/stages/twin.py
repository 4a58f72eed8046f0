"""Stage `twin`: make the synthetic recording with ground truth that the recipe describes."""

from __future__ import annotations

import json
import os
from dataclasses import asdict

from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step, stamps

VERSION = 4
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def twin_steps(context: Context) -> list[Step]:
    """Plan the step that makes the synthetic recording, if the recipe asks for one."""
    spec, workspace = context.recipe.twin, context.workspace
    if spec is None:
        return []

    def run(advance: Advance) -> Outcome:
        from rpl_data.twin.write import write_twin

        workers = min(context.pool.workers, os.cpu_count() or 1)
        write_twin(workspace.recording, spec, workers=workers, progress=advance)
        return Outcome(spec.total_frames)

    outputs = [workspace.recording / "camera.txt", workspace.recording / "clicks.csv"]
    options = json.loads(json.dumps(asdict(spec), default=str))  # paths of meshes
    if not spec.plain_room:
        del options["plain_room"]  # recordings made before there was a choice are up to date
    meshes = stamps(*(thing.mesh for thing in spec.things if thing.mesh is not None))
    return [step("twin", "", run, version=VERSION, options=options, sources=meshes, outputs=outputs)]
