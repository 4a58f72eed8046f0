"""Everything -> one page a person looks at."""

from __future__ import annotations

from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Ledger, Outcome, Step
from rpl_data.pipeline.stages import ORDER
from rpl_data.pipeline.stages.quality import quality_rows
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace

VERSION = 1
"""Raised when the stage writes something else for the same input; its steps then run again."""


def report_steps(context: Context) -> list[Step]:
    """Everything -> one page a person looks at."""
    workspace = context.workspace

    def run(advance: Advance) -> Outcome:
        from rpl_data.report import write_report

        ledger = Ledger(workspace.stages_file)
        write_report(
            workspace,
            rows=quality_rows(ledger),
            timings=timings(ledger),
            split=split_summary(ledger),
            warnings=[
                line
                for stage in ("cut", "export")
                for entry in ledger.of_stage(stage).values()
                for line in entry.outcome.messages
            ],
            remarks={video: drift_remarks(workspace, ledger, video) for video in workspace.video_names()},
        )
        return Outcome()

    before = ["quality", *(f"export/{name}" for name in context.recipe.export)]
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


def timings(ledger: Ledger) -> dict[str, dict[str, float | int]]:
    """Seconds and number of frames of every stage that ran, in order."""
    found: dict[str, dict[str, float | int]] = {}
    for stage in ORDER:
        outcomes = ledger.of_stage(stage).values()
        if outcomes:
            seconds = sum(entry.seconds for entry in outcomes)
            found[stage] = {"seconds": seconds, "frames": sum(entry.outcome.frames for entry in outcomes)}
    return found


def split_summary(ledger: Ledger) -> str:
    """Write one line per split: its images, scenes, and how near its views are to those of training."""
    entry = ledger.entries.get("export/coco")
    if entry is None:
        return ""
    lines = []
    for name, images in entry.outcome.details["images"].items():
        scenes = ", ".join(entry.outcome.details["scenes"].get(name, []))
        line = f"{name}: {counted(images, 'image')} of {scenes or 'no scene'}"
        near = entry.outcome.details["views"].get(name)
        if near is not None and near["angle_median_deg"] is not None:
            line += (
                f"; views {near['angle_median_deg']:.1f} deg (median), {near['angle_p90_deg']:.1f} deg (p90) "
                "from the nearest of training"
            )
        if near is not None and near["time_median_s"] is not None:
            line += f", {near['time_median_s']:.2f} s (median) from it in time"
        lines.append(line)
    return "\n".join(lines)
