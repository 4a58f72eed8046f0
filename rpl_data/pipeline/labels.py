"""Dense models and poses -> labels of every chosen frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from rpl_data.geometry import Transform
from rpl_data.label import SceneObject, label_frames, sample_frames
from rpl_data.pipeline.context import Context, posed_frames, step
from rpl_data.steps import Advance, Outcome, Step
from rpl_data.types import FrameLabel
from rpl_data.workspace import Workspace, load_mesh, read_depth_m, remove


def label_steps(context: Context) -> list[Step]:
    """Dense models and poses -> labels of the chosen frames, a scene."""
    for gone in set(context.workspace.labelled_scene_names()) - set(context.placed_scenes()):
        remove(context.workspace.labels_file(gone))
    return [_label_step(context, name) for name in context.placed_scenes()]


def _label_step(context: Context, name: str) -> Step:
    workspace, rate_hz = context.workspace, context.recipe.label.rate_hz
    objects = [item.model.name for item in context.solutions_in(name)]

    def run(advance: Advance) -> Outcome:
        counts: Counter[str] = Counter()
        scene = workspace.load_scene(name)
        frames = sample_frames(posed_frames(scene, workspace.load_trajectory(scene)), rate_hz=rate_hz)
        ranges = context.pool.ranges(len(frames))
        tasks = [(workspace.root, name, objects, [f.index for f in frames[a:b]]) for a, b in ranges]

        def counted() -> Iterator[FrameLabel]:
            for done, label in enumerate(context.pool.stream(label_range, tasks), start=1):
                advance(done, len(frames))
                counts.update(instance.object for instance in label.instances)
                yield label

        workspace.save_labels(name, counted())
        return Outcome(len(frames), details={"instances": {item: counts[item] for item in objects}})

    before = [f"{stage}/{item}" for item in objects for stage in ("solve", "segment")]
    output = workspace.labels_file(name)
    return step("label", name, run, options={"rate_hz": rate_hz}, after=["import", *before], outputs=[output])


def label_range(
    root: Path, name: str, objects: Sequence[str], indices: Sequence[int]
) -> Iterator[FrameLabel]:
    """Labels of some frames of a scene; runs in this process or in another."""
    workspace = Workspace(root)
    scene = workspace.load_scene(name)
    trajectory = workspace.load_trajectory(scene)
    bodies = [scene_object(workspace, item, name) for item in objects]
    chosen = set(indices)
    frames = [frame for frame in scene.frames if frame.index in chosen]
    depths = ((f, None if f.depth is None else read_depth_m(scene, f)) for f in frames)
    return label_frames(scene, trajectory, bodies, depths)


def scene_object(workspace: Workspace, object_name: str, scene: str) -> SceneObject:
    """An object as it stands in a scene."""
    solution = workspace.load_solution(object_name)
    place: Transform = solution.scene_from_object[scene]
    mesh = load_mesh(workspace.mesh_file(object_name))
    return SceneObject(solution.model, solution.covariance, mesh, place)
