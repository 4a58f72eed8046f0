"""Build a workspace from a recipe: the stages in order, running only steps that are out of date.

Every finished step is in `stages.json` before the next one starts, and every file is written completely or
not at all, so a build can be interrupted anywhere and continues where it was when it is run again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rpl_data.files import locked, read_text, sweep, write_text
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.ledger import Advance, Entry, Ledger, Outcome, Step
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.recipe import Recipe
from rpl_data.pipeline.recipe_file import load_recipe, recipe_to_yaml
from rpl_data.pipeline.stages import (
    clicks,
    cut,
    drift,
    export,
    import_,
    label,
    quality,
    refine,
    report,
    segment,
    solve,
    surface,
    track,
    twin,
)
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

STAGES: dict[str, Callable[[Context], list[Step]]] = {
    "twin": twin.twin_steps,
    "import": import_.import_steps,
    "clicks": clicks.clicks_steps,
    "track": track.track_steps,
    "drift": drift.drift_steps,
    "cut": cut.cut_steps,
    "solve": solve.solve_steps,
    "surface": surface.surface_steps,
    "refine": refine.refine_steps,
    "segment": segment.segment_steps,
    "label": label.label_steps,
    "export": export.export_steps,
    "quality": quality.quality_steps,
    "report": report.report_steps,
}
"""The stages in order. Each plans its steps once those of the stages before it are up to date."""

FORGET: dict[str, Callable[[Context], None]] = {
    "refine": refine.forget_refined,
    "label": label.forget_labels,
}
"""What removes the files of a stage that the recipe no longer asks for; planning changes nothing."""


@dataclass(frozen=True)
class Progress:
    """Progress of a build, as its caller receives it.

    Attributes:
        state: `runs` (with `done` of `total` frames; total 0 = unknown), `ran`, or `kept`: nothing that
            it depends on has changed, so it was not run.
        seconds: time it took, now or when it last ran.
    """

    stage: str
    item: str
    state: Literal["runs", "ran", "kept"]
    done: int = 0
    total: int = 0
    seconds: float = 0.0
    outcome: Outcome = Outcome()

    def __str__(self) -> str:
        """One line for a person, as `tell=print` shows it."""
        step = f"{self.stage} {self.item}".strip()
        if self.state == "kept":
            return f"{step}: up to date"
        if self.state == "ran":
            return f"{step}: done in {self.seconds:.1f} s"
        return f"{step}: {self.done} of {self.total}" if self.total else f"{step}: {self.done} done"


Tell = Callable[[Progress], None]


def build(
    recipe: Recipe,
    workspace: Workspace,
    *,
    until: str | None = None,
    again: Collection[str] = (),
    workers: int | None = None,
    tell: Tell = lambda progress: None,
) -> Ledger:
    """Run the steps that are out of date, in order.

    Args:
        until: the last stage to run; None for all.
        again: stages whose steps run even if they are up to date.
        workers: number of processes; None for the number of cores, 1 for this process only.
        tell: called with every step's progress.

    Returns:
        The ledger: what every step ran with, how long it took, and its messages.

    Raises:
        DataError: what the user can mend; steps that were finished stay finished.
    """
    with alone_in(workspace):
        return _build(recipe, workspace, until, again, workers, tell)


def _build(
    recipe: Recipe,
    workspace: Workspace,
    until: str | None,
    again: Collection[str],
    workers: int | None,
    tell: Tell,
) -> Ledger:
    export.refuse_unknown_exports(recipe.export.formats)
    with Pool(workers) as pool:
        sweep(workspace.root)
        save_recipe(recipe, workspace)
        ledger = Ledger(workspace.stages_file)
        context = Context(recipe, workspace, pool)
        for stage, plan in STAGES.items():
            steps = plan(context)
            ledger.keep_only(stage, [item.item for item in steps])
            if stage in FORGET:
                FORGET[stage](context)
            for item in steps:
                _bring_up_to_date(ledger, item, stage in again, tell)
            if stage == until:
                break
    return ledger


@contextmanager
def alone_in(workspace: Workspace) -> Iterator[None]:
    """Hold the workspace's lock; DataError when another build is running there."""
    busy = f"another build is running in {workspace.root}; wait until it ends, or stop it"
    with locked(workspace.build_lock, busy):
        yield


