"""Every stage with its files: read the workspace, call the stage, write back what it returns.

`STAGES` lists them in order; each entry plans the steps of its stage when all stages before it hold.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from rpl_data import capture
from rpl_data.clicklog import clicks_from_csv, clicks_to_csv, events_to, keypoints_event, objects_in_csv
from rpl_data.files import read_text
from rpl_data.geometry import Transform, transform
from rpl_data.label import SceneObject, label_frames, sample_frames
from rpl_data.lift import lift_clicks
from rpl_data.pool import Pool
from rpl_data.recipe import ObjectRecipe, Recipe, SceneSource
from rpl_data.solve import register, solve
from rpl_data.steps import Advance, Json, Outcome, Step, stamps
from rpl_data.types import (
    DataError,
    DepthImage,
    Frame,
    FrameLabel,
    Mesh,
    Observation,
    Recording,
    Scene,
    Solution,
    Trajectory,
)
from rpl_data.workspace import Workspace, load_mesh, read_color, read_depth_m, remove, save_cloud, save_mesh

VERSIONS = {
    "twin": 1,
    "import": 1,
    "clicks": 1,
    "solve": 1,
    "surface": 1,
    "segment": 1,
    "label": 1,
    "export": 1,
    "quality": 1,
    "report": 1,
}
"""Raised when a stage writes something else for the same input; its steps then run again."""


@dataclass(frozen=True)
class Context:
    """What every stage is given."""

    recipe: Recipe
    workspace: Workspace
    pool: Pool

    @property
    def scene_sources(self) -> tuple[SceneSource, ...]:
        """Where scenes come from; a twin's recording when the recipe names none."""
        return self.recipe.scenes or (SceneSource(self.workspace.recording, metres_per_unit=0.001),)

    @property
    def objects(self) -> tuple[ObjectRecipe, ...]:
        """The objects; those a twin wrote when the recipe names none."""
        return self.recipe.objects or tuple(self._twin_objects())

    def _twin_objects(self) -> Iterator[ObjectRecipe]:
        truth = Workspace(self.workspace.truth)
        for name in truth.object_names():
            model = truth.load_solution(name).model
            clicks = self.workspace.recording / "clicks.csv"
            yield ObjectRecipe(name, model.keypoints, clicks, model.skeleton)

    @property
    def object_names(self) -> list[str]:
        """Names in the recipe's order, which is that of the categories."""
        return [item.name for item in self.objects]

    def solutions_in(self, scene: str) -> list[Solution]:
        """Solutions of the objects that stand in a scene."""
        solutions = [self.workspace.load_solution(name) for name in self.object_names]
        return [solution for solution in solutions if scene in solution.scene_from_object]

    def placed_scenes(self) -> list[str]:
        """Scenes in which at least one object has a place."""
        solutions = [self.workspace.load_solution(name) for name in self.object_names]
        placed = {scene for solution in solutions for scene in solution.scene_from_object}
        return [scene for scene in self.workspace.scene_names() if scene in placed]


def step(
    stage: str,
    item: str,
    run: Callable[[Advance], Outcome],
    *,
    options: Json | None = None,
    sources: Json | None = None,
    after: Sequence[str] = (),
    outputs: Sequence[Path] = (),
) -> Step:
    """A step with the version of its stage."""
    return Step(stage, item, VERSIONS[stage], options or {}, sources or {}, tuple(after), tuple(outputs), run)


# Recording ----------------------------------------------------------------------------------------


def twin_steps(context: Context) -> list[Step]:
    """A synthetic recording with truth, when the recipe asks for one."""
    spec, workspace = context.recipe.twin, context.workspace
    if spec is None:
        return []

    def run(advance: Advance) -> Outcome:
        from rpl_data.twin.write import write_twin

        write_twin(workspace.recording, spec, workers=context.pool.workers, progress=advance)
        return Outcome(spec.scenes * spec.frames)

    outputs = [workspace.recording / "camera.txt", workspace.recording / "clicks.csv"]
    return [step("twin", "", run, options=asdict(spec), outputs=outputs)]


