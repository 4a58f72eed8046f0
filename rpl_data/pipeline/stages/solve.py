"""Clicks -> the sparse model and where the objects stand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float64

from rpl_data.clicks.lift import lift_clicks
from rpl_data.clicks.log import Annotation
from rpl_data.geometry import Transform, transform
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.solve.diagnosis import Diagnosis
from rpl_data.solve.residuals import click_spreads_m
from rpl_data.solve.solve import place, solve
from rpl_data.types import (
    Click,
    ClickResidual,
    DataError,
    KeypointModel,
    Observation,
    Scene,
    Solution,
    Trajectory,
)
from rpl_data.workspace.workspace import Workspace

VERSION = 2
"""Raised when the stage writes something else for the same input; its steps then run again."""


def solve_steps(context: Context) -> list[Step]:
    """Clicks -> sparse model and scene transforms, an object."""
    return [_solve_step(context, item) for item in context.objects]


def _solve_step(context: Context, item: ObjectRecipe) -> Step:
    workspace, options = context.workspace, asdict(context.recipe.solve)

    def run(advance: Advance) -> Outcome:
        observations = observe(workspace, item.name)
        annotation = workspace.load_annotation(item.name)
        solution = solve_annotation(context, annotation, observations)
        workspace.save_solution(solution)
        outliers = sum(residual.outlier for residual in solution.residuals)
        unused = clicks_without_pose(annotation.clicks, observations)
        said = [statement.text for statement in solution.statements]
        lines = [f"{item.name}: {line}" for line in (*said, *unused, *solution.warnings)]
        details = {
            "clicks": len(observations),
            "outliers": outliers,
            "spread_mm": spreads_mm(solution, observations),
        }
        return Outcome(messages=tuple(lines), details=details)

    return step(
        "solve",
        item.name,
        run,
        version=VERSION,
        options=options
        | {"keypoints": list(item.keypoint_names), "skeleton": [list(e) for e in item.skeleton]}
        | {"parts": {video: list(map(list, spans)) for video, spans in workspace.parts().spans.items()}},
        sources=context.clicks_source(item.name),
        after=context.poses_of(),
        outputs=[workspace.solution_file(item.name)],
    )


def clicks_without_pose(clicks: Sequence[Click], observations: Sequence[Observation]) -> list[str]:
    """A line a scene about the clicks that were not lifted: in frames whose pose is not known."""
    lifted = {observation.click for observation in observations}
    frames: dict[str, set[int]] = {}
    for click in clicks:
        if click not in lifted:
            frames.setdefault(click.scene, set()).add(click.frame)
    return [
        f"scene {scene}: clicks in frames {', '.join(map(str, sorted(found)))} are not used, as the camera's "
        "pose is not known there"
        for scene, found in frames.items()
    ]


def spreads_mm(solution: Solution, observations: Sequence[Observation]) -> dict[str, dict[str, float]]:
    """How far the clicks of each keypoint lie apart over the frames of each scene; outliers left out."""
    outliers = {residual.click for residual in solution.residuals if residual.outlier}
    kept = [o for o in observations if o.click not in outliers]
    places = {
        scene: transform(placed, solution.model.points_object)
        for scene, placed in solution.scene_from_object.items()
    }
    found: dict[str, dict[str, float]] = {}
    for (scene, keypoint), spread_m in click_spreads_m(places, kept).items():
        found.setdefault(scene, {})[solution.model.keypoints[keypoint]] = round(1000 * spread_m, 2)
    return found


def solve_annotation(
    context: Context, annotation: Annotation, observations: Sequence[Observation]
) -> Solution:
    """The solution of some clicks of an object: its model found, or placed where it is known.

    Raises:
        DataError: the clicks do not tie the scenes, or do not place the known model.
    """
    item = next(item for item in context.objects if item.name == annotation.object)
    names = annotation.keypoints or item.keypoint_names
    skeleton = _by_name(item, names)
    if annotation.known_points is not None:
        return place_known(annotation, observations, skeleton)
    return solve(item.name, names, observations, method=context.recipe.solve.method, skeleton=skeleton)


def _by_name(item: ObjectRecipe, names: Sequence[str]) -> list[tuple[int, int]]:
    """The skeleton of the recipe in the numbers of the log, which may have been put in another order."""
    number = {name: k for k, name in enumerate(names)}
    pairs = [(item.keypoint_names[a], item.keypoint_names[b]) for a, b in item.skeleton]
    return [(number[a], number[b]) for a, b in pairs if a in number and b in number]


def place_known(
    annotation: Annotation, observations: Sequence[Observation], skeleton: Sequence[tuple[int, int]] = ()
) -> Solution:
    """A known model placed in every clicked scene (paper III-F); its origin moves to its centroid.

    The covariance is that of the clicks about the model, the same for all keypoints: how good a given
    model is cannot be known.

    Raises:
        DataError: a scene has too few clicks, or none that fit.
    """
    points = known_points(annotation)
    model = KeypointModel(
        annotation.object, annotation.keypoints, points - np.nanmean(points, axis=0), tuple(skeleton)
    )
    places: dict[str, Transform] = {}
    residuals: dict[tuple[int, str, int], ClickResidual] = {}
    diagnoses: list[Diagnosis] = []
    for scene in sorted({o.click.scene for o in observations}):
        mine = [o for o in observations if o.click.scene == scene]
        places[scene], found, said = place(model, mine)
        diagnoses.append(said)
        residuals |= {(r.click.keypoint, r.click.scene, r.click.frame): r for r in found}
    errors_m = [r.error_m for r in residuals.values() if r.error_m is not None and not r.outlier]
    sigma_m = max(float(np.sqrt(np.mean(np.square(errors_m)))) if errors_m else 0.0, 1e-3)
    covariance = np.where(model.known[:, None, None], sigma_m**2 * np.eye(3), np.nan)
    ordered = [residuals[o.click.keypoint, o.click.scene, o.click.frame] for o in observations]
    return Solution(
        model,
        covariance,
        places,
        tuple(ordered),
        statements=tuple(statement for said in diagnoses for statement in said.statements),
        expected_mm={scene: mm for said in diagnoses for scene, mm in said.expected_mm.items()},
        next_clicks=tuple(
            sorted((c for said in diagnoses for c in said.next_clicks), key=lambda c: -c.gain_mm)
        ),
    )


def known_points(annotation: Annotation) -> Float64[np.ndarray, "k 3"]:
    """The given model, a row a keypoint, NaN where it has none; DataError when it has fewer than three."""
    given = annotation.known_points or ()
    rows = [given[k] if k < len(given) else None for k in range(len(annotation.keypoints))]
    points = np.array([(np.nan,) * 3 if row is None else row for row in rows], dtype=float).reshape(-1, 3)
    known = int(np.isfinite(points).all(axis=1).sum())
    if known < 3:
        raise DataError(
            f"object {annotation.object}: its known model has {known} keypoints, at least 3 are needed; "
            "pick more of them on its mesh, or load a model that has them"
        )
    return points


def register_step(context: Context, object_name: str, scene: str) -> Step:
    """Place a known object in one more scene from its clicks there; the model stays as it is."""
    item = next((item for item in context.objects if item.name == object_name), None)
    if item is None:
        raise DataError(f"the recipe has no object {object_name!r}; it has {', '.join(context.object_names)}")

    def run(advance: Advance) -> Outcome:
        solution = context.workspace.load_solution(object_name)
        observations = observe(context.workspace, object_name, scene=scene)
        scene_from_object, residuals, said = place(solution.model, observations)
        context.workspace.save_solution(
            replace(
                solution,
                scene_from_object={**solution.scene_from_object, scene: scene_from_object},
                residuals=(*_elsewhere(solution.residuals, scene), *residuals),
                statements=(
                    *said.statements,
                    *(s for s in solution.statements if all(click.scene != scene for click in s.clicks)),
                ),
                expected_mm={**solution.expected_mm, **said.expected_mm},
                next_clicks=said.next_clicks,
            )
        )
        return Outcome(messages=tuple(_placed(solution.model, scene, residuals, said)))

    # It takes the place of the solve in the ledger, so that a build goes on from it and does not solve again.
    return replace(_solve_step(context, item), run=run)


def _elsewhere(residuals: Sequence[ClickResidual], scene: str) -> list[ClickResidual]:
    return [residual for residual in residuals if residual.click.scene != scene]


def _placed(
    model: KeypointModel, scene: str, residuals: Sequence[ClickResidual], said: Diagnosis
) -> Iterator[str]:
    """How well a new scene's clicks place the object, what they contradict, and what to click next."""
    mean_px = float(np.mean([residual.error_px for residual in residuals]))
    yield (
        f"{model.name} stands in scene {scene}; its {len(residuals)} clicks fit to {mean_px:.1f} px, and its "
        f"keypoints should be {said.expected_mm[scene]:.1f} mm off"
    )
    yield from (statement.text for statement in said.statements)
    if said.next_clicks:
        best = said.next_clicks[0]
        yield (
            f"the click that would help most: keypoint {model.keypoints[best.keypoint]} in frame "
            f"{best.frame}, which should leave {best.left_mm:.1f} mm"
        )