def stages_named(again: str | Collection[str] | None, until: str | None = None) -> tuple[str, ...]:
    """The stages to run again: one, several, or "all" of them.

    Raises:
        DataError: one of them, or `until`, is no stage.
    """
    if again == "all":
        again = tuple(STAGES)
    chosen = (again,) if isinstance(again, str) else tuple(again or ())
    for stage in (*chosen, *([] if until is None else [until])):
        if stage not in STAGES:
            raise DataError(f"there is no stage {stage!r}; the stages are {', '.join(STAGES)} (or `all`)")
    return chosen


def _bring_up_to_date(ledger: Ledger, step: Step, anyway: bool, tell: Tell) -> None:
    if ledger.holds(step) and not anyway:
        ledger.renew(step)
        entry = ledger.entries[step.name]
        tell(Progress(step.stage, step.item, "kept", seconds=entry.seconds, outcome=entry.outcome))
        return
    tell(Progress(step.stage, step.item, "runs"))
    try:
        entry = ledger.run(
            step, lambda done, total: tell(Progress(step.stage, step.item, "runs", done, total))
        )
    except Exception as error:
        error.add_note(step.name)  # for whoever reports a fault of ours
        raise
    tell(Progress(step.stage, step.item, "ran", seconds=entry.seconds, outcome=entry.outcome))


def stale_steps(recipe: Recipe, workspace: Workspace) -> dict[str, list[tuple[str, bool]]]:
    """List (scene or object, whether it is up to date) of every step that can be planned, by stage.

    Planning ends at the first stage with a step that is out of date, since later stages depend on it.
    """
    ledger = Ledger(workspace.stages_file)
    found: dict[str, list[tuple[str, bool]]] = {}
    with Pool(1) as pool:
        context = Context(recipe, workspace, pool)
        for stage, plan in STAGES.items():
            found[stage] = [(step.item, ledger.holds(step)) for step in plan(context)]
            if not all(holds for _, holds in found[stage]):
                break
    return found


def fresh_steps(recipe: Recipe, workspace: Workspace) -> set[str]:
    """The names of the steps that are known to be up to date."""
    return {
        f"{stage}/{item}" if item else stage
        for stage, steps in stale_steps(recipe, workspace).items()
        for item, holds in steps
        if holds
    }


def run_step(
    recipe: Recipe,
    workspace: Workspace,
    make: Callable[[Context, Advance], Step],
    *,
    title: tuple[str, str],
    tell: Tell = lambda progress: None,
) -> Entry:
    """Bring recordings, clicks and drift up to date, then make one step and run it regardless of the ledger.

    Args:
        make: does the work that comes before the step, reporting its progress, and returns the step.
        title: how progress names that work, as stage and item.
    """
    with alone_in(workspace):
        ledger = _build(recipe, workspace, "cut", (), None, tell)

        def advance(done: int, total: int) -> None:
            tell(Progress(*title, "runs", done, total))

        tell(Progress(*title, "runs"))
        step = make(Context(recipe, workspace, Pool(1)), advance)
        return ledger.run(step, advance)


def context_of(workspace: Workspace) -> Context:
    """Make the context of the stages, for work on an existing workspace."""
    return Context(recipe_of(workspace), workspace, Pool(1))


def save_recipe(recipe: Recipe, workspace: Workspace) -> None:
    """Write the resolved recipe, which later commands on this workspace use."""
    text = recipe_to_yaml(recipe)
    if not workspace.recipe_file.exists() or read_text(workspace.recipe_file, errors="replace") != text:
        write_text(workspace.recipe_file, text)


def recipe_of(workspace: Workspace) -> Recipe:
    """Load the recipe that a workspace was built with."""
    if not workspace.recipe_file.exists():
        raise DataError(
            f"{workspace.root} is not a workspace (it has no {workspace.recipe_file.name}); "
            f"make it with `rpl build RECIPE --workspace {workspace.root}` or `rpl import RECIPE ...`"
        )
    return load_recipe(Path(workspace.recipe_file))
