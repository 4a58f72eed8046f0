"""Stage `refine`: register the scenes of each object on one another, by their surfaces and the clicks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from rpl_data.meshes import load_mesh, moved_cloud
from rpl_data.pipeline.context import Box3, Context, crop_of, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.pipeline.lifted_clicks import observe
from rpl_data.pipeline.placements import standing, with_placements, without_scenes
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.refine.evidence import Verdict
from rpl_data.solve.witnesses import Contradiction
from rpl_data.types import PointCloud, Solution
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace

VERSION = 4
"""Increase it when the stage writes something else for the same input: its steps then run again."""


def refine_steps(context: Context) -> list[Step]:
    """Plan the registration of the scenes, one step per object; nothing when the recipe turns it off."""
    if not context.recipe.refine.scenes:
        return []
    return [_refine_step(context, item) for item in context.objects]


def forget_refined(context: Context) -> None:
    """Remove refined solutions when the recipe turns refinement off, so that the clicks' own count again."""
    if not context.recipe.refine.scenes:
        for name in context.object_names:
            context.workspace.remove_refined(name)


def _refine_step(context: Context, item: ObjectRecipe) -> Step:
    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m
    places = context.still_places(workspace.load_solution(item.name).scene_from_object)
    scenes = sorted({scene_of(place) for place in places})
    crop = crop_of(workspace, item)

    def run(advance: Advance) -> Outcome:
        from rpl_data.refine.refine import refine_scenes
        from rpl_data.solve.joint import joint_clicks

        placed, whole = standing(workspace, item.name), workspace.load_solution(item.name)
        solution, annotation = without_scenes(whole, placed), workspace.load_annotation(item.name)
        if not solution.scene_from_object:
            workspace.save_refined(whole)
            return Outcome()
        hold = annotation.known_points is not None
        observations = observe(workspace, item.name, without=context.lost)
        clicks = joint_clicks(solution, observations, hold_points=hold)
        regions = scene_regions(workspace, solution, places, voxel_m, crop)
        found = refine_scenes(
            regions, clicks.scenes, clicks.scene_from_object, clicks.points_object, clicks.terms, clicks.costs
        )
        judged = dict(zip(clicks.scenes, found.verdicts, strict=True))
        verdicts = {name: verdict for name, verdict in judged.items() if name in places}
        lines = kept_by_clicks(verdicts)
        if found.registered:
            settled = [name for name, verdict in verdicts.items() if verdict.accepted]
            poses, points = found.scene_from_object, found.points_object
            apart = clicks.contradiction(poses, points, settled)
            solution = clicks.solved(poses, points, found.normal, settled=settled, widened=apart.factor)
            lines += [] if hold else contradicting(apart)
        workspace.save_refined(with_placements(solution, placed))
        return Outcome(
            messages=tuple(f"{item.name}: {line}" for line in lines),
            details={"scenes": {name: asdict(verdict) for name, verdict in verdicts.items()}},
        )

    return step(
        "refine",
        item.name,
        run,
        version=VERSION,
        options={"voxel_m": voxel_m, "crop": crop},
        after=[f"solve/{item.name}", *(f"surface/{name}" for name in scenes)],
        outputs=[workspace.refined_file(item.name)],
    )


def scene_regions(
    workspace: Workspace, solution: Solution, places: Sequence[str], voxel_m: float, crop_m: Box3 | None
) -> dict[str, PointCloud]:
    """The object's surface as each scene saw it, scene frame; one per instance."""
    from rpl_data.segment.scene_regions import grown_regions

    surfaces = {
        place: load_mesh(workspace.surface_file(scene_of(place)))
        for place in places
        if place in solution.scene_from_object
    }
    grown = grown_regions(surfaces, solution, voxel_m=voxel_m, crop_m=crop_m)
    return {place: moved_cloud(region, solution.scene_from_object[place]) for place, region in grown.items()}


def kept_by_clicks(verdicts: dict[str, Verdict]) -> list[str]:
    """One line per reason, naming the scenes whose pose stays that of the clicks."""
    scenes: dict[str, list[str]] = {}
    for name, verdict in verdicts.items():
        if not verdict.accepted:
            scenes.setdefault(verdict.reason, []).append(name)
    return [
        f"scene {', '.join(names)} stays where its clicks put it: {reason}"
        for reason, names in scenes.items()
    ]


def contradicting(found: Contradiction) -> list[str]:
    """A line where clicks and surfaces contradict each other by more than is stated of them."""
    if not found.beyond_chance:
        return []
    return [
        "its clicks and its surfaces contradict each other by more than chance explains, so its errors are "
        f"stated {found.factor:.1f} times as large as the two together would have them; depth that is off "
        "on a whole face, or beside its colour, does that, and so do clicks that are wrong alike"
    ]