def observe(workspace: Workspace, object_name: str, *, scene: str | None = None) -> list[Observation]:
    """The clicks of an object (in one scene, or all), lifted; those in frames without a pose are left out.

    Raises:
        DataError: there are none, or a click cannot be lifted.
    """
    clicks = workspace.load_annotation(object_name).clicks
    if scene is not None:
        clicks = tuple(click for click in clicks if click.scene == scene)
    where = f" in scene {scene}" if scene else ""
    if not clicks:
        raise DataError(
            f"object {object_name} has no clicks{where}; mark them with `rpl annotate {workspace.root}`, "
            "name a CSV file with `clicks:` in the recipe, or run "
            f"`rpl clicks import FILE.csv --workspace {workspace.root}`"
        )
    scenes = {name: workspace.load_scene(name) for name in workspace.scene_names()}
    trajectories = {
        name: workspace.load_trajectory(scenes[name]) for name in {c.scene for c in clicks} & scenes.keys()
    }
    posed = [
        c for c in clicks if not (c.scene in scenes and _lost(c, scenes[c.scene], trajectories[c.scene]))
    ]
    if not posed:
        raise DataError(
            f"object {object_name}: all {len(clicks)} clicks{where} are in frames whose pose is not known; "
            "click in others"
        )
    return lift_clicks(posed, scenes, trajectories, workspace.depth_reader)


def _lost(click: Click, scene: Scene, trajectory: Trajectory) -> bool:
    """The clicked frame lies within the recording, but has no pose or was left out for having none."""
    within = scene.frames and scene.frames[0].index <= click.frame <= scene.frames[-1].index
    return bool(within) and click.frame not in trajectory.frames
