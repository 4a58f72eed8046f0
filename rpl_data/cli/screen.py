"""Show a build on a terminal: progress, diagnoses and results."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from functools import partial
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from rpl_data.doctor.findings import Diagnosis
from rpl_data.evaluate.quality import format_table
from rpl_data.pipeline.ledger import Ledger
from rpl_data.pipeline.progress import Progress as BuildProgress
from rpl_data.pipeline.results import quality_rows, split_summary, timings, worth_knowing
from rpl_data.pipeline.stages import ORDER
from rpl_data.pipeline.synthesis.training import outdated_line
from rpl_data.types import Recording
from rpl_data.workspace.workspace import Workspace

TELL_EVERY_S = 10.0
"""Where there is no terminal, the running step is named in a line at most this often."""


class _Lines:
    """Lines in place of progress bars, for a log file or a pipe."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._told_s = time.monotonic()
        self._running: dict[str, tuple[float, str]] = {}

    def tell(self, title: str, done: int, total: int) -> None:
        """Say how far all steps are that have run for some time; nothing when that was said shortly ago."""
        now_s = time.monotonic()
        began_s, _ = self._running.get(title, (now_s, ""))
        self._running[title] = began_s, f"{done} of {total}" if total else "at work"
        long = [step for step in self._running.items() if now_s - step[1][0] >= TELL_EVERY_S]
        if self.console.is_terminal or now_s - self._told_s < TELL_EVERY_S or not long:
            return
        self._told_s = now_s
        self.console.print(", ".join(f"{name.strip():20s} {state}" for name, (_, state) in long))

    def end(self, title: str) -> None:
        """The step is done."""
        self._running.pop(title, None)


class Screen:
    """Prints one line per finished step, and how far those at work are: bars, or lines for a log file."""

    def __init__(self) -> None:
        self.console = Console(highlight=False, markup=False, soft_wrap=True)
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        quiet = not self.console.is_terminal
        self._bar = Progress(*columns, console=self.console, transient=True, disable=quiet)
        self._lines = _Lines(self.console)
        self._tasks: dict[str, TaskID] = {}
        self.ran = 0

    def __enter__(self) -> Screen:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def tell(self, progress: BuildProgress) -> None:
        """Show the progress of a step."""
        title = f"{progress.stage:8s} {progress.item}"
        if progress.state == "runs":
            if title not in self._tasks:
                self._tasks[title] = self._bar.add_task(title, total=progress.total or None)
            self._bar.update(self._tasks[title], completed=progress.done, total=progress.total or None)
            self._lines.tell(title, progress.done, progress.total)
            return
        if title in self._tasks:
            self._bar.remove_task(self._tasks.pop(title))
        self._lines.end(title)
        if progress.state == "kept":
            return
        self.ran += 1
        frames = progress.outcome.frames
        work = f"  {frames} frames" if frames else ""
        took = "failed" if progress.state == "failed" else f"{progress.seconds:6.1f} s"
        self.console.print(f"{title:20s} {took}{work}")
        for line in progress.outcome.messages:
            self.console.print(f"    {line}")


def print_diagnoses(recordings: Sequence[Recording], *, briefly: bool = False) -> list[Diagnosis]:
    """Examine each scene with the doctor, with a progress bar; print and return its diagnosis.

    Args:
        briefly: print one line per scene.
    """
    from rpl_data.doctor.examine import examine
    from rpl_data.doctor.text import describe, summarize

    found = []
    console = Console(highlight=False, markup=False, soft_wrap=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    lines = _Lines(console)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        for recording in recordings:
            task = bar.add_task(f"scene {recording.scene.name}", total=None)
            show = partial(_show, bar, task, lines, f"scene {recording.scene.name}")
            diagnosis = examine(recording, progress=show)
            bar.remove_task(task)
            lines.end(f"scene {recording.scene.name}")
            console.print(summarize(diagnosis) if briefly else describe(diagnosis))
            found.append(diagnosis)
    return found


def _show(bar: Progress, task: TaskID, lines: _Lines, title: str, done: int, total: int) -> None:
    bar.update(task, completed=done, total=total)
    lines.tell(title, done, total)


def print_results(
    workspace: Workspace, ledger: Ledger, screen: Screen, until: str | None, fresh: Collection[str]
) -> None:
    """Print the results of a build: timings, split, errors against truth, click advice, and the report.

    Args:
        until: the last stage that was asked for; of those after it nothing is said. All of them when None.
        fresh: names of the steps that are up to date; what others said was of an earlier state.
    """
    say = screen.console.print
    if not screen.ran:
        say("nothing to do: every stage is up to date; these are its results")
    if until in (None, "report"):
        say("\nstage      seconds   frames  frames/s")
        for stage, row in timings(ledger).items():
            frames, seconds = row["frames"], row["seconds"]
            speed = f"{frames:8d}  {frames / max(seconds, 1e-9):8.1f}" if frames else ""
            say(f"{stage:8s} {seconds:9.1f} {speed}".rstrip())
        say(f"\n{split_summary(ledger)}")
    rows = quality_rows(ledger)
    if rows and until in (None, "quality", "report"):
        say(f"\nerrors against the truth\n{format_table(rows)}")
    asked = ORDER[: ORDER.index(until) + 1] if until else ORDER
    known = worth_knowing(ledger, {step for step in fresh if step.partition("/")[0] in asked})
    outdated = outdated_line(workspace) if "export" in asked else None
    known += [outdated] if outdated is not None else []
    if known:
        say("\nWorth knowing\n" + "\n".join(f"    {line}" for line in known))
    if until in (None, "report"):
        say(f"\nreport: {workspace.report.resolve()}")
