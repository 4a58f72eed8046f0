"""Stage `solve`: find the sparse model of each object, and where it stands in each scene, from clicks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import combinations

import numpy as np

from rpl_data.clicks.log import Annotation
from rpl_data.drift.drift import drift_from_json
from rpl_data.files import read_json
from rpl_data.geometry import transform
from rpl_data.pipeline.context import Context, known_points, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step, stamps
from rpl_data.pipeline.lifted_clicks import observe
from rpl_data.pipeline.placements import (
    fallen_lines,
    solved_from,
    standing,
    thin_lines,
    with_placements,
)
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.solve.register import register_scene
from rpl_data.solve.residuals import click_spreads_m
from rpl_data.solve.solve import Unchecked, solve_unchecked
from rpl_data.types import (
    Click,
    KeypointModel,
    Observation,
    Solution,
)
from rpl_data.types.instances import frame_of, scene_of
from rpl_data.workspace.workspace import Workspace

VERSION = 8
"""Increase it when the stage writes something else for the same input: its steps then run again."""
SAME_PLACE_SHARE = 0.05
"""Two solid objects cannot stand so close, as a share of the diagonal around their keypoints."""
STRAYED_SHARE = 0.35
"""Standard deviation of drifting poses about their middle, per axis, as a share of what the meter reads."""


def solve_steps(context: Context) -> list[Step]:
    """Plan the steps that solve the objects, one per object."""
    return [solve_step(context, item) for item in context.objects]


def solve_step(context: Context, item: ObjectRecipe) -> Step:
    """Plan the solve of one object; scenes that were registered follow its model."""
    workspace, options = context.workspace, asdict(context.recipe.solve)

    def run(advance: Advance) -> Outcome:
        observations = observe(workspace, item.name, without=context.lost)
        annotation = workspace.load_annotation(item.name)
        solution = solve_annotation(context, annotation, observations)
        workspace.save_solution(solution)
        outliers = sum(residual.outlier for residual in solution.residuals)
        parts = workspace.parts()
        clicks = [c for c in annotation.clicks if parts.video_of(c.scene) not in context.lost]
        unused = clicks_without_pose(clicks, observations)
        said = [statement.text for statement in solution.statements]
        moved, thin = fallen_lines(workspace, item.name), thin_lines(observations)
        twice = instances_in_one_place(solution)
        lines = [
            f"{item.name}: {line}" for line in (*said, *twice, *moved, *unused, *thin, *solution.warnings)
        ]
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
        | {"parts": {video: list(map(list, spans)) for video, spans in workspace.parts().spans.items()}}
        | ({"without": sorted(context.lost)} if context.lost else {}),
        sources=context.clicks_source(item.name) | stamps(workspace.placed_file(item.name)),
        after=context.poses_of(),
        outputs=[workspace.solution_file(item.name)],
    )


def instances_in_one_place(solution: Solution) -> list[str]:
    """A line for each two instances of a scene that stand in each other: one object, marked twice."""
    size_m = float(np.linalg.norm(np.ptp(solution.model.points_object[solution.model.known], axis=0)))
    placed = {
        place: transform(pose, solution.model.points_object)
        for place, pose in solution.scene_from_object.items()
    }
    lines = []
    for one, other in combinations(sorted(placed), 2):
        if scene_of(one) != scene_of(other) or frame_of(one) != frame_of(other):
            continue
        apart_m = float(np.nanmean(np.linalg.norm(placed[one] - placed[other], axis=1)))
        if apart_m < SAME_PLACE_SHARE * size_m:
            lines.append(
                f"{one} and {other} are in one place: their keypoints lie {1000 * apart_m:.1f} mm apart, so "
                "the same object was marked as two instances and would be labelled twice; take back the "
                "clicks of one of them"
            )
    return lines


def clicks_without_pose(clicks: Sequence[Click], observations: Sequence[Observation]) -> list[str]:
    """One line per scene about the clicks that were not lifted: in frames whose pose is not known."""
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

    Scenes that `rpl register` placed take no part in it, and are added to it.

    Raises:
        DataError: the clicks do not tie the scenes, or do not place the known model.
    """
    solution, check = solve_annotation_unchecked(context, annotation, observations)
    return solution if check is None else check(lambda: None)


def solve_annotation_unchecked(
    context: Context, annotation: Annotation, observations: Sequence[Observation]
) -> Unchecked:
    """As `solve_annotation`, for a person who waits: see `Unchecked`."""
    item = next(item for item in context.objects if item.name == annotation.object)
    placed = standing(context.workspace, item.name)
    observations = solved_from(context.workspace, item.name, observations)
    solution, check = _unchecked(context, item, annotation, observations)
    return Unchecked(
        with_placements(solution, placed),
        None if check is None else lambda go_on: with_placements(check(go_on), placed),
    )


