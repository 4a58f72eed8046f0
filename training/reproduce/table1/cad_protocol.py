"""The paper's protocol on a whole workspace: GT-CAD on every scene, GT-SPARSE and GT-CAD projected back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rpl_data.evaluate.cad import Cad, CadInScene, SparseOnCad, align_scene, align_sparse
from rpl_data.evaluate.quality import LabelErrors, ModelError, label_errors, merged, summarise
from rpl_data.evaluate.truth import TrueObject, true_labels
from rpl_data.geometry import Transform, invert
from rpl_data.meshes import load_mesh
from rpl_data.pipeline.lifted_clicks import observe
from rpl_data.solve.solve import register
from rpl_data.types import DataError, KeypointModel, QualityRow, Solution
from rpl_data.workspace.workspace import Workspace

PICKED_WITHIN_M = 0.002
"""Standard deviation on each axis of a hand that picks a landmark on a CAD."""


@dataclass(frozen=True)
class CadResult:
    """The result of one object under the paper's protocol.

    Attributes:
        row: errors; its 3D error is the distance to the closest points of the CAD.
        scenes: how GT-CAD lies on each scene, and whether the clicks or our own solution started it.
        left_out: scenes to whose surface the CAD could not be aligned, and why; their labels are not judged.
    """

    row: QualityRow
    scenes: Mapping[str, tuple[CadInScene, str]]
    left_out: Mapping[str, str]


# The CAD models -----------------------------------------------------------------------------------


def true_cads(truth: Workspace, names: Sequence[str], *, seed: int) -> dict[str, Cad]:
    """The true meshes, with keypoints picked on them as a hand would: up to `PICKED_WITHIN_M` off."""
    cads = {}
    for number, name in enumerate(names):
        if truth.mesh_file(name).exists() and truth.solution_file(name).exists():
            points = truth.load_solution(name).model.points_object
            noise = np.random.default_rng([seed, 3, number]).standard_normal(points.shape)
            cads[name] = Cad(name, load_mesh(truth.mesh_file(name)), points + PICKED_WITHIN_M * noise)
    return cads


# Alignment ----------------------------------------------------------------------------------------


def by_cad(workspace: Workspace, cads: Mapping[str, Cad]) -> dict[str, CadResult]:
    """Judge every object that has a CAD by the paper's protocol."""
    solutions = {name: workspace.load_placed(name) for name in cads}
    sparse = {name: align_sparse(cad, solutions[name].model) for name, cad in cads.items()}
    places: dict[str, dict[str, tuple[CadInScene, str]]] = {name: {} for name in cads}
    left_out: dict[str, dict[str, str]] = {name: {} for name in cads}
    errors: dict[str, list[LabelErrors]] = {name: [] for name in cads}
    parts, labelled = workspace.parts(), set(workspace.labelled_scene_names())
    for scene in [scene for scene in workspace.scene_names() if parts.video_of(scene) in labelled]:
        for name in [name for name in cads if scene in solutions[name].scene_from_object]:
            try:
                places[name][scene] = place(workspace, cads[name], solutions[name], sparse[name], scene)
            except DataError as error:
                left_out[name][scene] = str(error)
        standing = {name: own[scene][0].scene_from_cad for name, own in places.items() if scene in own}
        found = errors_in(workspace, scene, cads, sparse, standing)
        for name in standing.keys() & found.keys():
            errors[name].append(found[name])
    rows = {
        name: summarise(
            name,
            solutions[name].model,
            ModelError(sparse[name].distances_m, sparse[name].cad_from_object),
            merged(errors[name]),
        )
        for name in cads
    }
    return {name: CadResult(rows[name], places[name], left_out[name]) for name in cads}


def place(
    workspace: Workspace, cad: Cad, solution: Solution, sparse: SparseOnCad, scene: str
) -> tuple[CadInScene, str]:
    """Align GT-CAD to the surface of a scene; what the alignment started from comes back too.

    The start is the paper's by hand: the keypoints clicked in the scene against those picked on the
    CAD. Where too few are clicked, it is the solution that is being judged.
    """
    surface = load_mesh(workspace.surface_file(scene))
    try:
        picked = KeypointModel(cad.object, solution.model.keypoints, cad.picked)
        start, _ = register(picked, observe(workspace, cad.object, scene=scene))
        started = "clicks"
    except DataError:
        start = solution.scene_from_object[scene] @ invert(sparse.cad_from_object)
        started = "solution"
    return align_scene(cad, surface, start), started


def errors_in(
    workspace: Workspace,
    name: str,
    cads: Mapping[str, Cad],
    sparse: Mapping[str, SparseOnCad],
    scene_from_cad: Mapping[str, Transform],
) -> dict[str, LabelErrors]:
    """The labels of a scene against GT-SPARSE and GT-CAD, carried by the same trajectory.

    Those of a recording that was cut are filed under the recording's name.
    """
    scene = workspace.load_scene(name)
    trajectory = workspace.load_trajectory(scene)
    parts = workspace.parts()
    video = parts.video_of(name)
    labels = [one for one in workspace.load_labels(video) if parts.scene_at(video, one.frame) == name]

    def poses(scene_from: Transform) -> Iterator[tuple[tuple[str, int], Transform]]:
        for label in labels:
            yield (video, label.frame), invert(trajectory.at(label.frame)) @ scene_from

    truth = tuple(
        TrueObject(_gt_sparse(workspace, one, sparse[one]), cads[one].mesh, dict(poses(scene_from)))
        for one, scene_from in scene_from_cad.items()
    )
    alignments = {one: sparse[one].cad_from_object for one in scene_from_cad}
    return label_errors(labels, true_labels(replace(scene, name=video), truth), alignments)


def _gt_sparse(workspace: Workspace, name: str, sparse: SparseOnCad) -> KeypointModel:
    model = workspace.load_placed(name).model
    return KeypointModel(name, model.keypoints, sparse.gt_sparse, model.skeleton)
