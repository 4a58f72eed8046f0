"""The only module that knows our folder and file names. See `Workspace` for the tree."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rpl_data.clicks.log import Annotation, Event, replay
from rpl_data.files import (
    append_bytes,
    read_json,
    read_text,
    remove,
    write_bytes,
    write_json,
    write_text,
    writing,
)
from rpl_data.geometry import Transform, from_quaternion_xyzw, to_quaternion_xyzw
from rpl_data.images import in_metres, read_depth_units
from rpl_data.json_arrays import numbers
from rpl_data.types import (
    DataError,
    DepthImage,
    DepthUnits,
    Frame,
    FrameLabel,
    ReadDepth,
    Recording,
    Scene,
    Solution,
    Span,
    Trajectory,
)
from rpl_data.workspace import records
from rpl_data.workspace.depth_cache import pack, unpack
from rpl_data.workspace.parts import Parts


@dataclass(frozen=True)
class Workspace:
    """A folder with everything about a dataset.

    ::

        recipe.yaml                   the resolved recipe that built it
        stages.json                   what each stage ran with
        build.lock                    held while a build is at work
        recording/                    the synthetic recording of a twin, with recording/truth/
        scenes/<scene>/               scene.json  trajectory.txt  drift.json  surface.ply  cache/  images/
                                      parts.json, when it was cut into scenes/<scene>.1/, <scene>.2/, ...
        objects/<object>/             clicks.jsonl  solution.json  mesh.ply  cloud.ply  given.ply  grasp.json
        labels/<scene>.jsonl          a line a frame
        labels/<scene>.left_out.json  frames that a person keeps out of exports
        export/<format>/              coco, coco_truth, ...
        report/index.html

    The truth of a recording, where there is one, is a workspace of its own: objects with solution
    and mesh, and labels.
    """

    root: Path

    @property
    def recipe_file(self) -> Path:
        """The resolved recipe."""
        return self.root / "recipe.yaml"

    @property
    def stages_file(self) -> Path:
        """What each stage ran with."""
        return self.root / "stages.json"

    @property
    def build_lock(self) -> Path:
        """Held while a build is at work."""
        return self.root / "build.lock"

    @property
    def recording(self) -> Path:
        """Where a twin writes its recording."""
        return self.root / "recording"

    @property
    def truth(self) -> Path:
        """The truth workspace of the recording: a twin's, or made from true poses."""
        return self.recording / "truth"

    @property
    def report(self) -> Path:
        """The page a person looks at."""
        return self.root / "report" / "index.html"

    def export(self, name: str) -> Path:
        """The folder of an export."""
        return self.root / "export" / name

    def scene_file(self, scene: str) -> Path:
        """Intrinsics and frames of a scene."""
        return self.root / "scenes" / scene / "scene.json"

    def trajectory_file(self, scene: str) -> Path:
        """TUM lines, scene_from_camera."""
        return self.root / "scenes" / scene / "trajectory.txt"

    def surface_file(self, scene: str) -> Path:
        """Surface near the objects, in the scene frame."""
        return self.root / "scenes" / scene / "surface.ply"

    def drift_file(self, scene: str) -> Path:
        """How far the poses of a recording stray."""
        return self.root / "scenes" / scene / "drift.json"

    def parts_file(self, scene: str) -> Path:
        """The scenes a recording was cut into; none while it is whole."""
        return self.root / "scenes" / scene / "parts.json"

    def cache(self, scene: str) -> Path:
        """Decoded depth and other things that can be rebuilt at any time."""
        return self.root / "scenes" / scene / "cache"

    def images(self, scene: str) -> Path:
        """Images of a recording that is one file (.klg, .bag, .db3)."""
        return self.root / "scenes" / scene / "images"

    def clicks_file(self, object_name: str) -> Path:
        """The log of clicks."""
        return self.root / "objects" / object_name / "clicks.jsonl"

    def solution_file(self, object_name: str) -> Path:
        """The sparse model and the scene transforms."""
        return self.root / "objects" / object_name / "solution.json"

    def mesh_file(self, object_name: str) -> Path:
        """The dense model as triangles, object frame."""
        return self.root / "objects" / object_name / "mesh.ply"

    def cloud_file(self, object_name: str) -> Path:
        """The dense model as points, object frame."""
        return self.root / "objects" / object_name / "cloud.ply"

    def given_mesh_file(self, object_name: str) -> Path:
        """A mesh a person has of the object, in the frame of its known keypoints, metres."""
        return self.root / "objects" / object_name / "given.ply"

    def grasp_file(self, object_name: str) -> Path:
        """The grasp frame in the object frame."""
        return self.root / "objects" / object_name / "grasp.json"

    def labels_file(self, scene: str) -> Path:
        """Labels of a scene, a line a frame."""
        return self.root / "labels" / f"{scene}.jsonl"

    def left_out_file(self, scene: str) -> Path:
        """Frames of a scene that a person keeps out of exports."""
        return self.root / "labels" / f"{scene}.left_out.json"

    # Names ----------------------------------------------------------------------------------------

    def scene_names(self) -> list[str]:
        """Scenes of the workspace, sorted; of a recording that was cut its parts."""
        return sorted(self._all_scenes() - self.parts().spans.keys())

    def video_names(self) -> list[str]:
        """Recordings of the workspace as they were read, sorted; labels are kept by these."""
        parts = self.parts()
        return sorted({parts.video_of(name) for name in self._all_scenes()})

    def _all_scenes(self) -> set[str]:
        return {path.parent.name for path in self.root.glob("scenes/*/scene.json")}

    def object_names(self) -> list[str]:
        """Objects that have clicks or a solution, sorted."""
        folders = [*self.root.glob("objects/*/clicks.jsonl"), *self.root.glob("objects/*/solution.json")]
        return sorted({path.parent.name for path in folders})

    def labelled_scene_names(self) -> list[str]:
        """Recordings with labels, sorted."""
        return sorted(path.stem for path in self.root.glob("labels/*.jsonl"))

    # Scenes ---------------------------------------------------------------------------------------

    def save_recording(self, recording: Recording) -> None:
        """Write scene.json, and trajectory.txt when the recording has poses."""
        write_json(self.scene_file(recording.scene.name), records.recording_to_json(recording), indent=None)
        if recording.trajectory is not None:
            self.save_trajectory(recording.scene, recording.trajectory)

    def load_recording(self, scene: str) -> Recording:
        """The scene as it was read, without its trajectory."""
        if not self.scene_file(scene).exists():
            raise DataError(f"the workspace {self.root} has no scene {scene!r}; it has {self.scene_names()}")
        return records.recording_from_json(read_json(self.scene_file(scene)))

    def load_scene(self, scene: str) -> Scene:
        """The scene alone."""
        return self.load_recording(scene).scene

    def parts(self) -> Parts:
        """How recordings were cut."""
        spans = {path.parent.name: read_json(path) for path in self.root.glob("scenes/*/parts.json")}
        return Parts({name: tuple((first, last) for first, last in found) for name, found in spans.items()})

    def cut_scene(self, video: str, spans: Sequence[Span]) -> None:
        """Make the parts of a recording scenes of their own; a single one makes it whole again.

        Raises:
            DataError: another recording has the name of a part.
        """
        for old in set(self.parts().scenes_of(video)) - {video}:
            remove(self.scene_file(old).parent)
        remove(self.parts_file(video))
        if len(spans) < 2:
            return
        recording = self.load_recording(video)
        trajectory = self.load_trajectory(recording.scene)
        parts = Parts({video: tuple(spans)})
        taken = self._all_scenes() & set(parts.scenes_of(video))
        if taken:
            raise DataError(
                f"scene {video} is cut into {', '.join(parts.scenes_of(video))}, but another recording is "
                f"called {', '.join(sorted(taken))}; rename it"
            )
        for name in parts.scenes_of(video):
            frames = tuple(f for f in recording.scene.frames if parts.scene_at(video, f.index) == name)
            rows = np.array([parts.scene_at(video, int(index)) == name for index in trajectory.frames])
            scene = replace(recording.scene, name=name, frames=frames)
            poses = Trajectory(trajectory.frames[rows], trajectory.scene_from_camera[rows])
            self.save_recording(Recording(scene, poses))
        write_json(self.parts_file(video), [list(span) for span in spans])

    def save_trajectory(self, scene: Scene, trajectory: Trajectory) -> None:
        """Write TUM lines `t tx ty tz qx qy qz qw`, scene_from_camera, in full precision."""
        times = {frame.index: frame.timestamp_s for frame in scene.frames}
        lines = ["# t_s tx_m ty_m tz_m qx qy qz qw  scene_from_camera"]
        for index, pose in zip(trajectory.frames, trajectory.scene_from_camera, strict=True):
            values = [times[int(index)], *pose[:3, 3], *to_quaternion_xyzw(pose)]
            lines.append(" ".join(repr(float(value)) for value in values))
        write_text(self.trajectory_file(scene.name), "\n".join(lines) + "\n")

    def load_trajectory(self, scene: Scene) -> Trajectory:
        """The poses of a scene; DataError when it has none yet."""
        path = self.trajectory_file(scene.name)
        if not path.exists():
            raise DataError(f"scene {scene.name} has no trajectory yet; run the reconstruct stage first")
        rows = [line.split() for line in read_text(path).splitlines() if not line.startswith("#")]
        values = np.array(rows, dtype=float).reshape(-1, 8)
        index_of = {frame.timestamp_s: frame.index for frame in scene.frames}
        known = [row for row in values if float(row[0]) in index_of]
        frames = np.array([index_of[float(row[0])] for row in known], dtype=np.int64)
        poses = np.array([from_quaternion_xyzw(row[4:], row[1:4]) for row in known]).reshape(-1, 4, 4)
        return Trajectory(frames, poses)

    # Decoded depth --------------------------------------------------------------------------------

    def depth_reader(self, scene: Scene, *, keep: bool = False) -> ReadDepth:
        """Reads depth images in metres: from the cache where they are in it, else from the recording.

        Args:
            keep: put what is not in the cache into it, for the next reader.
        """
        folder = self.cache(self.parts().video_of(scene.name)) / "depth"

        def read(frame: Frame) -> DepthImage:
            path = folder / f"{frame.index:06d}.zst"
            units = _kept_units(path, scene)
            if units is None:
                units = read_depth_units(scene, frame)
                if keep:
                    write_bytes(path, pack(units))
            return in_metres(scene, units)

        return read

    # Objects --------------------------------------------------------------------------------------

    def append_events(self, object_name: str, events: Iterable[Event]) -> None:
        """Add events to the log of clicks, all or none; they are on the disk when this returns."""
        path = self.clicks_file(object_name)
        parts = self.parts()
        lines = "".join(json.dumps(parts.event_in_video(event)) + "\n" for event in events)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            append_bytes(path, lines.encode())
        except OSError as error:
            why = f"{error.strerror}; the last action was not saved"
            raise DataError(f"cannot write {path}: {why}") from error

    def load_events(self, object_name: str) -> list[Event]:
        """The log; a last line cut off by a crash is left out."""
        path = self.clicks_file(object_name)
        if not path.exists():
            return []
        lines = read_text(path).split("\n")
        events = []
        for number, line in enumerate(lines, start=1):
            if not line:
                continue
            try:
                events.append(json.loads(line))
            except json.JSONDecodeError as error:
                if number == len(lines):  # no newline at its end: never acknowledged
                    continue
                raise DataError(f"{path} line {number} is broken: {error}; delete that line") from error
        parts = self.parts()
        return [parts.event_in_scene(event) for event in events]

    def load_annotation(self, object_name: str) -> Annotation:
        """Keypoint names and clicks of an object."""
        return replay(object_name, self.load_events(object_name))

    def save_solution(self, solution: Solution) -> None:
        """Write solution.json."""
        write_json(self.solution_file(solution.model.name), records.solution_to_json(solution))

    def load_solution(self, object_name: str) -> Solution:
        """The solution of an object; DataError when there is none yet."""
        if not self.solution_file(object_name).exists():
            raise DataError(f"object {object_name} has no solution yet; run `rpl solve` on {self.root}")
        return records.solution_from_json(read_json(self.solution_file(object_name)))

    def save_grasp(self, object_name: str, object_from_grasp: Transform | None) -> None:
        """Write grasp.json; None deletes it."""
        if object_from_grasp is None:
            remove(self.grasp_file(object_name))
        else:
            content = {"object_from_grasp": numbers(object_from_grasp)}
            write_json(self.grasp_file(object_name), content)

    # Labels ---------------------------------------------------------------------------------------

    def save_labels(self, scene: str, labels: Iterable[FrameLabel]) -> int:
        """Write the labels of a scene as they come, in constant memory; returns how many frames."""
        count = 0
        with writing(self.labels_file(scene)) as file:
            for label in labels:
                file.write(json.dumps(records.frame_label_to_json(label), allow_nan=False) + "\n")
                count += 1
        return count

    def save_left_out(self, scene: str, frames: Iterable[int]) -> None:
        """Write which frames stay out of exports; they stay out when the labels are made again."""
        write_json(self.left_out_file(scene), sorted(frames), indent=None)

    def load_left_out(self, scene: str) -> frozenset[int]:
        """Frames that stay out of exports; none where nobody chose any."""
        path = self.left_out_file(scene)
        return frozenset(read_json(path) if path.exists() else ())

    def load_labels(self, scene: str) -> Iterator[FrameLabel]:
        """The labels of a scene, one at a time."""
        path = self.labels_file(scene)
        if not path.exists():
            raise DataError(f"scene {scene} has no labels yet; run `rpl label` on {self.root}")
        with path.open(encoding="utf-8") as file:
            for line in file:
                yield records.frame_label_from_json(json.loads(line))


def _kept_units(path: Path, scene: Scene) -> DepthUnits | None:
    """A depth image of the cache; None where it is not there or broken, for it can be made again."""
    if not path.exists():
        return None
    return unpack(path.read_bytes(), height=scene.intrinsics.height, width=scene.intrinsics.width)
