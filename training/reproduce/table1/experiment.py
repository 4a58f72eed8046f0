"""Table I: how accurate the sparse models and the labels are, beside the paper's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rpl_data.types import DataError

from .rows import Row, Trajectories, scores_of

if TYPE_CHECKING:
    from rpl_data.evaluate.cad import Cad
    from rpl_data.types import QualityRow
    from rpl_data.workspace.workspace import Workspace

    from .cad_protocol import CadResult


def table1(
    sources: Path | list[Path],
    out: Path = Path("runs/table1"),
    root: Path | None = None,
    trajectories: list[Trajectories] | None = None,
    cad: Path | None = None,
    cad_metres_per_unit: float = 1.0,
    baseline: bool = True,
    seed: int = 0,
    workers: int | None = None,
) -> None:
    """Accuracy of sparse models and labels (the paper's Table I), one row per object, by two protocols.

    Strict: true correspondences and true poses, nothing aligned in the image; it needs a twin, or `truth:`
    in the recipe. The paper's: a CAD aligned by ICP to the sparse model and to every scene; it needs a CAD,
    which a twin has, and for which real recordings name a folder.

    Args:
        sources: a built workspace, a recipe (which is built first), or a list of them: '[a, b]'.
        out: folder for table1.json, table1.html and the workspaces that are made.
        root: where the relative paths of recipes start; the recipe's own folder when left out.
        trajectories: '[given, drifting, tracked]' or some of them; drifting ones (5 mm and 0.3 degrees at
            the end of a video) and tracked ones are made of a twin's recording. Given ones when left out.
        cad: folder with <object>.obj (or .ply, .stl) and <object>.pp, the keypoints picked on it.
        cad_metres_per_unit: of those meshes and points; 0.001 for millimetres.
        baseline: where the truth is known, also build the paper's own chain (`method: paper`) on the same
            recordings and clicks: as it is, and with a careful hand that clicks and crops.
        seed: of the drift and of the simulated picks on a twin's CAD.
        workers: processes; one per core when left out.
    """
    from .page import as_text, write_page

    kinds: tuple[Trajectories, ...] = tuple(dict.fromkeys(trajectories or ("given",)))
    rows: list[Row] = []
    for source in sources if isinstance(sources, list) else [sources]:
        workspace = built(source, out / "workspaces", root=root, workers=workers)
        for kind in kinds:
            place = in_kind(workspace, kind, out, seed=seed, workers=workers)
            found = measure(place, cad_folder=cad, metres_per_unit=cad_metres_per_unit, seed=seed)
            if baseline:
                folder = out / "workspaces" / f"{workspace.root.resolve().name}_{kind}_baseline"
                found = with_baseline(found, place, folder, tracked=kind == "tracked", workers=workers)
            rows += [replace(row, workspace=workspace.root.name, trajectories=kind) for row in found]
    path = write_page(out, rows, seed=seed)
    print(as_text(rows))
    print(path)


# Workspaces ---------------------------------------------------------------------------------------


def built(source: Path, folder: Path, *, root: Path | None, workers: int | None) -> Workspace:
    """Open a workspace, or build a recipe."""
    from rpl_data.pipeline.recipe_file import load_recipe
    from rpl_data.workspace.workspace import Workspace

    from ..building import build_and_tell

    if not source.is_file():
        return Workspace(source)
    workspace = Workspace(folder / source.stem)
    build_and_tell(load_recipe(source, root=root), workspace, workers=workers)
    return workspace


def in_kind(
    workspace: Workspace, kind: Trajectories, out: Path, *, seed: int, workers: int | None
) -> Workspace:
    """The workspace itself, or one with the same pixels and other camera paths, built up to its labels."""
    from rpl_data.workspace.workspace import Workspace

    from ..building import build_and_tell
    from .trajectories import with_trajectories

    if kind == "given":
        return workspace
    name = f"{workspace.root.resolve().name}_{kind}"
    recipe = with_trajectories(workspace, kind, out / "recordings" / name, seed=seed)
    changed = Workspace(out / "workspaces" / name)
    build_and_tell(recipe, changed, until="label", workers=workers)
    return changed


def with_baseline(
    rows: Sequence[Row], workspace: Workspace, folder: Path, *, tracked: bool, workers: int | None
) -> list[Row]:
    """The rows with the errors of the paper's chain; unchanged where the truth is not known."""
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.context import truth_workspace

    from .baseline import careful_scores, papers_scores

    truth = truth_workspace(context_of(workspace))
    if truth is None:
        return list(rows)
    paper = papers_scores(workspace, truth, folder / "paper", tracked=tracked, workers=workers)
    careful = careful_scores(workspace, truth, folder / "careful", tracked=tracked, workers=workers)
    return [replace(row, paper=paper.get(row.object), careful=careful.get(row.object)) for row in rows]


# Rows ---------------------------------------------------------------------------------------------


def measure(
    workspace: Workspace, *, cad_folder: Path | None = None, metres_per_unit: float = 1.0, seed: int = 0
) -> list[Row]:
    """Measure a built workspace: one row per object.

    Raises:
        DataError: neither truth nor a CAD is known.
    """
    from rpl_data.evaluate.quality import compare_workspaces
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.context import truth_workspace

    from .cad_protocol import by_cad
    from .worst import worst_scenes

    context = context_of(workspace)
    truth = truth_workspace(context)
    cads = _cads(workspace, truth, context.object_names, cad_folder, metres_per_unit, seed)
    if truth is None and not cads:
        raise DataError(
            f"the truth of {workspace.root} is not known: name it with `truth:` in the recipe, or give a "
            "folder with CAD models (--cad)"
        )
    strict = {} if truth is None else {row.object: row for row in compare_workspaces(workspace, truth)}
    aligned = by_cad(workspace, cads)
    worst = {} if truth is None else worst_scenes(workspace, truth)
    labels = labels_of(workspace)
    rows = [
        _row(workspace, name, labels.get(name, 0), strict.get(name), aligned.get(name))
        for name in context.object_names
    ]
    return [replace(row, worst=worst.get(row.object)) for row in rows]


def _cads(
    workspace: Workspace,
    truth: Workspace | None,
    names: Sequence[str],
    folder: Path | None,
    metres_per_unit: float,
    seed: int,
) -> dict[str, Cad]:
    from rpl_data.evaluate.cad import cads_in

    from .cad_protocol import true_cads

    if folder is not None:
        models = [workspace.load_solution(name).model for name in names]
        keypoints = {model.name: model.keypoints for model in models}
        return cads_in(folder, keypoints, metres_per_unit=metres_per_unit)
    return {} if truth is None else true_cads(truth, names, seed=seed)


def _row(
    workspace: Workspace, name: str, labels: int, strict: QualityRow | None, aligned: CadResult | None
) -> Row:
    solution = workspace.load_placed(name)
    places = list(aligned.scenes.values()) if aligned else []
    return Row(
        workspace=workspace.root.name,
        trajectories="given",
        object=name,
        keypoints=len(solution.model.keypoints),
        scenes=len(solution.scene_from_object),
        labels=labels,
        strict=scores_of(strict) if strict else None,
        by_cad=replace(scores_of(aligned.row), iou_visible=float("nan")) if aligned else None,
        started_by_solution=sum(started == "solution" for _, started in places),
        left_out=tuple(f"{scene}: {why}" for scene, why in aligned.left_out.items()) if aligned else (),
        cad_rms_mm=1e3 * sum(p.rms_m for p, _ in places) / len(places) if places else float("nan"),
    )


def labels_of(workspace: Workspace) -> dict[str, int]:
    """Labelled frames of every object."""
    counts: dict[str, int] = {}
    for scene in workspace.labelled_scene_names():
        for label in workspace.load_labels(scene):
            for instance in label.instances:
                counts[instance.object] = counts.get(instance.object, 0) + 1
    return counts