def import_steps(context: Context) -> list[Step]:
    """Recordings -> scenes of the workspace."""
    workspace, sources = context.workspace, context.scene_sources

    def run(advance: Advance) -> Outcome:
        recordings = read_recordings(sources)
        for gone in set(workspace.scene_names()) - {recording.scene.name for recording in recordings}:
            remove(workspace.scene_file(gone).parent)
            remove(workspace.labels_file(gone))
        for recording in recordings:
            workspace.save_recording(recording)
        lines = [
            f"scene {recording.scene.name}: {line}"
            for recording in recordings
            for line in (*recording.skipped, *recording.notes)
        ]
        return Outcome(sum(len(recording.scene.frames) for recording in recordings), tuple(lines))

    paths = [source.path for source in sources]
    seen = stamps(*paths, but_not=workspace.root.resolve() if not context.recipe.twin else workspace.truth)
    options = {"scenes": [asdict(source) | {"path": str(source.path)} for source in sources]}
    outputs = [workspace.scene_file(name) for name in workspace.scene_names()]
    return [step("import", "", run, options=options, sources=seen, after=["twin"], outputs=outputs)]


def read_recordings(sources: Sequence[SceneSource]) -> list[Recording]:
    """All scenes of all sources; DataError when two share a name or one has no poses."""
    recordings: dict[str, Recording] = {}
    for source in sources:
        for recording in capture.open_scenes(
            source.path, source.format, names=source.names, metres_per_unit=source.metres_per_unit
        ):
            name = recording.scene.name
            if name in recordings:
                raise DataError(
                    f"two scenes are called {name}: {recordings[name].scene.source} and "
                    f"{recording.scene.source}; rename a folder, or choose scenes by `names`"
                )
            if recording.trajectory is None:
                raise DataError(f"scene {name} in {source.path} has no camera poses; record it with poses")
            recordings[name] = recording
    return list(recordings.values())


# Clicks -------------------------------------------------------------------------------------------


def clicks_steps(context: Context) -> list[Step]:
    """Keypoint names and, where a recipe names a CSV file, its clicks -> the log of each object."""
    return [_clicks_step(context, item) for item in context.objects]


def _clicks_step(context: Context, item: ObjectRecipe) -> Step:
    def run(advance: Advance) -> Outcome:
        if item.clicks is None:
            annotation = context.workspace.load_annotation(item.name)
            if annotation.keypoints != item.keypoint_names:
                context.workspace.append_events(item.name, [keypoints_event(item.keypoint_names)])
            return Outcome()
        changed = import_clicks(context.workspace, item, item.clicks)
        return Outcome(
            messages=(f"{item.name}: {changed} clicks changed from {item.clicks}",) if changed else ()
        )

    options = {
        "keypoints": list(item.keypoint_names),
        "clicks": None if item.clicks is None else str(item.clicks),
    }
    sources = stamps(item.clicks) if item.clicks else {}
    return step("clicks", item.name, run, options=options, sources=sources)


def import_clicks(workspace: Workspace, item: ObjectRecipe, path: Path) -> int:
    """Make the log of an object say what the CSV file says; returns how many events that took."""
    clicks = clicks_from_csv(
        read_text(path), source=str(path), object_name=item.name, keypoints=item.keypoint_names
    )
    events = events_to(workspace.load_annotation(item.name), item.keypoint_names, clicks)
    if events:
        workspace.append_events(item.name, events)
    return len(events)


def add_clicks(context: Context, path: Path) -> dict[str, int]:
    """Add the clicks of a CSV file to the logs; returns how many events that took, by object."""
    text = read_text(path)
    named = set(objects_in_csv(text))
    chosen = [item for item in context.objects if item.name in named]
    if not chosen or named - set(context.object_names):
        raise DataError(
            f"{path} has clicks for {', '.join(sorted(named)) or 'no object'}; "
            f"the recipe has the objects {', '.join(context.object_names)}; use the same names"
        )
    events = {}
    for item in chosen:
        names = item.keypoint_names
        annotation = context.workspace.load_annotation(item.name)
        clicks = clicks_from_csv(text, source=str(path), object_name=item.name, keypoints=names)
        events[item.name] = events_to(annotation, names, [*annotation.clicks, *clicks])
    for name, found in events.items():  # after all of the file was understood
        context.workspace.append_events(name, found)
    return {name: len(found) for name, found in events.items()}


def clicks_table(workspace: Workspace) -> str:
    """The clicks of all objects as CSV, the heading once."""
    annotations = [workspace.load_annotation(name) for name in workspace.object_names()]
    tables = [clicks_to_csv(found.clicks, found.keypoints) for found in annotations if found.clicks]
    if not tables:
        raise DataError(f"{workspace.root} has no clicks to export")
    return tables[0] + "".join(table.split("\n", 1)[1] for table in tables[1:])


