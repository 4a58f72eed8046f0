"""Write the report: what was built, how good it is, and what the user should check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rpl_data.directions import Directions, coverage
from rpl_data.files import read_text, write_text
from rpl_data.meshes import load_mesh
from rpl_data.report.clicks import click_section, distance_table
from rpl_data.report.counts import SceneReport, summarise_scene
from rpl_data.report.coverage import coverage_section
from rpl_data.report.html import Cell, folded, number, page, prose, section, table, text
from rpl_data.report.networks import networks_section
from rpl_data.report.next_steps import next_steps, next_steps_list
from rpl_data.report.pictures import contact_sheet, frames_per_scene, legends
from rpl_data.report.solid import solid
from rpl_data.report.tables import labels_section, quality_section, timings_section
from rpl_data.types import QualityRow, Solution
from rpl_data.untrusted.yaml_text import read_yaml
from rpl_data.wording import counted
from rpl_data.workspace.workspace import Workspace


def write_report(
    workspace: Workspace,
    *,
    rows: Sequence[QualityRow] | None = None,
    timings: Mapping[str, Mapping[str, float | int]] | None = None,
    split: str | None = None,
    warnings: Sequence[str] = (),
    remarks: Mapping[str, Sequence[str]] | None = None,
    min_quality: float = 0.0,
) -> Path:
    """Write the page and return its path.

    Args:
        workspace: may be half built; what is missing is left out or named.
        rows: quality against truth, where truth is known.
        timings: by stage, `seconds` and, for stages that work by frame, `frames`.
        split: the summary of the split, plain text.
        warnings: lines of the build, shown with those of the solutions and the recordings.
        remarks: further lines about a recording, by its name.
        min_quality: frames with a label of a lower quality are not exported.
    """
    scenes = [summarise_scene(workspace, name, min_quality=min_quality) for name in workspace.video_names()]
    solutions = [
        workspace.load_placed(name)
        for name in workspace.object_names()
        if workspace.solution_file(name).exists()
    ]
    views = _views(scenes)
    parts = {
        "quality": quality_section(rows) if rows else "",
        "scenes": _scenes(workspace, scenes, solutions, remarks or {}),
        "objects": _objects(workspace, solutions),
        "labels": labels_section(scenes),
        "views": coverage_section(views),
        "networks": networks_section(
            {
                solution.model.name: workspace.load_network_views(solution.model.name)
                for solution in solutions
            },
            {solution.model.name: solution for solution in solutions},
        ),
        "split": section("split", "Split", f"<pre>{text(split.rstrip())}</pre>") if split else "",
        "timings": timings_section(timings) if timings else "",
    }
    links = "".join(f'<a href="#{name}">{name.capitalize()}</a>' for name, part in parts.items() if part)
    title = dataset_name(workspace)
    place = f'<p class="sub">{text(workspace.root.resolve())}</p>'
    head = f"<header><h1>{text(title)}</h1>{place}<nav>{links}</nav></header>"
    seen = {name: coverage(np.concatenate(list(by_scene.values()))) for name, by_scene in views.items()}
    advice = next_steps_list(next_steps(scenes, solutions, seen, clicked=_clicked(workspace)))
    top = _tiles(scenes, solutions) + advice + _warnings(scenes, solutions, warnings)
    body = head + top + "".join(parts.values())
    write_text(workspace.report, page(f"{title} · rpl report", body))
    return workspace.report


def dataset_name(workspace: Workspace) -> str:
    """The name in the recipe; the folder's name when the recipe has none."""
    if workspace.recipe_file.exists():
        recipe = read_yaml(read_text(workspace.recipe_file), source=str(workspace.recipe_file))
        if isinstance(recipe, dict) and recipe.get("name"):
            return str(recipe["name"])
    return workspace.root.resolve().name


# Sections -----------------------------------------------------------------------------------------


def _tiles(scenes: Sequence[SceneReport], solutions: Sequence[Solution]) -> str:
    """The counts, and behind them how good: the median of how far off labels are expected to be."""
    residuals = [residual for solution in solutions for residual in solution.residuals]
    tallies = [tally for scene in scenes for tally in scene.tallies.values()]
    off_px = [px for tally in tallies for px in tally.off_px]
    counts = [
        (len(scenes), "scene", ""),
        (len(solutions), "object", ""),
        (sum(len(scene.recording.scene.frames) for scene in scenes), "frame", ""),
        (sum(len(scene.frames) for scene in scenes), "frame", " labelled"),
        (sum(tally.instances for tally in tallies), "instance", ""),
        (len(residuals), "click", ""),
        (sum(residual.outlier for residual in residuals), "wrong click", ""),
    ]
    shown = [(number(n, 0), counted(n, noun).partition(" ")[2] + rest) for n, noun, rest in counts]
    if off_px:
        shown.append((number(float(np.median(off_px)), 1), "± px expected"))
    tiles = "".join(f"<div><b>{figure}</b><span>{name}</span></div>" for figure, name in shown)
    return f'<div class="tiles">{tiles}</div>'


