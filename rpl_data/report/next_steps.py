"""What a person should do next with a dataset, the most useful first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from rpl_data.report.counts import SceneReport
from rpl_data.report.html import prose
from rpl_data.types import Solution
from rpl_data.types.keypoint_names import keypoint_titles
from rpl_data.wording import counted

FEWEST_SCENES = 3
"""With fewer, no scene can be kept for testing."""
LITTLE_SEEN = 0.3
"""Share of all directions below which a further scene with the object turned over is advised."""


def next_steps(
    scenes: Sequence[SceneReport],
    solutions: Sequence[Solution],
    coverage: Mapping[str, float],
    *,
    clicked: Collection[str] = (),
) -> list[str]:
    """Lines of advice; one line that says so when there is none.

    Args:
        coverage: share of all directions from which each object was seen.
        clicked: recordings with clicks; without labels they were left out of the build, which says why.
    """
    lines = []
    for solution in solutions:
        wrong = [residual.click for residual in solution.residuals if residual.outlier]
        if wrong:
            names = ", ".join(sorted({click.scene for click in wrong}))
            lines.append(
                f"Look at {counted(len(wrong), 'click')} on {solution.model.name} that others contradict, in "
                f"scene {names}: `rpl annotate` shows them in red."
            )
        once = clicked_once(solution)
        if once:
            what = "a keypoint that was" if len(once) == 1 else "keypoints that were"
            lines.append(
                f"Click {', '.join(once)} of {solution.model.name} once more, in another scene: "
                f"nothing checks {what} clicked only once."
            )
    unlabelled = [scene.recording.scene.name for scene in scenes if not scene.frames]
    unlabelled = [name for name in unlabelled if name not in clicked]
    if unlabelled:
        lines.append(f"Click keypoints in scene {', '.join(unlabelled)}, which has no labels yet.")
    low = {
        scene.recording.scene.name: count
        for scene in scenes
        if (count := sum(tally.low_quality for tally in scene.tallies.values()))
    }
    if low:
        worst = max(low, key=lambda name: low[name])
        lines.append(
            f"{counted(sum(low.values()), 'label')} were too uncertain to be exported, {low[worst]} of them "
            f"in scene {worst}: look at its frames below; a second click per keypoint there helps most."
        )
    if len(scenes) < FEWEST_SCENES:
        lines.append(
            f"Record {counted(FEWEST_SCENES - len(scenes), 'more scene')}, with the objects in other poses: "
            f"with fewer than {FEWEST_SCENES} scenes nothing can be kept for testing."
        )
    for name, share in coverage.items():
        if share < LITTLE_SEEN:
            lines.append(
                f"Record {name} turned over: views of {share:.0%} of all directions leave the rest to chance."
            )
    return lines or [
        "Nothing is left to mend that the tool can see. Look at the worst labels below, then train."
    ]


def clicked_once(solution: Solution) -> list[str]:
    """Names of the keypoints with a single click, which nothing contradicts."""
    counts = Counter(residual.click.keypoint for residual in solution.residuals)
    titles = keypoint_titles(solution.model.keypoints)
    return [title for number, title in enumerate(titles) if counts[number] == 1]


def next_steps_list(lines: Sequence[str]) -> str:
    """The lines as a numbered list at the top of the page."""
    items = "".join(f"<li>{prose(line)}</li>" for line in lines)
    return f'<section id="next"><h2>What to do next</h2><ol>{items}</ol></section>'