# Sparse model -------------------------------------------------------------------------------------


def solve_steps(context: Context) -> list[Step]:
    """Clicks -> sparse model and scene transforms, an object."""
    return [_solve_step(context, item) for item in context.objects]


def _solve_step(context: Context, item: ObjectRecipe) -> Step:
    workspace, options = context.workspace, asdict(context.recipe.solve)

    def run(advance: Advance) -> Outcome:
        observations = observe(workspace, item.name)
        solution = solve(
            item.name,
            item.keypoint_names,
            observations,
            method=context.recipe.solve.method,
            skeleton=item.skeleton,
        )
        workspace.save_solution(solution)
        outliers = sum(residual.outlier for residual in solution.residuals)
        lines = [f"{item.name}: {line}" for line in solution.warnings]
        return Outcome(messages=tuple(lines), details={"clicks": len(observations), "outliers": outliers})

    return step(
        "solve",
        item.name,
        run,
        options=options
        | {"keypoints": list(item.keypoint_names), "skeleton": [list(e) for e in item.skeleton]},
        sources=stamps(workspace.clicks_file(item.name)),
        after=["import"],
        outputs=[workspace.solution_file(item.name)],
    )


def register_step(context: Context, object_name: str, scene: str) -> Step:
    """Place a known object in one more scene from its clicks there; the model stays as it is."""
    item = next((item for item in context.objects if item.name == object_name), None)
    if item is None:
        raise DataError(f"the recipe has no object {object_name!r}; it has {', '.join(context.object_names)}")

    def run(advance: Advance) -> Outcome:
        solution = context.workspace.load_solution(object_name)
        observations = observe(context.workspace, object_name, scene=scene)
        place, residuals = register(solution.model, observations)
        kept = tuple(r for r in solution.residuals if r.click.scene != scene)
        places = {**solution.scene_from_object, scene: place}
        context.workspace.save_solution(
            replace(solution, scene_from_object=places, residuals=(*kept, *residuals))
        )
        mean_px = float(np.mean([residual.error_px for residual in residuals]))
        text = f"{object_name} stands in scene {scene}; its {len(residuals)} clicks fit to {mean_px:.1f} px"
        return Outcome(messages=(text,))

    # It takes the place of the solve in the ledger, so that a build goes on from it and does not solve again.
    return replace(_solve_step(context, item), run=run)


def observe(workspace: Workspace, object_name: str, *, scene: str | None = None) -> list[Observation]:
    """The clicks of an object (in one scene, or all), lifted; DataError when there are none."""
    clicks = workspace.load_annotation(object_name).clicks
    if scene is not None:
        clicks = tuple(click for click in clicks if click.scene == scene)
    if not clicks:
        raise DataError(
            f"object {object_name} has no clicks{f' in scene {scene}' if scene else ''}; name a CSV file "
            f"with `clicks:` in the recipe, or run `rpl clicks import FILE.csv --workspace {workspace.root}`"
        )
    scenes = {name: workspace.load_scene(name) for name in workspace.scene_names()}
    trajectories = {
        name: workspace.load_trajectory(scenes[name]) for name in {c.scene for c in clicks} & scenes.keys()
    }
    return lift_clicks(clicks, scenes, trajectories, read_depth_m)


# Dense model --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sphere:
    """Where a surface is wanted, scene frame."""

    centre_m: np.ndarray
    radius_m: float


def surface_steps(context: Context) -> list[Step]:
    """Depth near the objects -> a surface, a scene."""
    return [_surface_step(context, scene) for scene in context.placed_scenes()]


def _surface_step(context: Context, name: str) -> Step:
    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m

    def run(advance: Advance) -> Outcome:
        from rpl_data.reconstruct.surface import fuse_surface

        scene = workspace.load_scene(name)
        trajectory = workspace.load_trajectory(scene)
        frames = [frame for frame in posed_frames(scene, trajectory) if frame.depth is not None]
        spheres = joined_spheres([sphere_of(item, name) for item in context.solutions_in(name)])
        meshes = []
        for number, sphere in enumerate(spheres):
            meshes.append(
                fuse_surface(
                    scene,
                    trajectory,
                    with_depth(scene, frames, advance, number * len(frames), len(spheres) * len(frames)),
                    centre_scene=sphere.centre_m,
                    radius_m=sphere.radius_m,
                    voxel_m=voxel_m,
                    colors=read_color,
                )
            )
        save_mesh(workspace.surface_file(name), joined_meshes(meshes))
        return Outcome(len(frames))

    before = [f"solve/{item.model.name}" for item in context.solutions_in(name)]
    output = workspace.surface_file(name)
    return step(
        "surface", name, run, options={"voxel_m": voxel_m}, after=["import", *before], outputs=[output]
    )


