"""The commands that run one stage of a workspace, and what is out of date before it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rpl_data.types import DataError

if TYPE_CHECKING:
    from rpl_data.pipeline.ledger import Ledger

HERE = Path(".")


def track(workspace: Path = HERE, again: bool = False) -> None:
    """Camera poses from the images: computed where the recording has none, questioned where it has some.

    Frames are aligned to frames with a similar view by brightness and depth. Poses of the recording are kept
    where that moves the image by less than half a pixel; otherwise both paths are compared on corners and
    depth, and the better one becomes `trajectory.txt`. Frames that cannot be tracked are left out and named.

    Example: rpl track --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "track", again)


def drift(workspace: Path = HERE, again: bool = False) -> None:
    """Measure how far the camera poses of each recording drift, from its own depth images.

    Example: rpl drift --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "drift", again)


def cut(workspace: Path = HERE, again: bool = False) -> None:
    """Cut recordings whose poses drift too far into scenes that are placed by their own clicks.

    The recipe's `reconstruct: {max_drift_mm: 15}` says how far is too far.

    Example: rpl cut --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "cut", again)


def solve(workspace: Path = HERE, again: bool = False) -> None:
    """Turn clicks into sparse models: where each keypoint is, and where the objects stand in each scene.

    Example: rpl solve --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "solve", again)


def surface(workspace: Path = HERE, again: bool = False) -> None:
    """Fuse the depth images near the objects into a surface for each scene.

    Example: rpl surface --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "surface", again)


def refine(workspace: Path = HERE, again: bool = False) -> None:
    """Register the scenes of each object on one another: their surfaces and print, together with the clicks.

    A scene keeps the pose of its clicks where parts of its surface that were left out of the registration do
    not agree better with the other scenes afterwards; that is said.

    Example: rpl refine --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "refine", again)


def segment(workspace: Path = HERE, again: bool = False) -> None:
    """Cut the dense model of each object out of the surfaces.

    Example: rpl segment --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "segment", again)


def label(workspace: Path = HERE, again: bool = False, workers: int | None = None) -> None:
    """Compute poses, keypoints, boxes and masks of the objects in the chosen frames.

    Example: rpl label --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
        workers: number of processes; as many as there are cores when left out, 1 = only this one.
    """
    run_stage(workspace, "label", again, workers)


def export(workspace: Path = HERE, labels: Literal["own", "truth"] = "own", again: bool = False) -> None:
    """Write the labels in the formats of the recipe, to export/ of the workspace.

    Example: rpl export --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        labels: `own`, or `truth`: export/coco_truth with the same images, labelled by the truth where it is
            known.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "export", again)
    if labels == "truth":
        from rpl_data.pipeline.build import context_of
        from rpl_data.pipeline.stages.export import export_truth
        from rpl_data.workspace.workspace import Workspace

        summary = export_truth(context_of(Workspace(workspace)))
        print(f"{Workspace(workspace).export('coco_truth')}: {sum(summary.images.values())} images")


def quality(workspace: Path = HERE, again: bool = False) -> None:
    """Compare labels with the truth, where the recipe has a twin or names the truth: mm, px, IoU.

    Example: rpl quality --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    ledger = run_stage(workspace, "quality", again)
    if "quality" not in ledger.entries:
        raise DataError(
            f"the truth of {workspace} is not known; name it with `truth:` in the recipe and build again"
        )


def report(workspace: Path = HERE, again: bool = False) -> None:
    """Write the page to look at: pictures, clicks, models, counts and timings.

    Example: rpl report --workspace workspaces/demo

    Args:
        workspace: a folder made by `rpl build` or `rpl import`.
        again: run the stage even if nothing it depends on has changed.
    """
    run_stage(workspace, "report", again)


def run_stage(workspace: Path, stage: str, again: bool, workers: int | None = None) -> Ledger:
    """Run a stage of a workspace, and what is out of date before it."""
    from rpl_data.pipeline.build import recipe_of
    from rpl_data.workspace.workspace import Workspace

    return run_build(recipe_of(Workspace(workspace)), workspace, stage, stage if again else None, workers)


def run_build(
    recipe: Any, workspace: Path, until: str | None, again: str | None, workers: int | None = None
) -> Ledger:
    """Build with progress on the terminal, and say what came out."""
    from rpl_data.cli.screen import Screen, print_results
    from rpl_data.pipeline.build import STAGES, build
    from rpl_data.workspace.workspace import Workspace

    if again is not None and again not in (*STAGES, "all"):
        raise DataError(
            f"there is no stage {again!r} to run again; expected all or one of {', '.join(STAGES)}"
        )
    place = Workspace(workspace)
    with Screen() as screen:
        chosen = tuple(STAGES) if again == "all" else (again,) if again else ()
        ledger = build(recipe, place, until=until, again=chosen, workers=workers, tell=screen.tell)
    print_results(place, ledger, screen, until)
    return ledger
