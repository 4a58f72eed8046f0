"""The only module that knows our folder and file names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, init=False)
class Paths:
    """Where everything is in the folder of a workspace, whether it is there yet or not.

    ::

        recipe.yaml                   the resolved recipe that built it
        stages.json                   what each stage ran with
        build.lock                    held while a build is at work
        recording/                    the synthetic recording of a twin, with recording/truth/
        scenes/<scene>/               scene.json  trajectory.txt  drift.json  surface.ply  cache/  images/
                                      parts.json, where it was cut into scenes/<scene>.1/, <scene>.2/, ...
        objects/<object>/             clicks.jsonl  solution.json  mesh.ply  cloud.ply  given.ply  grasp.json
        labels/<scene>.jsonl          one line per frame
        labels/<scene>.left_out.json  frames that a person keeps out of exports
        export/<format>/              coco, coco_truth, ...
        report/index.html
    """

    root: Path

    def __init__(self, root: str | Path) -> None:
        object.__setattr__(self, "root", Path(root).expanduser())

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