def posed_frames(scene: Scene, trajectory: Trajectory) -> list[Frame]:
    """The frames that have a pose."""
    posed = set(trajectory.frames.tolist())
    return [frame for frame in scene.frames if frame.index in posed]


def with_depth(
    scene: Scene, frames: Sequence[Frame], advance: Advance, done: int = 0, total: int | None = None
) -> Iterator[tuple[Frame, DepthImage]]:
    """Frames with their depth, one at a time."""
    for number, frame in enumerate(frames, start=done):
        advance(number, len(frames) if total is None else total)
        yield frame, read_depth_m(scene, frame)


def sphere_of(solution: Solution, scene: str) -> Sphere:
    """Around the keypoints of an object, with some of what it stands on."""
    model = solution.model
    points = transform(solution.scene_from_object[scene], model.points_object[model.known])
    centre = points.mean(axis=0)
    return Sphere(centre, 1.8 * float(np.linalg.norm(points - centre, axis=1).max()) + 0.06)


def joined_spheres(spheres: Sequence[Sphere]) -> list[Sphere]:
    """Spheres that do not overlap and hold the given ones, so that no surface is fused twice."""
    joined: list[Sphere] = []
    for sphere in spheres:
        while touching := [other for other in joined if _overlap(sphere, other)]:
            joined.remove(touching[0])
            sphere = _around(sphere, touching[0])
        joined.append(sphere)
    return joined


def _overlap(a: Sphere, b: Sphere) -> bool:
    return float(np.linalg.norm(a.centre_m - b.centre_m)) < a.radius_m + b.radius_m


def _around(a: Sphere, b: Sphere) -> Sphere:
    """The smallest sphere that holds both."""
    distance = float(np.linalg.norm(b.centre_m - a.centre_m))
    if distance + b.radius_m <= a.radius_m:
        return a
    if distance + a.radius_m <= b.radius_m:
        return b
    radius = (distance + a.radius_m + b.radius_m) / 2
    return Sphere(a.centre_m + (b.centre_m - a.centre_m) * (radius - a.radius_m) / distance, radius)


def joined_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles in one mesh."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    colors = [mesh.colors for mesh in meshes if mesh.colors is not None]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
        np.concatenate(colors) if len(colors) == len(meshes) else None,
    )


def segment_steps(context: Context) -> list[Step]:
    """Surfaces of the scenes -> the dense model, an object."""
    return [_segment_step(context, item) for item in context.objects]


def _segment_step(context: Context, item: ObjectRecipe) -> Step:
    workspace, voxel_m = context.workspace, context.recipe.reconstruct.voxel_m
    scenes = [s for s in context.placed_scenes() if s in workspace.load_solution(item.name).scene_from_object]

    def run(advance: Advance) -> Outcome:
        from rpl_data.segment import segment_object

        surfaces = {name: load_mesh(workspace.surface_file(name)) for name in scenes}
        crop = None if item.crop is None else (item.crop.low_m, item.crop.high_m)
        dense = segment_object(surfaces, workspace.load_solution(item.name), voxel_m=voxel_m, crop_m=crop)
        save_mesh(workspace.mesh_file(item.name), dense.mesh)
        save_cloud(workspace.cloud_file(item.name), dense.cloud)
        return Outcome(
            messages=tuple(f"{item.name}: {line}" for line in dense.warnings),
            details={"triangles": len(dense.mesh.triangles), "points": len(dense.cloud.points)},
        )

    return step(
        "segment",
        item.name,
        run,
        options={"voxel_m": voxel_m, "crop": None if item.crop is None else asdict(item.crop)},
        after=[f"solve/{item.name}", *(f"surface/{name}" for name in scenes)],
        outputs=[workspace.mesh_file(item.name), workspace.cloud_file(item.name)],
    )


# Labels -------------------------------------------------------------------------------------------


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
