"""The recipes for data of the user's own: they read what they say they read."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import test_ycb_video
from recordings import CAMERA
from software_camera import record

from rpl_data.cli.main import main
from rpl_data.evaluate.truth import box_mesh, truth_from_poses
from rpl_data.formats.models.meshlab import write_picked_points
from rpl_data.geometry import invert, project, transform
from rpl_data.meshes import save_mesh
from rpl_data.pipeline.build import build
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.pipeline.sources import recordings_of
from rpl_data.recordings.open import open_scenes
from rpl_data.types import DataError, Mesh
from rpl_data.workspace.workspace import Workspace

DATASETS = Path(__file__).parents[2] / "datasets"
YCB = DATASETS / "ycb_video.yaml"
CORNERS = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.04, 0.04) for z in (-0.05, 0.05)])
MUSTARD = "006_mustard_bottle"


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """The sequences the recipe names, four frames each; two objects stand in them."""
    root = tmp_path / "YCB_Video_Dataset"
    names = load_recipe(YCB).scenes[0].names
    assert names is not None
    for name in names:
        test_ycb_video.make_sequence(root / "data" / name)
    return root


def test_ycb_video_is_read_without_its_object_poses(dataset: Path, tmp_path: Path) -> None:
    workspace = Workspace(tmp_path / "workspace")
    recipe = load_recipe(YCB, root=dataset)
    build(recipe, workspace, until="clicks", workers=1)
    assert workspace.scene_names() == sorted(recipe.scenes[0].names or ())
    assert workspace.object_names() == [one.name for one in recipe.objects]
    recording = workspace.load_recording("0048")
    assert len(recording.scene.frames) == len(workspace.load_trajectory(recording.scene).frames) == 4
    assert recording.true_poses == {}
    classes = [one.name for one in recipe.objects]
    assert [test_ycb_video.CLASSES.index(name) + 1 for name in classes] == [5, 9, 12, 15]


def test_the_truth_is_a_file_of_its_own(dataset: Path, tmp_path: Path) -> None:
    """The mustard bottle is a box in millimetres here, its corners the keypoints."""
    cads = tmp_path / "cads"
    box = box_mesh(CORNERS)
    save_mesh(cads / f"{MUSTARD}.ply", Mesh(1000 * box.vertices, box.triangles))
    names = tuple(str(number) for number in range(8))
    write_picked_points(cads / f"{MUSTARD}.pp", names, 1000 * CORNERS)
    out = tmp_path / "truth.json"
    arguments = ["truth", str(YCB), str(cads), str(out), "--root", str(dataset)]
    assert main([*arguments, "--metres_per_unit", "0.001"]) == 0
    assert list(json.loads(out.read_text())) == [
        f"{key}_{MUSTARD}" for key in ("points", "keypoints", "mesh", "camera_from")
    ]

    workspace, truth = Workspace(tmp_path / "workspace"), Workspace(tmp_path / "truth")
    build(load_recipe(YCB, root=dataset), workspace, until="import", workers=1)
    truth_from_poses(workspace, truth, out)
    frames = list(truth.load_labels("0050"))
    assert [frame.frame for frame in frames] == [1, 2, 3, 4]
    scene_from_camera = test_ycb_video.poses(4)[0]
    camera_from_mustard = invert(scene_from_camera) @ test_ycb_video.SCENE_FROM[5]
    (instance,) = frames[0].instances
    expected = project(CAMERA, transform(camera_from_mustard, CORNERS))
    np.testing.assert_allclose(instance.keypoints_px, expected, atol=1e-3)
    u0, v0, u1, v1 = instance.box_full
    assert u0 <= expected[:, 0].min() + 1 and u1 >= expected[:, 0].max() - 1
    assert v0 <= expected[:, 1].min() + 1 and v1 >= expected[:, 1].max() - 1


def test_truth_without_a_cad_or_of_other_objects(dataset: Path, tmp_path: Path) -> None:
    from rpl_data.cli.truth import write_true_poses

    recipe = load_recipe(YCB, root=dataset)
    recordings = open_scenes(dataset, "ycb_video", names=["0048"])
    with pytest.raises(DataError, match="has a CAD for none of 006_mustard_bottle, 035_power_drill"):
        write_true_poses(recordings, recipe, tmp_path, tmp_path / "out.json", metres_per_unit=1.0)
    other = replace(recipe, objects=(replace(recipe.objects[0], name="cup"),))
    with pytest.raises(DataError, match=r"true poses of 006_mustard_.*objects are cup; call them alike"):
        write_true_poses(recordings, other, tmp_path, tmp_path / "out.json", metres_per_unit=1.0)
    assert not (tmp_path / "out.json").exists()


def test_realsense_tracks_what_capture_and_the_viewer_record(tmp_path: Path) -> None:
    recipe = load_recipe(DATASETS / "realsense.yaml", root=tmp_path)
    assert recipe.reconstruct.method == "track"
    record(tmp_path / "00.db3", 3)
    source = replace(recipe.scenes[0], format="realsense")
    (recording,) = recordings_of([source], unpack=lambda scene: tmp_path / "images" / scene)
    assert recording.trajectory is None and len(recording.scene.frames) == 3
