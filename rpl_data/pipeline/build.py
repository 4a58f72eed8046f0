"""Build a workspace from a recipe: the stages in order, running only steps that are out of date.

Every finished step is in `stages.json` before those after it start, and every file is written completely or
not at all, so a build can be interrupted anywhere and continues where it was when it is run again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rpl_data.files import locked, read_text, remove, sweep, write_text
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.graph import Graph
from rpl_data.pipeline.ledger import Advance, Entry, Ledger, Step
from rpl_data.pipeline.object_store import check_address
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.progress import Progress, Tell
from rpl_data.pipeline.recipe import Recipe
from rpl_data.pipeline.recipe_file import load_recipe, recipe_to_yaml
from rpl_data.pipeline.remotes import fetch_recordings
from rpl_data.pipeline.stages import (
    TOGETHER,
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
    "track": track.forget_paths,
    "refine": refine.forget_refined,
    "label": label.forget_labels,
}
"""What removes the files of a stage that the recipe no longer asks for; planning changes nothing."""


def build(
    recipe: Recipe,
    workspace: Workspace,
    *,
    until: str | None = None,
    again: Collection[str] = (),
    workers: int | None = None,
    dask: str | None = None,
    keep_going: bool = False,
    tell: Tell = lambda progress: None,
) -> Ledger:
    """Run the steps that are out of date, each once those before it are done.

    Args:
        until: the last stage to run; None for all.
        again: stages whose steps run even if they are up to date.
        workers: number of processes; None for the number of cores, 1 for this process only.
        dask: address of a Dask scheduler, or `local:N`, whose workers run the steps instead.
        keep_going: leave out the scenes in which a step fails, and make the rest.
        tell: called with every step's progress.

    Returns:
        The ledger: what every step ran with, how long it took, and its messages.

    Raises:
        DataError: what the user can mend; steps that were finished stay finished. With `keep_going`, the list
            of the steps that failed, once all others are done.
    """
    if dask is not None:
        workspace = Workspace(workspace.root.absolute())  # workers are in folders of their own
    with alone_in(workspace), _pool(workers, dask, workspace) as pool:
        return _build(recipe, workspace, until, again, pool, keep_going, tell)


def _pool(workers: int | None, dask: str | None, workspace: Workspace) -> Pool:
    if dask is None:
        return Pool(workers)
    if workers is not None:
        raise DataError("give either --workers or --dask: a cluster has the workers that it was started with")
    from rpl_data.pipeline.cluster import Cluster

    return Pool(engine=Cluster(dask, workspace))


def _build(
    recipe: Recipe,
    workspace: Workspace,
    until: str | None,
    again: Collection[str],
    pool: Pool,
    keep_going: bool,
    tell: Tell,
) -> Ledger:
    export.refuse_unknown_exports(recipe.export.formats)
    if recipe.export.to is not None and until in (None, *TOGETHER[-1]):  # else nothing is sent there
        check_address(recipe.export.to)
    sweep(workspace.root)
    save_recipe(recipe, workspace)
    fetch_recordings(recipe, workspace, tell)
    ledger, context = Ledger(workspace.stages_file), Context(recipe, workspace, pool, keep_going=keep_going)
    graph = Graph(ledger, pool, tell, again, keep_going)
    for group in TOGETHER:
        stages = group[: group.index(until) + 1] if until in group else group
        context = _run_together(graph, stages, context)
        if "import" in stages:
            context = replace(context, lost=context.lost | import_.unread_recordings(ledger))
        graph.refuse_objects_and_exports()
        if until in group:
            break
    graph.refuse_failed()
    return ledger


def _run_together(graph: Graph, stages: Sequence[str], context: Context) -> Context:
    """Run stages; once more without the scenes in which a step failed, as what joins scenes needs all.

    Returns:
        The context of the stages after them, without those scenes.
    """
    while True:
        steps = []
        for stage in stages:
            planned = STAGES[stage](context)
            graph.ledger.keep_only(stage, [item.item for item in planned])
            if stage in FORGET:
                FORGET[stage](context)
            steps += planned
        graph.run(steps)
        lost = context.lost | {context.workspace.parts().video_of(place) for place in graph.lost_places()}
        if lost == context.lost:
            return context
        context = replace(context, lost=lost)


@contextmanager
def alone_in(workspace: Workspace) -> Iterator[None]:
    """Hold the workspace's lock; DataError when another build is running there."""
    busy = f"another build is running in {workspace.root}; wait until it ends, or stop it"
    with locked(workspace.build_lock, busy):
        remove(workspace.cluster_build)  # what a killed build left at work on a cluster ends now
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
        with Pool() as pool:
            ledger = _build(recipe, workspace, "cut", (), pool, False, tell)

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
        inside = [*workspace.root.glob("*/stages.json"), *workspace.root.glob("workspaces/*/stages.json")]
        named = ", ".join(str(path.parent) for path in sorted(inside))
        make = f"make it with `rpl build RECIPE --workspace {workspace.root}` or `rpl import RECIPE ...`"
        raise DataError(
            f"{workspace.root} is not a workspace (it has no {workspace.recipe_file.name}); "
            + (f"name one of those in it: {named}" if named else make)
        )
    return load_recipe(Path(workspace.recipe_file))
