"""The scenes of a workspace: names, recordings, trajectories, and the cache of decoded depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rpl_data.files import (
    decoding,
    read_json,
    read_text,
    remove,
    write_json,
    write_text,
)
from rpl_data.json_arrays import each, whole
from rpl_data.types import (
    DataError,
    ReadDepth,
    ReadDepthInto,
    Recording,
    Scene,
    Span,
    Trajectory,
)
from rpl_data.workspace.depth_cache import cached_reader, cached_window_reader
from rpl_data.workspace.parts import Parts, recordings_of_parts, refuse_taken_names
from rpl_data.workspace.paths import Paths
from rpl_data.workspace.recording_records import recording_from_json, recording_to_json
from rpl_data.workspace.trajectory_text import trajectory_from_text, trajectory_to_text


@dataclass(frozen=True, init=False, repr=False)
class SceneFiles(Paths):
    """What a workspace knows of its scenes, written and read."""

    # Names ----------------------------------------------------------------------------------------

    def scene_names(self) -> list[str]:
        """Names of the scenes, sorted; a recording that was cut is listed as its parts."""
        return sorted(self._stored_scenes() - self.parts().spans.keys())

    def video_names(self) -> list[str]:
        """Names of the recordings as they were read, sorted; labels are stored under these names."""
        parts = self.parts()
        return sorted({parts.video_of(name) for name in self._stored_scenes()})

    def _stored_scenes(self) -> set[str]:
        return {path.parent.name for path in self.root.glob("scenes/*/scene.json")}

    def object_names(self) -> list[str]:
        """Names of the objects that have clicks or a solution, sorted."""
        folders = [*self.root.glob("objects/*/clicks.jsonl"), *self.root.glob("objects/*/solution.json")]
        return sorted({path.parent.name for path in folders})

    def labelled_scene_names(self) -> list[str]:
        """Names of the recordings that have labels, sorted."""
        return sorted(path.stem for path in self.root.glob("labels/*.jsonl"))

    def earlier_labelled_names(self) -> list[str]:
        """Names of the recordings whose labels are those of an earlier build alone, sorted."""
        earlier = {path.stem for path in self.root.glob("labels/earlier/*.jsonl")}
        return sorted(earlier - set(self.labelled_scene_names()))

    def set_labels_aside(self, scene: str) -> bool:
        """Keep the labels of a recording where no reader takes them for those of the present models.

        Returns:
            Whether there were any.
        """
        labels, earlier = self.labels_file(scene), self.earlier_labels_file(scene)
        if not labels.exists():
            return False
        earlier.parent.mkdir(exist_ok=True)
        labels.replace(earlier)
        return True

    # Scenes ---------------------------------------------------------------------------------------

    def save_recording(self, recording: Recording) -> None:
        """Write `scene.json`, and `trajectory.txt` when the recording has poses."""
        write_json(self.scene_file(recording.scene.name), recording_to_json(recording), indent=None)
        if recording.trajectory is not None:
            self.save_trajectory(recording.scene, recording.trajectory)
        if recording.moving:
            write_json(self.moving_file(recording.scene.name), True)
        else:
            remove(self.moving_file(recording.scene.name))

    def load_recording(self, scene: str) -> Recording:
        """Load the recording of a scene, without its trajectory."""
        if not self.scene_file(scene).exists():
            raise DataError(f"the workspace {self.root} has no scene {scene!r}; it has {self.scene_names()}")
        path = self.scene_file(scene)
        with decoding(path, "read the recordings again with `rpl import --again true`"):
            return recording_from_json(read_json(path))

    def load_scene(self, scene: str) -> Scene:
        """Load the scene alone, without what was noted when it was read."""
        return self.load_recording(scene).scene

    def parts(self) -> Parts:
        """Load how the recordings were cut into scenes."""
        moving = {path.parent.name for path in self.root.glob("scenes/*/moving.json")}
        spans = {path.parent.name: _spans(path) for path in self.root.glob("scenes/*/parts.json")}
        return Parts(spans, frozenset(moving))

    def cut_scene(self, video: str, spans: Sequence[Span]) -> None:
        """Cut a recording into one scene per span; a single span makes it whole again.

        Raises:
            DataError: another recording already has the name of a part.
        """
        for old in set(self.parts().scenes_of(video)) - {video}:
            remove(self.scene_file(old).parent)
        remove(self.parts_file(video))
        if len(spans) < 2:
            return
        recording = self.load_recording(video)
        cut = recordings_of_parts(recording, self.load_trajectory(recording.scene), spans)
        refuse_taken_names(video, cut, self._stored_scenes())
        for part in cut:
            self.save_recording(part)
        write_json(self.parts_file(video), [list(span) for span in spans])

    def save_trajectory(self, scene: Scene, trajectory: Trajectory) -> None:
        """Write the poses `scene_from_camera` as TUM lines `t tx ty tz qx qy qz qw`, in full precision."""
        write_text(self.trajectory_file(scene.name), trajectory_to_text(scene, trajectory))

    def save_given(self, recording: Recording) -> None:
        """Keep the poses that a recording came with, for the day its trajectory is made of something else."""
        path, scene = self.given_file(recording.scene.name), recording.scene
        if recording.trajectory is None:
            remove(path)
        else:
            write_text(path, trajectory_to_text(scene, recording.trajectory))

    def has_path_of(self, recording: Recording) -> bool:
        """Whether the scene has a trajectory, and came with the same poses when that was made."""
        scene, came = recording.scene, recording.trajectory
        files = self.given_file(scene.name), self.trajectory_file(scene.name)
        if came is None or not all(path.exists() for path in files):
            return False
        try:
            known = trajectory_from_text(scene, read_text(files[0]))
        except ValueError:  # a damaged file is written anew
            return False
        return np.array_equal(known.frames, came.frames) and np.allclose(
            known.scene_from_camera, came.scene_from_camera, rtol=0, atol=1e-9
        )

    def restore_given(self, scene: str) -> None:
        """Use the poses that a recording came with, where it had some."""
        given, path = self.given_file(scene), self.trajectory_file(scene)
        if given.exists() and not (path.exists() and read_text(path) == read_text(given)):
            write_text(path, read_text(given))

    def load_given(self, scene: Scene) -> Trajectory | None:
        """The poses that the recording came with; None when it had none.

        Workspaces made before these were kept have them in trajectory.txt.
        """
        path = self.given_file(scene.name)
        path = path if path.exists() else self.trajectory_file(scene.name)
        return trajectory_from_text(scene, read_text(path)) if path.exists() else None

    def save_corrected(self, scene: Scene, corrected: Trajectory | None) -> None:
        """Keep the poses as the images correct them, by which the used ones are judged; None removes them."""
        if corrected is None:
            remove(self.corrected_file(scene.name))
            return
        write_text(self.corrected_file(scene.name), trajectory_to_text(scene, corrected))

    def load_corrected(self, scene: Scene) -> Trajectory | None:
        """The poses as the images correct them; None where nobody asked them."""
        path = self.corrected_file(scene.name)
        return trajectory_from_text(scene, read_text(path)) if path.exists() else None

    def load_trajectory(self, scene: Scene) -> Trajectory:
        """Load the poses of a scene; DataError when it has none yet."""
        path = self.trajectory_file(scene.name)
        if not path.exists():
            raise DataError(
                f"scene {scene.name} has no trajectory yet; run `rpl import` on {self.root}, or `rpl track` "
                "where the recipe lets its images say the poses (`reconstruct: {method: auto}` or `track`)"
            )
        with decoding(path, "read the recordings again with `rpl import --again true`"):
            return trajectory_from_text(scene, read_text(path))

    # Decoded depth --------------------------------------------------------------------------------

    def depth_reader(self, scene: Scene, *, keep: bool = False) -> ReadDepth:
        """Return a function that reads a frame's depth in metres, from the cache where it is there.

        Args:
            keep: add images that are missing from the cache to it, for the next reader.
        """
        return cached_reader(self._depth_cache(scene), scene, keep=keep)

    def depth_window_reader(self, scene: Scene) -> ReadDepthInto:
        """Return a function that reads a window of a frame's depth in metres, from the cache where it is."""
        return cached_window_reader(self._depth_cache(scene), scene)

    def _depth_cache(self, scene: Scene) -> Path:
        return self.cache(self.parts().video_of(scene.name)) / "depth"


def _spans(path: Path) -> tuple[Span, ...]:
    """First and last frames of the parts of a recording."""
    with decoding(path, "delete it, and build again"):
        return tuple((first, last) for first, last in each(each(whole))(read_json(path)))
