"""Datasets merged: objects in one frame, shared images once, nothing half-written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labelled_scenes import BOX, CAMERA, CAN, labelled_scene
from pycocotools.coco import COCO

from rpl_data.dataset import merge_datasets
from rpl_data.dataset.written import Written
from rpl_data.export import ExportScene, export_coco
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import objects_from_coco, read_coco
from rpl_data.geometry import from_rotvec, invert, project, transform
from rpl_data.json_arrays import Json, matrix_from_json, rows_from_json
from rpl_data.symmetries import moved_symmetries, symmetries_of
from rpl_data.types import DataError, FrameLabel, KeypointModel, SymmetryAxis, Turns

TURN = from_rotvec(np.array([0.4, -1.1, 2.0]), np.array([0.02, -0.05, 0.3]))
"""From the object frame of one workspace to that of another."""


def turned(model: KeypointModel) -> KeypointModel:
    """The same object with the frame and the order of keypoints of another workspace."""
    return KeypointModel(
        model.name, model.keypoints[::-1], transform(TURN, model.points_object)[::-1], model.skeleton[:1]
    )


def relabelled(labels: tuple[FrameLabel, ...]) -> list[FrameLabel]:
    """The same labels in the other workspace's frame and order."""
    return [
        replace(
            label,
            instances=tuple(
                replace(
                    item,
                    camera_from_object=item.camera_from_object @ invert(TURN),
                    keypoints_px=item.keypoints_px[::-1],
                    visibility=item.visibility[::-1],
                    sigma_px=item.sigma_px[::-1],
                )
                for item in label.instances
            ),
        )
        for label in labels
    ]


def export(folder: Path, *, recording: Path, scene: str = "desk", other: bool = False, seed: int = 0) -> Path:
    """A dataset of one scene with six frames, in its own object frames if `other`."""
    made = labelled_scene(recording, scene, seed=seed)
    labels = relabelled(tuple(made.labels)) if other else made.labels
    models = [turned(BOX), turned(CAN)] if other else [BOX, CAN]
    item = ExportScene(made.scene, made.trajectory, labels)
    export_coco(folder, [item], models, split=SplitRule(0, 0.0))
    return folder


def by_frame(data: Json) -> dict[tuple[str, int, str], Json]:
    names = {category["id"]: category["name"] for category in data["categories"]}
    images = {image["id"]: image for image in data["images"]}
    return {
        (images[a["image_id"]]["scene"], images[a["image_id"]]["frame"], names[a["category_id"]]): a
        for a in data["annotations"]
    }


def merged(tmp_path: Path, **other: object) -> tuple[Written, Json]:
    """Two workspaces of the same objects, each with its own frames and recording of one name."""
    first = export(tmp_path / "a", recording=tmp_path / "ra")
    second = export(tmp_path / "b", recording=tmp_path / "rb", other=True, seed=7)
    written = merge_datasets(tmp_path / "out", [first, second])
    return written, read_coco(tmp_path / "out/train.json")


def test_poses_come_into_the_frame_of_the_first(tmp_path: Path) -> None:
    written, data = merged(tmp_path)
    mine = by_frame(data)
    truth = labelled_scene(tmp_path / "again", "desk", seed=7)
    assert written.images == {"train": 12}
    for label in truth.labels:
        for item in label.instances:
            found = mine["desk-2", label.frame, item.object]
            np.testing.assert_allclose(
                matrix_from_json(found["camera_from_object"]), item.camera_from_object, atol=1e-8
            )
            triples = np.array(found["keypoints"]).reshape(-1, 3)
            np.testing.assert_array_equal(triples[:, 2], item.visibility)
            known = item.visibility > 0
            np.testing.assert_allclose(triples[known, :2], item.keypoints_px[known], atol=1e-3)


def test_every_keypoint_is_the_projection_of_the_one_model(tmp_path: Path) -> None:
    _, data = merged(tmp_path)
    points = {o["category_id"]: rows_from_json(o["points_object"], 3) for o in data["rpl"]["objects"]}
    for annotation in data["annotations"]:
        pose = matrix_from_json(annotation["camera_from_object"])
        uv = project(CAMERA, transform(pose, points[annotation["category_id"]]))
        triples = np.array(annotation["keypoints"]).reshape(-1, 3)
        seen = triples[:, 2] > 0
        np.testing.assert_allclose(triples[seen, :2], uv[seen], atol=1e-3)


def test_another_reader_opens_the_result(tmp_path: Path) -> None:
    written, _ = merged(tmp_path)
    coco = COCO(str(tmp_path / "out/train.json"))
    assert len(coco.getImgIds()) == 12 and len(coco.getAnnIds()) == written.annotations["train"] == 20
    for image in coco.loadImgs(coco.getImgIds()):
        assert (tmp_path / "out" / image["file_name"]).is_file()
        assert (tmp_path / "out" / image["depth_file_name"]).is_file()
    assert all(coco.annToMask(a).sum() == a["area"] for a in coco.loadAnns(coco.getAnnIds()))


def test_each_image_keeps_the_unit_of_its_depth(tmp_path: Path) -> None:
    export(tmp_path / "a", recording=tmp_path / "ra")
    made = labelled_scene(tmp_path / "rb", "shelf", seed=7)
    finer = replace(made, scene=replace(made.scene, metres_per_unit=0.0002))
    export_coco(tmp_path / "b", [finer], [BOX, CAN], split=SplitRule(0, 0.0))
    merge_datasets(tmp_path / "out", [tmp_path / "a", tmp_path / "b"])
    found = {i["scene"]: i["metres_per_unit"] for i in read_coco(tmp_path / "out/train.json")["images"]}
    assert found == {"desk": 0.001, "shelf": 0.0002}


