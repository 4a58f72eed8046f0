"""A workspace: what is in its files, written and read. Where they are is said in `paths`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from rpl_data.clicks.log import Annotation, Event, replay
from rpl_data.files import (
    decoding,
    read_json,
    read_text,
    refuse_special,
    remove,
    write_json,
    write_text,
    writing,
)
from rpl_data.geometry import Transform
from rpl_data.images import read_color
from rpl_data.json_arrays import each, numbers, whole
from rpl_data.meshes import load_mesh
from rpl_data.overlay import draw_overlay
from rpl_data.types import (
    ColorImage,
    Correction,
    DataError,
    Frame,
    FrameLabel,
    KeypointModel,
    Mesh,
    NetworkView,
    Placement,
    Scene,
    Solution,
    SymmetryRecord,
    Trajectory,
)
from rpl_data.workspace import click_files, records
from rpl_data.workspace.correction_records import corrections_from_json, corrections_to_json
from rpl_data.workspace.label_arrays import LabelArrays, label_arrays
from rpl_data.workspace.network_records import network_views_from_json, network_views_to_json
from rpl_data.workspace.placement_records import placements_from_json, placements_to_json
from rpl_data.workspace.scene_files import SceneFiles
from rpl_data.workspace.summary import summary
from rpl_data.workspace.symmetry_records import symmetry_from_json, symmetry_to_json
from rpl_data.workspace.trajectory_text import trajectory_from_text, trajectory_to_text


@dataclass(frozen=True, init=False, repr=False)
class Workspace(SceneFiles):
    """A folder with everything about a dataset; it need not be there yet.

    To look into one that `build` made::

        ws = Workspace("my-workspace")
        ws                                        # how many scenes, frames, objects, labels
        ws.scene_names(), ws.object_names()
        ws.frames("00")                           # image files and times of a scene
        ws.labels("00")                           # one FrameLabel per labelled frame
        ws.label_arrays("cube").camera_from_object   # (n, 4, 4), metres; .frames has the numbers
        ws.model("cube").points_object            # (k, 3), metres, object frame
        ws.mesh("cube").vertices                  # (n, 3), metres, object frame
        ws.overlay("00", 12)                      # the labels of frame 12 drawn on its image, RGB

    Which file is where: `rpl_data.workspace.paths`. The truth of a recording, where there is one, is a
    workspace of its own: objects with solution and mesh, and labels.
    """

    def __repr__(self) -> str:
        return f"Workspace({str(self.root)!r}): {summary(self.root, self.scene_names, self.object_names)}"

    # Objects --------------------------------------------------------------------------------------

    def append_events(self, object_name: str, events: Iterable[Event]) -> None:
        """Append events to the click log, all or none; they are safely on disk when this returns."""
        parts = self.parts()
        click_files.append_events(self.clicks_file(object_name), map(parts.event_in_video, events))

    def load_events(self, object_name: str) -> list[Event]:
        """Load the events of the click log, ignoring a last line that a crash cut off."""
        parts = self.parts()
        events = click_files.read_events(self.clicks_file(object_name))
        with decoding(
            self.clicks_file(object_name), "delete the line that the annotation page did not write"
        ):
            return [parts.event_in_scene(event) for event in events]

    def load_annotation(self, object_name: str) -> Annotation:
        """Load the keypoint names and clicks of an object."""
        return replay(object_name, self.load_events(object_name))

    def save_solution(self, solution: Solution) -> None:
        """Write `solution.json`; what was refined of an earlier solution is out of date and removed."""
        self.remove_refined(solution.model.name)
        write_json(self.solution_file(solution.model.name), records.solution_to_json(solution))

    def load_solution(self, object_name: str) -> Solution:
        """Load the solution of an object; DataError when there is none yet."""
        if not self.solution_file(object_name).exists():
            self._refuse_unknown_object(object_name)
            raise DataError(f"object {object_name} has no solution yet; run `rpl solve` on {self.root}")
        path = self.solution_file(object_name)
        with decoding(path, "make it again with `rpl solve --again true`"):
            return records.solution_from_json(read_json(path))

    def save_refined(self, solution: Solution) -> None:
        """Write refined.json."""
        write_json(self.refined_file(solution.model.name), records.solution_to_json(solution))

    def remove_refined(self, object_name: str) -> None:
        """From now on the solution of the clicks is the one that counts."""
        remove(self.refined_file(object_name))

    def load_placed(self, object_name: str) -> Solution:
        """The solution that labels follow: refined where that was done, else that of the clicks."""
        if not self.refined_file(object_name).exists():
            return self.load_solution(object_name)
        path = self.refined_file(object_name)
        with decoding(path, "make it again with `rpl refine --again true`"):
            return records.solution_from_json(read_json(path))

    def save_placements(self, object_name: str, placements: Mapping[str, Placement]) -> None:
        """Write placed.json: where `rpl register` placed the object, by scene."""
        write_json(self.placed_file(object_name), placements_to_json(placements))

    def load_placements(self, object_name: str) -> dict[str, Placement]:
        """Where `rpl register` placed the object, by scene; empty where it placed it nowhere."""
        path = self.placed_file(object_name)
        if not path.exists():
            return {}
        with decoding(path, "delete it, and register the object in those scenes again"):
            return placements_from_json(read_json(path))

    def save_grasp(self, object_name: str, object_from_grasp: Transform | None) -> None:
        """Write `grasp.json`; None deletes it."""
        if object_from_grasp is None:
            remove(self.grasp_file(object_name))
        else:
            content = {"object_from_grasp": numbers(object_from_grasp)}
            write_json(self.grasp_file(object_name), content)

    def save_symmetry(self, object_name: str, record: SymmetryRecord) -> None:
        """Write `symmetry.json`."""
        write_json(self.symmetry_file(object_name), symmetry_to_json(record))

    def load_symmetry(self, object_name: str) -> SymmetryRecord | None:
        """What is known of an object's symmetry, in the frame it had then; None where nobody asked."""
        path = self.symmetry_file(object_name)
        if not path.exists():
            return None
        with decoding(path, "delete it, and run `rpl symmetry` again"):
            return symmetry_from_json(read_json(path))

    def save_network_views(self, object_name: str, views: Mapping[str, NetworkView]) -> None:
        """Write `network.json`: where a trained network saw the object, by scene."""
        write_json(self.network_file(object_name), network_views_to_json(views))

    def load_network_views(self, object_name: str) -> dict[str, NetworkView]:
        """Where `rpl propose` saw the object, by scene; empty where it never ran."""
        path = self.network_file(object_name)
        if not path.exists():
            return {}
        with decoding(path, "delete it, and run `rpl propose` again"):
            return network_views_from_json(read_json(path))

    def save_path(self, object_name: str, place: str, scene: Scene, path: Trajectory) -> None:
        """Write the camera's poses in the frame of an object that is moved in a scene."""
        write_text(self.path_file(object_name, place), trajectory_to_text(scene, path))

    def load_path(self, object_name: str, place: str, scene: Scene) -> Trajectory:
        """Load the camera's poses in the frame of an object that is moved in a scene."""
        path = self.path_file(object_name, place)
        with decoding(path, "make it again with `rpl label --again true`"):
            return trajectory_from_text(scene, read_text(path))

    # Labels ---------------------------------------------------------------------------------------

    def save_labels(self, scene: str, labels: Iterable[FrameLabel]) -> int:
        """Write the labels of a scene one by one, in constant memory, and return the number of frames."""
        count = 0
        with writing(self.labels_file(scene)) as file:
            for label in labels:
                file.write(json.dumps(records.frame_label_to_json(label), allow_nan=False) + "\n")
                count += 1
        return count

    def save_left_out(self, scene: str, frames: Iterable[int]) -> None:
        """Write which frames stay out of exports; the choice survives when labels are made again."""
        write_json(self.left_out_file(scene), sorted(frames), indent=None)

    def load_left_out(self, scene: str) -> frozenset[int]:
        """Load the frames that stay out of exports; empty when none were chosen."""
        path = self.left_out_file(scene)
        if not path.exists():
            return frozenset()
        with decoding(path, "delete it, and choose the frames to leave out again"):
            return frozenset(each(whole)(read_json(path)))

    def save_corrections(self, corrections: Sequence[Correction]) -> None:
        """Write `corrections.json`; without any it is removed. They survive when labels are made again."""
        if corrections:
            write_json(self.corrections_file, corrections_to_json(corrections))
        else:
            remove(self.corrections_file)

    def load_corrections(self) -> list[Correction]:
        """Load what was changed in labels with other programs; empty when nothing was."""
        path = self.corrections_file
        if not path.exists():
            return []
        with decoding(path, "delete it, and import the edited labels again"):
            return corrections_from_json(read_json(path))

    def corrections_digest(self) -> str | None:
        """Stands for the corrections; None when there are none."""
        found = corrections_to_json(self.load_corrections())
        return hashlib.sha256(json.dumps(found).encode()).hexdigest()[:16] if found else None

    def load_labels(self, scene: str) -> Iterator[FrameLabel]:
        """Load the labels of a scene, one frame at a time."""
        path = self.labels_file(scene)
        if not path.exists():
            fault = f"scene {scene} has no labels yet; run `rpl label` on {self.root}"
            if scene not in self.scene_names():
                fault = f"there is no scene {scene} in {self.root}"
            raise DataError(
                f"{fault}. Scenes with labels: {', '.join(self.labelled_scene_names()) or 'none'}"
            )
        refuse_special(path)
        with path.open(encoding="utf-8", errors="replace") as file:
            for line_number, line in enumerate(file, start=1):
                with decoding(
                    f"{path} line {line_number}", "make the labels again with `rpl label --again true`"
                ):
                    label = records.frame_label_from_json(json.loads(line))
                yield label

    # For a person at a Python prompt ----------------------------------------------------------------

    def frames(self, scene: str) -> tuple[Frame, ...]:
        """The frames of a scene: number, time in seconds, colour and depth file."""
        return self.load_scene(scene).frames

    def labels(self, scene: str) -> list[FrameLabel]:
        """The labels of a scene, one per labelled frame; `load_labels` reads them one at a time."""
        parts = self.parts()
        video = parts.video_of(scene)
        return [x for x in self.load_labels(video) if scene in (video, parts.scene_at(video, x.frame))]

    def label_arrays(self, object_name: str, *, scene: str | None = None) -> LabelArrays:
        """The labels of an object as arrays, `camera_from_object` (n, 4, 4) among them.

        Args:
            object_name: one of `object_names()`.
            scene: only this one; all labelled scenes when left out.

        Raises:
            DataError: there is no such scene or object, or it has no labels.
        """
        scenes = self.labelled_scene_names() if scene is None else [scene]
        labels = [label for name in scenes for label in self.labels(name)]
        if not any(item.object == object_name for label in labels for item in label.instances):
            self._refuse_unknown_object(object_name)
        return label_arrays(object_name, labels)

    def model(self, object_name: str) -> KeypointModel:
        """The sparse model: names of the keypoints and their positions in the object frame, metres."""
        return self.load_placed(object_name).model

    def mesh(self, object_name: str) -> Mesh:
        """The dense model in the object frame, metres."""
        if not self.mesh_file(object_name).exists():
            self._refuse_unknown_object(object_name)
            raise DataError(f"object {object_name} has no mesh yet; run `rpl segment` on {self.root}")
        return load_mesh(self.mesh_file(object_name))

    def overlay(self, scene: str, frame: int) -> ColorImage:
        """The labels of a frame drawn on its colour image: RGB, uint8, height x width x 3.

        Raises:
            DataError: the frame has no label; the message names the labelled frame nearest to it.
        """
        labels = {label.frame: label for label in self.labels(scene)}
        if frame not in labels:
            near = min(labels, key=lambda number: abs(number - frame), default="none")
            raise DataError(f"scene {scene} has no label of frame {frame}; the nearest with one is {near}")
        models = {item.object: self.model(item.object) for item in labels[frame].instances}
        return draw_overlay(read_color(self.load_scene(scene).frame(frame)), labels[frame], models)

    def _refuse_unknown_object(self, name: str) -> None:
        if name not in self.object_names():
            known = ", ".join(self.object_names()) or "none"
            raise DataError(f"there is no object {name} in {self.root}; its objects are: {known}")