def _clicked(workspace: Workspace) -> set[str]:
    """The recordings with clicks."""
    parts = workspace.parts()
    clicks = [c for name in workspace.object_names() for c in workspace.load_annotation(name).clicks]
    return {parts.video_of(click.scene) for click in clicks}


def _views(scenes: Sequence[SceneReport]) -> dict[str, dict[str, Directions]]:
    """By object and scene, the directions from which it was seen."""
    views: dict[str, dict[str, Directions]] = {}
    for scene in scenes:
        for name, tally in scene.tallies.items():
            views.setdefault(name, {})[scene.recording.scene.name] = np.array(tally.directions)
    return views


def _warnings(scenes: Sequence[SceneReport], solutions: Sequence[Solution], others: Sequence[str]) -> str:
    lines = list(others)
    for solution in solutions:
        said = [statement.text for statement in solution.statements]
        lines += [f"{solution.model.name}: {line}" for line in (*said, *solution.warnings)]
    for scene in scenes:
        recording = scene.recording
        lines += [f"scene {recording.scene.name}: {line}" for line in (*recording.skipped, *recording.notes)]
        if not scene.frames:
            lines.append(f"scene {recording.scene.name} has no labels")
    if not lines:
        return ""
    items = "".join(f"<li>{prose(line)}</li>" for line in dict.fromkeys(lines))
    return f'<section class="warnings" id="warnings"><h2>Worth knowing</h2><ul>{items}</ul></section>'


def _scenes(
    workspace: Workspace,
    scenes: Sequence[SceneReport],
    solutions: Sequence[Solution],
    remarks: Mapping[str, Sequence[str]],
) -> str:
    models = {solution.model.name: solution.model for solution in solutions}
    count = frames_per_scene(len(scenes))
    parts = [legends(models)]
    for scene in scenes:
        recording = scene.recording.scene
        parts.append(f"<h3>Scene {text(recording.name)}</h3>")
        words = [f"{len(scene.frames)} of {len(recording.frames)} frames labelled", recording.source]
        words += remarks.get(recording.name, ())
        parts.append(f'<p class="note">{prose(" · ".join(words))}</p>')
        if scene.frames:
            parts.append(contact_sheet(workspace, recording, scene.frames, models, count=count))
    note = (
        "Filled keypoints are seen, rings are hidden. The visible mask is tinted, its box has the same "
        "colour, the thin grey square is the paper's square box. Below: the share of each object that is "
        "seen, and the frame's quality, the lowest of its labels, red where it is poor."
    )
    return section("scenes", "Scenes", "".join(parts), note=note)


def _objects(workspace: Workspace, solutions: Sequence[Solution]) -> str:
    parts = []
    for number_of_object, solution in enumerate(solutions):
        path = workspace.mesh_file(solution.model.name)
        mesh = load_mesh(path) if path.exists() else None
        figure = solid(solution.model, mesh, with_library=number_of_object == 0)
        parts.append(
            f"<h3>{text(solution.model.name)}</h3>"
            f'<div class="pair">{figure}<div>{_keypoint_table(solution)}</div></div>'
            f"{click_section(solution)}{folded('distances between keypoints, mm', distance_table(solution))}"
        )
    return section("objects", "Objects", "".join(parts)) if parts else ""


def _keypoint_table(solution: Solution) -> str:
    """The keypoints: how far off they should be, clicks, outliers, and mean error of the other clicks."""
    model = solution.model
    body: list[list[str | Cell]] = []
    for k, name in enumerate(model.keypoints):
        own = [residual for residual in solution.residuals if residual.click.keypoint == k]
        fitting = [residual.error_px for residual in own if not residual.outlier]
        variance = float(np.trace(solution.covariance[k]))
        distance_mm = 1e3 * float(np.sqrt(variance)) if variance > 0 else float("nan")
        body.append(
            [
                name if name == str(k) else f"{k} {name}",
                number(distance_mm),
                str(len(own)),
                str(len(own) - len(fitting)),
                number(float(np.mean(fitting)), 1) if fitting else "–",
            ]
        )
    kinds = ["" if known else "quiet" for known in model.known]
    return table(("keypoint", "± mm", "clicks", "wrong", "mean px"), body, kinds=kinds)
