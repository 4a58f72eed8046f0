"""`rpl synthesize` on a workspace: nothing of a test scene, exact labels, one seed one result, resumed."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from pycocotools import mask as masks

from rpl_data.export.checks import check_export
from rpl_data.export.folder import Filling
from rpl_data.files import read_json
from rpl_data.formats.datasets.coco import intrinsics_from_coco, read_coco
from rpl_data.meshes import load_mesh
from rpl_data.pipeline.synthesis import run
from rpl_data.pipeline.synthesis.make import _take
from rpl_data.pipeline.synthesis.models import scene_table
from rpl_data.pipeline.synthesis.pictures import plate_depth
from rpl_data.pipeline.synthesis.plates import _Image, make_plates, plane_in_camera, without_objects
from rpl_data.pipeline.synthesis.run import synthesize_workspace
from rpl_data.pipeline.synthesis.training import outdated_line, training_split
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.synthesize.storage import load_studio
from rpl_data.synthesize.studio import Plate
from rpl_data.types import DataError, Intrinsics
from rpl_data.workspace.workspace import Workspace

COUNT = 3
QUIET = {"tell": lambda text: None, "advance": lambda done, total: None}
OPTIONS = {
    "count": COUNT, "objects": None, "width_px": None, "seed": 0, "backgrounds": None, "mix": True,
    "again": False,
}  # fmt: skip


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def workspace(tiny_workspace: Workspace, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """The tiny workspace with views made of its training scenes, mixed with its images."""
    root = tmp_path_factory.mktemp("synthesis") / "ws"
    shutil.copytree(tiny_workspace.root, root, ignore=shutil.ignore_patterns("recording", "report"))
    (root / "recording").mkdir()
    (root / "recording" / "truth").symlink_to(tiny_workspace.truth)  # which names the objects
    workspace = Workspace(root)
    synthesize_workspace(workspace, None, **OPTIONS, **QUIET)
    return workspace


@pytest.fixture(scope="module")
def made(workspace: Workspace) -> dict:
    """The training split that was written."""
    return read_coco(workspace.export("synthetic") / "train.json")


def test_the_export_is_one_of_ours_and_says_where_images_are_from(workspace: Workspace, made: dict) -> None:
    folder = workspace.export("synthetic")
    coco = workspace.export("coco")
    assert check_export(folder) == []
    origins = [image["origin"] for image in made["images"]]
    recorded = read_coco(coco / "train.json")["images"]
    assert origins == ["recorded"] * len(recorded) + ["synthetic"] * COUNT
    test = {image["scene"] for image in read_json(coco / "test.json")["images"]}
    scenes = made["rpl"]["synthetic"]["scenes"]
    assert scenes == sorted({image["scene"] for image in recorded}) and not test & set(scenes)
    assert sorted(made["rpl"]["synthetic"]["images_of"]) == scenes
    assert {image["plate"]["scene"] for image in made["images"][-COUNT:]} <= set(scenes)
    for split in ("val", "test"):
        images = read_coco(folder / f"{split}.json")["images"]
        assert {image["origin"] for image in images} == {"recorded"}
        assert len(images) == len(read_json(coco / f"{split}.json")["images"])
    for image in made["images"][-COUNT:]:
        color = cv2.imread(str(folder / image["file_name"]))
        depth = cv2.imread(str(folder / image["depth_file_name"]), cv2.IMREAD_UNCHANGED)
        assert color.shape[:2] == depth.shape == (240, 320) and depth.dtype == np.uint16


def test_labels_are_those_of_the_mesh_drawn_anew(workspace: Workspace, made: dict) -> None:
    folder = workspace.export("synthetic")
    described = made["rpl"]["objects"][0]
    rays = RayScene([load_mesh(folder / described["mesh"])])
    points = np.array(described["points_object"])
    images = {image["id"]: image for image in made["images"] if image["origin"] == "synthetic"}
    labels = [one for one in made["annotations"] if one["image_id"] in images]
    assert len(labels) == COUNT
    for one in labels:
        camera = intrinsics_from_coco(images[one["image_id"]])
        pose = np.array(one["camera_from_object"]).reshape(4, 4)
        drawn = render_depth_m(rays, camera, pose, left_px=0, top_px=0, width=320, height=240)
        full, visible = masks.decode(one["segmentation_full"]), masks.decode(one["segmentation"])
        assert (full != (drawn > 0)).sum() <= 2  # a ray along an edge may go either way
        assert (visible == full).all() and one["visib_fract"] == 1.0
        uv, _ = cv2.projectPoints(points, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], camera.matrix, None)
        keypoints = np.array(one["keypoints"]).reshape(-1, 3)
        known = keypoints[:, 2] > 0
        np.testing.assert_allclose(keypoints[known, :2], uv[known, 0], atol=1e-3)
        measured = (
            cv2.imread(str(folder / images[one["image_id"]]["depth_file_name"]), cv2.IMREAD_UNCHANGED)
            * images[one["image_id"]]["metres_per_unit"]
        )
        known_depth = (drawn > 0) & (measured > 0)
        assert np.median(np.abs(measured - drawn)[known_depth]) < 0.005


def test_no_byte_of_a_test_scene_enters(workspace: Workspace, tmp_path: Path) -> None:
    other = Workspace(tmp_path / "ws")
    without = shutil.ignore_patterns("synthetic", "synthesis")
    shutil.copytree(workspace.root, other.root, ignore=without, symlinks=True)
    scenes = {image["scene"] for image in read_json(other.export("coco") / "test.json")["images"]}
    for scene in scenes:
        frames = other.load_scene(scene).frames
        assert not any(str(frame.color).startswith(str(other.root)) for frame in frames)
        for folder in ("images", "depth"):
            shutil.rmtree(other.export("coco") / folder / scene)
        record = json.loads(other.scene_file(scene).read_text().replace("/recording/", "/nowhere/"))
        other.scene_file(scene).write_text(json.dumps(record))  # as if its recording was deleted
        other.surface_file(scene).unlink()
        shutil.rmtree(other.cache(scene), ignore_errors=True)
    for name in other.object_names():  # made of all scenes
        other.mesh_file(name).unlink()
        other.cloud_file(name).unlink()
    synthesize_workspace(other, None, **OPTIONS | {"mix": False}, **QUIET)
    assert content(other.studio).keys() == content(workspace.studio).keys()
    before, after = content(workspace.export("synthetic")), content(other.export("synthetic"))
    rendered = {name: data for name, data in after.items() if "synthetic" in name or "meshes" in name}
    assert len(rendered) == 2 * COUNT + 1
    assert all(before[name] == data for name, data in rendered.items())


def test_an_interrupted_run_goes_on_and_ends_the_same(workspace: Workspace, tmp_path: Path) -> None:
    done: list[int] = []

    def interrupt(number: int, total: int) -> None:
        done.append(number)
        if number == 2 and done.count(2) == 1:
            raise KeyboardInterrupt

    options = OPTIONS | {"mix": False}
    quiet = QUIET | {"advance": interrupt}
    with pytest.raises(KeyboardInterrupt):
        synthesize_workspace(workspace, tmp_path / "out", **options, **quiet)
    assert not (tmp_path / "out").exists()
    synthesize_workspace(workspace, tmp_path / "out", **options, **quiet)
    assert done == [0, 1, 2, 2, 3] and [path.name for path in tmp_path.iterdir()] == ["out"]
    whole = content(workspace.export("synthetic"))
    assert all(
        data == whole[name] for name, data in content(tmp_path / "out").items() if name.startswith("images")
    )


def test_each_part_of_a_recording_has_its_own_table(workspace: Workspace, tmp_path: Path) -> None:
    """Poses drift: after a cut the same table lies elsewhere."""
    training = training_split(workspace)
    normal, offset_m = next(filter(None, (scene_table(workspace, scene) for scene in training.scenes)))
    drift_m = {"even": 0.0, "odd": 0.02}
    plates = make_plates(
        tmp_path,
        training,
        lambda image: "odd" if image["frame"] % 2 else "even",
        {part: (normal, offset_m + off_m) for part, off_m in drift_m.items()},
        dict.fromkeys(drift_m, normal),
    )
    images = {(image["scene"], image["frame"]): image for image in training.data["images"]}
    centres = [np.reshape(images[p.scene, p.frame]["scene_from_camera"], (4, 4))[:3, 3] for p in plates]
    off_m = [p.table.offset_m - offset_m + normal @ at for p, at in zip(plates, centres, strict=True)]
    np.testing.assert_allclose(off_m, [drift_m["odd" if p.frame % 2 else "even"] for p in plates], atol=1e-9)
    assert len(set(np.round(off_m, 6))) == 2


def test_pictures_of_the_user_take_the_place_of_tables(workspace: Workspace, tmp_path: Path) -> None:
    (tmp_path / "walls").mkdir()
    cv2.imwrite(str(tmp_path / "walls" / "blue.png"), np.full((50, 90, 3), (200, 40, 0), np.uint8))
    options = OPTIONS | {"mix": False, "count": 1, "width_px": 160, "backgrounds": tmp_path / "walls"}
    synthesize_workspace(workspace, tmp_path / "out", **options, **QUIET)
    (image,) = read_coco(tmp_path / "out" / "train.json")["images"]
    color = cv2.imread(str(tmp_path / "out" / image["file_name"]))
    assert color.shape == (120, 160, 3) and image["depth_file_name"] is None
    assert np.abs(np.median(color, axis=(0, 1)) - [200, 40, 0]).max() < 3


def test_an_object_without_a_model_of_training_scenes_is_left_out(workspace: Workspace) -> None:
    studio, training = load_studio(workspace.studio), training_split(workspace)
    assert run._names(studio, training, None) == (("carton",), [])
    without = replace(studio, subjects={})
    with pytest.raises(DataError, match="object carton: stands still in none of the training scenes"):
        run._names(without, training, ["carton"])
    outlined = replace(studio, subjects={"carton": replace(studio.subjects["carton"], carved=True)})
    names, lines = run._names(outlined, training, None)
    assert names == ("carton",) and "hollows are shown filled" in lines[0]


def test_ids_of_rendered_labels_follow_those_of_ignored_regions(tmp_path: Path) -> None:
    crowd = {"id": 9, "image_id": 1}
    image = {"id": 1, "file_name": None, "depth_file_name": None}
    taken: list = []
    data = {"images": [image], "annotations": [{"id": 4, "image_id": 1}], "crowds": [crowd]}
    assert _take(lambda *entry: taken.append(entry), tmp_path, tmp_path, data, Filling()) == (1, 9)
    assert [one["id"] for one in taken[0][1]] == [4, 9]


def test_depth_of_a_smaller_plate_is_that_in_the_middle_of_its_pixels(tmp_path: Path) -> None:
    ramp = np.arange(32, dtype=np.uint16)[None].repeat(8, axis=0)
    cv2.imwrite(str(tmp_path / "ramp.png"), ramp)
    camera = Intrinsics(4.0, 4.0, 3.5, 0.5, 8, 2)
    plate = Plate("00", 0, tmp_path, tmp_path / "ramp.png", 0.001, camera, np.eye(3)[0], None)
    assert np.abs(plate_depth(plate)[0] - (4 * np.arange(8) + 1.5)).max() <= 0.5


def test_what_is_wrong_is_said_before_any_work(
    workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "studio_of", None)  # not reached
    mine = tmp_path / "mine" / "studio" / "song.wav"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    for out in (workspace.export("coco"), mine.parents[1], mine, workspace.root):
        with pytest.raises(DataError, match="did not write it"):
            synthesize_workspace(workspace, out, **OPTIONS, **QUIET)
    assert mine.read_text() == "mine"
    for options, said in (
        ({"objects": ["mug"]}, "no object mug in the training images; they show carton"),
        ({"objects": []}, "names none"),
        ({"count": -1}, "--count is -1"),
        ({"width_px": 63}, "--width 63"),
        ({"count": 0, "width_px": 64}, "--count 0 renders none"),
        ({"backgrounds": mine}, "is no folder"),
        ({"backgrounds": mine.parent}, "has no pictures"),
    ):
        with pytest.raises(DataError, match=said):
            synthesize_workspace(workspace, tmp_path / "out", **OPTIONS | options, **QUIET)
    shutil.copytree(
        workspace.root, tmp_path / "ws", ignore=shutil.ignore_patterns("export", "synthesis", "cache")
    )
    with pytest.raises(DataError, match="run `rpl export"):
        synthesize_workspace(Workspace(tmp_path / "ws"), None, **OPTIONS, **QUIET)


def test_places_of_objects_are_filled_with_what_other_images_show_there(tmp_path: Path) -> None:
    """Two cameras above one printed table; an object hides another part of it from each."""
    camera = Intrinsics(100.0, 100.0, 49.5, 39.5, 100, 80)
    rng = np.random.default_rng(0)
    table = cv2.resize(
        rng.integers(0, 255, (30, 30, 3)).astype(np.uint8), (600, 600), interpolation=cv2.INTER_CUBIC
    )
    images = []
    for number, (x, turn) in enumerate(((0.0, 0.0), (0.15, 0.3))):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([np.pi, 0, 0.0]))[0] @ cv2.Rodrigues(np.array([0, 0, turn]))[0]
        pose[:3, 3] = [x, 0, 0.8]  # looks down at the plane z = 0
        v, u = np.mgrid[:80, :100]
        rays = (
            np.stack([(u - 49.5) / 100, (v - 39.5) / 100, np.ones_like(u, float)], axis=-1) @ pose[:3, :3].T
        )
        on_table = pose[:3, 3] + rays * (-pose[2, 3] / rays[..., 2:])
        at = (300 + 300 * on_table[..., :2]).astype(np.float32)
        color = cv2.remap(table, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        objects = np.zeros((80, 100), bool)
        objects[30:50, 40 + 5 * number : 60] = True
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.where(objects[..., None], 0, color))
        entry = {"file_name": f"{number}.png", "scene": "00", "frame": number}
        images.append((_Image(entry, camera, pose, objects), color[..., ::-1]))
    (image, true), (other, _) = images
    plane = plane_in_camera((np.array([0.0, 0, 1]), 0.0), image.scene_from_camera)
    found = without_objects(image, [other], plane, tmp_path)
    assert (found[~image.objects] == true[~image.objects]).all()
    off = np.abs(found.astype(int) - true)[image.objects].mean()
    alone = np.abs(without_objects(image, [], plane, tmp_path).astype(int) - true)[image.objects].mean()
    assert off < 0.35 * alone


def test_views_of_earlier_labels_are_named(workspace: Workspace) -> None:
    labels = workspace.export("coco") / "train.json"
    exported = labels.read_text()
    assert outdated_line(workspace) is None
    labels.write_text(exported.replace('"quality"', '"quality" ', 1))
    said = outdated_line(workspace)
    assert said is not None and str(workspace.export("synthetic")) in said
    labels.write_text(exported)


def test_a_studio_names_its_scenes(workspace: Workspace) -> None:
    studio = load_studio(workspace.export("synthetic") / "studio")
    assert studio.scenes == tuple(read_json(workspace.studio / "studio.json")["made_of"]["scenes"])
    assert set(studio.subjects) == {"carton"} and 0 < studio.subjects["carton"].shown.mean() < 1
