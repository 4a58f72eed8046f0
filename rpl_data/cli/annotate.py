"""`rpl annotate`: the annotation page, joined with the stages it can run."""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64

from rpl_data.annotate import Address, Work
from rpl_data.annotate.work import Tell
from rpl_data.geometry import invert
from rpl_data.label.certainty import HALF_QUALITY_PX, expected_error_px
from rpl_data.pipeline.automatic import find_step
from rpl_data.pipeline.build import (
    build,
    context_of,
    recipe_of,
    run_step,
    save_recipe,
    stale_steps,
)
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.grasp import object_from_grasp
from rpl_data.pipeline.progress import Progress
from rpl_data.pipeline.recipe import ObjectRecipe
from rpl_data.pipeline.results import sparse_labels
from rpl_data.pipeline.stages.solve import solve_annotation_unchecked
from rpl_data.solve.expected import expected_px
from rpl_data.solve.solve import register
from rpl_data.types import DataError, Intrinsics, Solution
from rpl_data.types.instances import scene_of
from rpl_data.workspace.workspace import Workspace


def address_of(host: str, port: int) -> Address:
    """Where to listen; a token is made up for every address but this machine's own."""
    try:
        local = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = False
    if not 1 <= port <= 65535:
        raise DataError(f"there is no port {port}; choose one from 1024 to 65535")
    return Address(host, port, None if local else secrets.token_urlsafe(18))


def work_of(workspace: Workspace) -> Work:
    """The stages, for the page of a workspace."""
    _context(workspace)  # says what is wrong before the page opens
    return Work(
        solve=lambda annotation, observations: solve_annotation_unchecked(
            _context(workspace), annotation, observations
        ),
        register=register,
        objects=lambda: _context(workspace).object_names,
        add_object=lambda name, keypoints: _add_object(workspace, name, keypoints),
        grasp=lambda clicks, solution: object_from_grasp(workspace, clicks, solution),
        run=lambda stage, tell: _run(workspace, stage, tell),
        fresh=lambda: _fresh(workspace),
        find=lambda name, scene, tell: _find(workspace, name, scene, tell),
        expected_px=lambda solution, scene: _expected_px(workspace, solution, scene),
        limits_px=lambda: (HALF_QUALITY_PX, expected_error_px(_context(workspace).recipe.export.min_quality)),
    )


def _context(workspace: Workspace) -> Context:
    """The context of the recipe as it is on the disk; read again when it has changed."""
    try:
        status = workspace.recipe_file.stat()
    except OSError:
        return context_of(workspace)  # which says what is wrong
    return _context_at(workspace, status.st_mtime_ns, status.st_size)


@lru_cache(4)
def _context_at(workspace: Workspace, *stamp: int) -> Context:
    return context_of(workspace)


def _add_object(workspace: Workspace, name: str, keypoints: Sequence[str]) -> None:
    """Write the object into the workspace's recipe; a twin's own objects are written out with it."""
    context = context_of(workspace)
    new = ObjectRecipe(name, tuple(keypoints))
    recipe = replace(context.recipe, scenes=context.scene_sources, objects=(*context.objects, new))
    save_recipe(recipe, workspace)
    build(recipe, workspace, until="clicks", workers=1)


def _run(workspace: Workspace, stage: str, tell: Tell) -> list[str]:
    """What the steps had to say, and where an export is."""
    lines: list[str] = []

    def told(progress: Progress) -> None:
        tell(f"{progress.stage} {progress.item}".strip(), progress.done, progress.total)
        if progress.state == "ran":
            lines.extend(progress.outcome.messages)
        if progress.state != "runs" and "images" in progress.outcome.details:
            images = progress.outcome.details["images"]
            counts = ", ".join(f"{count} of {split}" for split, count in images.items())
            lines.append(f"{workspace.export(progress.item).resolve()}: images: {counts}")

    ledger = build(recipe_of(workspace), workspace, until=stage, tell=told)
    if stage == "report":
        lines.append(f"report: {workspace.report.resolve()}")
    if stage != "segment":
        lines.extend(sparse_labels(ledger.of_stage("label").values()))
    return lines


def _find(workspace: Workspace, name: str, scene: str, tell: Tell) -> list[str]:
    """What was found of an object in a scene without clicks."""

    def told(progress: Progress) -> None:
        tell(f"finding {name} in scene {scene}", progress.done, progress.total)

    entry = run_step(
        recipe_of(workspace),
        workspace,
        lambda context, advance: find_step(context, name, scene, advance),
        title=("register", name),
        tell=told,
    )
    return list(entry.outcome.messages)


VIEWS = 40
"""Frames of a scene, spread over it, in which the expected error in pixels is computed."""


def _expected_px(workspace: Workspace, solution: Solution, scene: str) -> float:
    """The expected error of the keypoints in the images of a scene."""
    recorded = scene_of(scene)
    files = workspace.scene_file(recorded), workspace.trajectory_file(recorded)
    camera, poses = _camera(workspace, recorded, *(path.stat().st_mtime_ns for path in files))
    object_from_camera = invert(solution.scene_from_object[scene]) @ poses
    return expected_px(
        solution.covariance_at(scene), solution.model.points_object, camera, object_from_camera
    )


@lru_cache(256)
def _camera(workspace: Workspace, name: str, *stamps: int) -> tuple[Intrinsics, Float64[np.ndarray, "f 4 4"]]:
    """The camera of a scene and `VIEWS` of its poses; read again when their files have changed.

    A recording of minutes takes longer to read than a click to answer.
    """
    scene = workspace.load_scene(name)
    poses = workspace.load_trajectory(scene).scene_from_camera
    return scene.intrinsics, poses[:: -(-len(poses) // VIEWS)]


def _fresh(workspace: Workspace) -> dict[str, bool]:
    found = stale_steps(_context(workspace).recipe, workspace)
    return {stage: bool(steps) and all(holds for _, holds in steps) for stage, steps in found.items()}