def _unchecked(
    context: Context, item: ObjectRecipe, annotation: Annotation, observations: Sequence[Observation]
) -> Unchecked:
    """The solution of these clicks alone."""
    names = annotation.keypoints or item.keypoint_names
    skeleton = _by_name(item, names)
    if annotation.known_points is not None:
        strayed_m = trajectory_sigmas_m(context.workspace, {o.click.scene for o in observations})
        known = place_known(annotation, observations, skeleton, trajectory_sigma_m=strayed_m)
        return Unchecked(known, None)
    return solve_unchecked(
        item.name,
        names,
        observations,
        method=context.recipe.solve.method,
        skeleton=skeleton,
        trajectory_sigma_m=trajectory_sigmas_m(context.workspace, {o.click.scene for o in observations}),
    )


def trajectory_sigmas_m(workspace: Workspace, scenes: Iterable[str]) -> dict[str, float]:
    """How far the poses of each scene stray, standard deviation per axis, where drift was measured.

    What neighbouring frames disagree by is the depth camera's noise, not the poses'. Poses that stray by so
    much from end to end scatter about their middle by a third of it (measured on twins that drift by 5 mm and
    on a real desk whose poses are known to stray: 0.3 to 0.5).
    """
    parts, found = workspace.parts(), {}
    for scene in scenes:
        file = workspace.drift_file(parts.video_of(scene))
        if file.exists() and parts.video_of(scene) not in parts.moving:  # there it measures the objects
            drift = drift_from_json(read_json(file))
            strayed_m = float(np.sqrt(max(drift.whole_m**2 - drift.noise_m**2, 0.0)))
            found[scene] = STRAYED_SHARE * strayed_m
    return found


def _by_name(item: ObjectRecipe, names: Sequence[str]) -> list[tuple[int, int]]:
    """The skeleton of the recipe in the numbers of the log, which may have been put in another order."""
    number = {name: k for k, name in enumerate(names)}
    pairs = [(item.keypoint_names[a], item.keypoint_names[b]) for a, b in item.skeleton]
    return [(number[a], number[b]) for a, b in pairs if a in number and b in number]


def place_known(
    annotation: Annotation,
    observations: Sequence[Observation],
    skeleton: Sequence[tuple[int, int]] = (),
    *,
    trajectory_sigma_m: Mapping[str, float] | None = None,
) -> Solution:
    """A known model placed in every clicked scene (paper III-F); its origin moves to its centroid.

    The covariance is that of the clicks about the model, alike in all directions and the same for all
    keypoints: how good a given model is cannot be known.

    Args:
        trajectory_sigma_m: how far the poses of each scene stray, standard deviation per axis.

    Raises:
        DataError: a scene has too few clicks, or none that fit.
    """
    points, strayed_m = known_points(annotation), trajectory_sigma_m or {}
    model = KeypointModel(
        annotation.object, annotation.keypoints, points - np.nanmean(points, axis=0), tuple(skeleton)
    )
    found = {
        scene: register_scene(
            model,
            [o for o in observations if o.click.scene == scene],
            trajectory_sigma_m=strayed_m.get(scene, 0.0),
        )
        for scene in sorted({o.click.scene for o in observations})
    }
    residuals = {
        (r.click.keypoint, r.click.scene, r.click.frame): r for one in found.values() for r in one.residuals
    }
    errors_m = [r.error_m for r in residuals.values() if r.error_m is not None and not r.outlier]
    off_m = max(float(np.sqrt(np.mean(np.square(errors_m)))) if errors_m else 0.0, 1e-3)
    return Solution(
        model=model,
        covariance=np.where(model.known[:, None, None], off_m**2 / 3 * np.eye(3), np.nan),
        scene_from_object={scene: one.scene_from_object for scene, one in found.items()},
        residuals=tuple(residuals[o.click.keypoint, o.click.scene, o.click.frame] for o in observations),
        covariance_in_scene={scene: one.covariance_in_scene for scene, one in found.items()},
        trajectory_sigma_m={scene: one.trajectory_sigma_m for scene, one in found.items()},
        statements=tuple(statement for one in found.values() for statement in one.statements),
        next_clicks=tuple(
            sorted((c for one in found.values() for c in one.next_clicks), key=lambda c: -c.gain_mm)
        ),
    )
