"""Folder and file names of a workspace; no other module knows them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rpl_data.types.instances import instance_of, scene_of
from rpl_data.untrusted.names import checked_name


@dataclass(frozen=True, init=False)
class Paths:
    """Paths of all files in the folder of a workspace, whether they exist yet or not.

    ::

        recipe.yaml                   the resolved recipe that built it
        stages.json                   the options and inputs that each stage ran with
        corrections.json              what `rpl labels import` changed in labels
        build.lock                    held while a build runs
        copies/                       recordings that were copied from an object store
        uploads/                      what was copied to one, while that goes on
        recording/                    recording rendered from a twin (a synthetic scene), with truth/
        scenes/<scene>/               scene.json  trajectory.txt  given.txt  corrected.txt  drift.json
                                      surface.ply  cache/  images/
                                      moving.json, where objects are moved
                                      parts.json, when it was cut into scenes/<scene>.1/, <scene>.2/, ...
        objects/<object>/             clicks.jsonl  solution.json  refined.json  placed.json  mesh.ply
                                      cloud.ply  given.ply  grasp.json  symmetry.json
                                      exported.ply  network.json  paths/<scene>.txt
        labels/<scene>.jsonl          one line per frame
        labels/<scene>.left_out.json  frames that the user excluded from exports
        labels/earlier/<scene>.jsonl  of a recording that the last build had to leave out
        export/<format>/              coco, coco_truth, ...
        report/index.html
        synthesis/                    what `rpl synthesize` renders from, of the training scenes alone
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
        """The options and inputs that each stage ran with."""
        return self.root / "stages.json"

    @property
    def corrections_file(self) -> Path:
        """What was changed in labels with other programs."""
        return self.root / "corrections.json"

    @property
    def build_lock(self) -> Path:
        """The lock file that a running build holds."""
        return self.root / "build.lock"

    @property
    def cluster_build(self) -> Path:
        """Names the running build whose steps a cluster works on; they end when it is gone."""
        return self.root / "build.cluster"

    @property
    def recording(self) -> Path:
        """The folder that a twin writes its recording to."""
        return self.root / "recording"

    @property
    def copies(self) -> Path:
        """The folder of the recordings that were copied from an object store."""
        return self.root / "copies"

    def upload_log(self, name: str) -> Path:
        """What was copied to an object store, while that goes on."""
        return self.root / "uploads" / f"{name}.jsonl"

    @property
    def truth(self) -> Path:
        """The workspace with the recording's ground truth: the twin's, or made from given true poses."""
        return self.recording / "truth"

    @property
    def report(self) -> Path:
        """The report: a page to read in a browser."""
        return self.root / "report" / "index.html"

    @property
    def studio(self) -> Path:
        """The folder of what new views are rendered from."""
        return self.root / "synthesis"

    def export(self, name: str) -> Path:
        """The folder of an export."""
        return self.root / "export" / name

    def _scene(self, scene: str) -> Path:
        """The folder of a scene; DataError when its name could lead out of the workspace."""
        return self.root / "scenes" / checked_name(scene, "scene")

    def _object(self, object_name: str) -> Path:
        """The folder of an object; DataError when its name could lead out of the workspace."""
        return self.root / "objects" / checked_name(object_name, "object")

    def scene_file(self, scene: str) -> Path:
        """The file with the intrinsics and frames of a scene."""
        return self._scene(scene) / "scene.json"

    def trajectory_file(self, scene: str) -> Path:
        """The poses `scene_from_camera`, in TUM lines."""
        return self._scene(scene) / "trajectory.txt"

    def given_file(self, scene: str) -> Path:
        """The poses that the recording came with, as `trajectory_file`; none where it had none."""
        return self._scene(scene) / "given.txt"

    def corrected_file(self, scene: str) -> Path:
        """The poses as the images correct them, as `trajectory_file`, whether they are used or not."""
        return self._scene(scene) / "corrected.txt"

    def surface_file(self, scene: str) -> Path:
        """The surface near the objects, in the scene frame."""
        return self._scene(scene) / "surface.ply"

    def drift_file(self, scene: str) -> Path:
        """The measured drift of a recording's poses."""
        return self._scene(scene) / "drift.json"

    def parts_file(self, scene: str) -> Path:
        """The spans that a recording was cut into; the file is absent while the recording is whole."""
        return self._scene(scene) / "parts.json"

    def moving_file(self, scene: str) -> Path:
        """The file that is there where the objects of a scene are moved while it is filmed."""
        return self._scene(scene) / "moving.json"

    def path_file(self, object_name: str, place: str) -> Path:
        """The camera's poses in the frame of an object that is moved in a scene, as `trajectory_file`."""
        scene, instance = checked_name(scene_of(place), "scene"), instance_of(place)
        paths = self._object(object_name) / "paths"
        if not instance:
            return paths / f"{scene}.txt"
        return paths / f"{scene}.instances" / f"{checked_name(instance, 'instance')}.txt"

    def cache(self, scene: str) -> Path:
        """The folder of decoded depth, which can be deleted and rebuilt at any time."""
        return self._scene(scene) / "cache"

    def images(self, scene: str) -> Path:
        """The folder of images unpacked from a recording that is a single file (.klg, .bag, .db3)."""
        return self._scene(scene) / "images"

    def clicks_file(self, object_name: str) -> Path:
        """The log of clicks on an object."""
        return self._object(object_name) / "clicks.jsonl"

    def solution_file(self, object_name: str) -> Path:
        """The solved keypoint model and `scene_from_object` per scene."""
        return self._object(object_name) / "solution.json"

    def refined_file(self, object_name: str) -> Path:
        """The solution after its scenes were registered on one another."""
        return self._object(object_name) / "refined.json"

    def placed_file(self, object_name: str) -> Path:
        """The scenes in which `rpl register` placed the object."""
        return self._object(object_name) / "placed.json"

    def network_file(self, object_name: str) -> Path:
        """Where `rpl propose` saw the object, by scene."""
        return self._object(object_name) / "network.json"

    def mesh_file(self, object_name: str) -> Path:
        """The dense model as triangles, in the object frame, metres."""
        return self._object(object_name) / "mesh.ply"

    def exported_mesh_file(self, object_name: str) -> Path:
        """The dense model in the frame of the exports, where the recipe asks for another than its own."""
        return self._object(object_name) / "exported.ply"

    def cloud_file(self, object_name: str) -> Path:
        """The dense model as points, in the object frame, metres."""
        return self._object(object_name) / "cloud.ply"

    def given_mesh_file(self, object_name: str) -> Path:
        """The mesh that the user supplied for the object, in the frame of its known keypoints, metres."""
        return self._object(object_name) / "given.ply"

    def symmetry_file(self, object_name: str) -> Path:
        """What was found of the object's symmetry, and what a person confirmed."""
        return self._object(object_name) / "symmetry.json"

    def grasp_file(self, object_name: str) -> Path:
        """The grasp frame in the object frame."""
        return self._object(object_name) / "grasp.json"

    def labels_file(self, scene: str) -> Path:
        """The labels of a scene, one line per frame."""
        return self.root / "labels" / f"{checked_name(scene, 'scene')}.jsonl"

    def earlier_labels_file(self, scene: str) -> Path:
        """Labels of an earlier build, of a recording that the last one had to leave out."""
        return self.root / "labels" / "earlier" / f"{checked_name(scene, 'scene')}.jsonl"

    def left_out_file(self, scene: str) -> Path:
        """The frames of a scene that the user excluded from exports."""
        return self.root / "labels" / f"{checked_name(scene, 'scene')}.left_out.json"
