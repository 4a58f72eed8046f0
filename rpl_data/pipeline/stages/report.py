"""Stage `report`: write the page that shows what was built and how good it is."""

from __future__ import annotations

from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step
from rpl_data.pipeline.placements import placement_lines
from rpl_data.pipeline.results import quality_rows, split_summary, timings, worth_knowing
from rpl_data.workspace.workspace import Workspace

VERSION = 5
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def report_steps(context: Context) -> list[Step]:
    """Plan the step that writes the page."""
    workspace = context.workspace

    def run(advance: Advance) -> Outcome:
        from rpl_data.report import write_report

        ledger = Ledger(workspace.stages_file)
        write_report(
            workspace,
            rows=quality_rows(ledger),
            timings=timings(ledger),
            split=split_summary(ledger),
            warnings=worth_knowing(ledger),
            min_quality=context.recipe.export.min_quality,
            remarks={
                video: [
                    *drift_remarks(workspace, ledger, video),
                    *placement_lines(workspace, scenes=workspace.parts().scenes_of(video)),
                ]
                for video in workspace.video_names()
            },
        )
        return Outcome()

    before = ["quality", *(f"export/{name}" for name in context.recipe.export.formats)]
    options = {"name": context.recipe.name}
    return [
        step("report", "", run, version=VERSION, options=options, after=before, outputs=[workspace.report])
    ]


def drift_remarks(workspace: Workspace, ledger: Ledger, video: str) -> list[str]:
    """Describe the drift of a recording's poses, measured by depth images and by repeated clicks."""
    lines = []
    measured = ledger.entries.get(f"drift/{video}")
    if measured is not None:
        lines.append(f"poses drift by {measured.outcome.details['drift_mm']:.0f} mm")
    for scene in workspace.parts().scenes_of(video):
        spreads = {
            f"{name} {keypoint}": spread
            for name in workspace.object_names()
            if f"solve/{name}" in ledger.entries
            for keypoint, spread in ledger.entries[f"solve/{name}"]
            .outcome.details.get("spread_mm", {})
            .get(scene, {})
            .items()
        }
        if spreads:
            worst = max(spreads, key=lambda keypoint: spreads[keypoint])
            middle = sorted(spreads.values())[len(spreads) // 2]
            where = "" if scene == video else f"{scene}: "
            lines.append(
                f"{where}clicks of a keypoint are {middle:.1f} mm apart over the frames (median), "
                f"at most {spreads[worst]:.1f} mm ({worst})"
            )
    return lines