def test_symmetries_that_one_source_knows_come_into_the_frame_of_the_first(tmp_path: Path) -> None:
    first = export(tmp_path / "a", recording=tmp_path / "ra")
    second = export(tmp_path / "b", recording=tmp_path / "rb", other=True, seed=7)
    data = json.loads((second / "train.json").read_text())
    half = Turns(SymmetryAxis((0.0, 0.0, 1.0), (0.01, 0.0, 0.0)), 2)
    in_theirs = moved_symmetries(symmetries_of([half]), TURN)
    data["rpl"]["objects"][1]["symmetries"] = [list(one) for one in in_theirs.discrete]
    (second / "train.json").write_text(json.dumps(data))
    written = merge_datasets(tmp_path / "out", [first, second])
    can = objects_from_coco(read_coco(tmp_path / "out/train.json"))[1]
    np.testing.assert_allclose(can.symmetries.discrete, symmetries_of([half]).discrete, atol=1e-8)
    assert any("only one of them says how it is symmetric" in line for line in written.messages)


def test_our_own_datasets_open_the_result(tmp_path: Path) -> None:
    from rpl_data.torch import InstanceDataset, KeypointDataset

    merged(tmp_path)
    _, target = InstanceDataset(tmp_path / "out", split="train")[3]
    assert target["masks"].shape == (2, CAMERA.height, CAMERA.width)
    assert len(KeypointDataset(tmp_path / "out", split="train", object="can")) == 10


def test_same_input_gives_the_same_hash_and_other_input_another(tmp_path: Path) -> None:
    written, _ = merged(tmp_path)
    again = merge_datasets(tmp_path / "again", [tmp_path / "a", tmp_path / "b"], images="copy")
    turned_round = merge_datasets(tmp_path / "round", [tmp_path / "b", tmp_path / "a"])
    assert written.content_hash == again.content_hash != turned_round.content_hash
    version = json.loads((tmp_path / "out/dataset.json").read_text())
    assert version["content_hash"] == written.content_hash
    assert [source["path"] for source in version["sources"]] == [str(tmp_path / "a"), str(tmp_path / "b")]


def test_other_keypoints_under_the_same_names_are_refused_with_the_numbers(tmp_path: Path) -> None:
    first = export(tmp_path / "a", recording=tmp_path / "ra")
    second = export(tmp_path / "b", recording=tmp_path / "rb", other=True, seed=7)
    data = json.loads((second / "train.json").read_text())
    points = data["rpl"]["objects"][1]["points_object"]
    points[0], points[1] = points[1], points[0]  # exchanged: no rigid transform undoes that
    (second / "train.json").write_text(json.dumps(data))
    with pytest.raises(
        DataError, match=r"object can in .*stay \d+\.\d mm apart.*up to \d+\.\d mm would pass"
    ):
        merge_datasets(tmp_path / "out", [first, second])
    assert not list(tmp_path.glob("*out*"))
    merge_datasets(tmp_path / "out", [first, second], most_residual_mm=100.0)


def test_a_shared_image_is_taken_once_with_the_objects_of_both(tmp_path: Path) -> None:
    made = labelled_scene(tmp_path / "recording", "desk")
    for name, model in (("a", BOX), ("b", CAN)):
        labels = [
            replace(label, instances=tuple(i for i in label.instances if i.object == model.name))
            for label in made.labels
        ]
        split = SplitRule(0, 0.0)
        export_coco(tmp_path / name, [ExportScene(made.scene, made.trajectory, labels)], [model], split=split)
    again = export(tmp_path / "c", recording=tmp_path / "copied")  # the same bytes in other files
    written = merge_datasets(tmp_path / "out", [tmp_path / "a", tmp_path / "b", again])
    data = read_coco(tmp_path / "out/train.json")
    assert written.images == {"train": 6}
    assert {key[0] for key in by_frame(data)} == {"desk"}
    assert len(data["annotations"]) == len(by_frame(data)) == 10  # no object twice in an image
    assert sum("6 images" in line for line in written.messages) == 2


def test_a_scene_that_one_source_tests_on_is_wholly_test(tmp_path: Path) -> None:
    first = export(tmp_path / "a", recording=tmp_path / "r")
    second = export(tmp_path / "b", recording=tmp_path / "copied")
    (second / "train.json").rename(second / "test.json")
    written = merge_datasets(tmp_path / "out", [first, second])
    assert written.images == {"test": 6}
    assert any("6 images moved to test" in line for line in written.messages)


@pytest.mark.parametrize("fault", ["no dataset", "a folder of the user", "itself", "one source"])
def test_faults_are_said_and_change_nothing(tmp_path: Path, fault: str) -> None:
    first = export(tmp_path / "a", recording=tmp_path / "ra")
    second = export(tmp_path / "b", recording=tmp_path / "rb", seed=7)
    out, sources = tmp_path / "out", [first, second]
    if fault == "no dataset":
        sources[1] = tmp_path / "ra"
    elif fault == "a folder of the user":
        out.mkdir()
        (out / "thesis.tex").write_text("years of work")
    elif fault == "itself":
        out = first
    else:
        sources = [first]
    before = sorted(str(path) for path in tmp_path.rglob("*"))
    with pytest.raises(DataError):
        merge_datasets(out, sources)
    assert sorted(str(path) for path in tmp_path.rglob("*")) == before
