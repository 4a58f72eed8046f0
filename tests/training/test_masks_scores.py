"""Scores of predicted masks, the programs that use a trained network, and COCO files read without us."""

from __future__ import annotations

import ast
import json
import runpy
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from labelled_scenes import CAMERA, exported, rle
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from rpl_data.formats.datasets.coco import read_coco
from rpl_data.types import DataError
from training.masks.evaluation import evaluate, table
from training.masks.mask_rcnn import build_model
from training.masks.prediction import predict_to
from training.masks.scores import average_precision, score_split
from training.masks.weights import Segmenter
from training.predict_masks import predict_masks
from training.runs.options import MaskNetwork

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "training/examples/plain_torchvision.py"


@pytest.fixture(scope="module")
def coco(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("scores"))


@pytest.fixture(scope="module")
def segmenter():
    """Random weights and no threshold: it finds something everywhere."""
    torch.manual_seed(0)
    config = MaskNetwork(
        "resnet18", 64, channels=32, hidden=64, proposals=50, rois=16, detections=5, norm="group"
    )
    model = build_model(config, classes=2).eval()
    model.roi_heads.score_thresh = 0.0
    return Segmenter(model, config, ("background", "box", "can"))


def perfect(data):
    return [
        {key: a[key] for key in ("image_id", "category_id", "bbox", "segmentation")} | {"score": 0.9}
        for a in data["annotations"]
    ]


def shifted(results, columns):
    """The masks moved to the right."""
    from pycocotools import mask as masks

    moved = []
    for entry in results:
        mask = rle(np.roll(masks.decode(entry["segmentation"]), columns, axis=1))
        moved.append({**entry, "segmentation": mask, "bbox": masks.toBbox(mask).tolist()})
    return moved


# Scores -------------------------------------------------------------------------------------------


def test_the_labels_themselves_score_1(coco):
    results = perfect(read_coco(coco / "train.json"))
    score = score_split(coco / "train.json", results, threshold=0.5)
    assert (score.images, score.mean_iou, score.box_ap, score.mask_ap50) == (6, 1.0, 1.0, 1.0)
    assert [(c.name, c.images, c.missed, c.false_alarms) for c in score.classes] == [
        ("box", 5, 0, 0), ("can", 5, 0, 0),
    ]  # fmt: skip
    low = score_split(coco / "train.json", results, threshold=0.95)
    assert low.mean_iou == 0.0 and low.mask_ap == 1.0 and low.classes[0].missed == 5
    assert "100.0" in table(score)


def test_iou_by_hand(coco):
    data = read_coco(coco / "train.json")
    can = next(a for a in data["annotations"] if a["category_id"] == 2)
    empty = data["images"][0]["id"]
    left, top, width, height = (int(side) for side in can["bbox"])
    half = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    half[top : top + height, left : left + width // 2] = True
    guess = {"image_id": can["image_id"], "category_id": 2, "bbox": can["bbox"], "score": 0.9}
    results = [{**guess, "segmentation": rle(half)}, {**guess, "segmentation": rle(half), "image_id": empty}]
    box, found = score_split(coco / "train.json", results, threshold=0.5).classes
    assert found.mean_iou == pytest.approx((width // 2) / width / 5)
    assert (found.missed, found.false_alarms) == (4, 1)
    assert (box.mean_iou, box.missed, box.false_alarms, box.mask_ap) == (0.0, 5, 0, 0.0)


def test_what_is_found_in_a_crowd_counts_neither_for_nor_against(coco, tmp_path):
    """The box of one image is ignored in another, which shows none, and beside it where it is."""
    data = read_coco(coco / "train.json")
    box = next(a for a in data["annotations"] if a["category_id"] == 1)
    (aside,) = shifted(perfect({"annotations": [box]}), 30)
    results = [*perfect(data), aside, {**aside, "image_id": data["images"][0]["id"]}]
    fine, spoilt = ([
        (c.mean_iou, c.missed, c.false_alarms) for c in score_split(path, results, threshold=0.5).classes
    ] for path in (with_crowds(coco, data, results[-2:], tmp_path), coco / "train.json"))  # fmt: skip
    assert fine == [(1.0, 0, 0), (1.0, 0, 0)]
    assert spoilt[0][0] < 1 and spoilt[0][2] == 1


def with_crowds(coco, data, found, folder):
    """The split with the masks of results as ignored regions."""
    marked = [
        {**one, "area": data["annotations"][0]["area"], "id": 1000 + n, "iscrowd": 1}
        for n, one in enumerate(found)
    ]
    path = folder / "train.json"
    path.write_text(json.dumps({**data, "annotations": [*data["annotations"], *marked]}))
    return path


def test_average_precision_is_pycocotools(coco):
    data = read_coco(coco / "train.json")
    results = shifted(perfect(data), 3)[:-2] + shifted(perfect(data), 30)
    for number, entry in enumerate(results):
        entry["score"] = 0.2 + 0.03 * (number * 7 % 20)
    judge = COCO(str(coco / "train.json"))
    for kind in ("bbox", "segm"):
        evaluation = COCOeval(judge, judge.loadRes([dict(entry) for entry in results]), kind)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
        found = average_precision(data, results, kind)
        assert 0.05 < found.all < 0.95
        assert (found.all, found.all50) == pytest.approx(tuple(evaluation.stats[:2]))


def test_a_class_the_truth_lacks_has_no_score(coco, tmp_path):
    data = read_coco(coco / "train.json")
    alarms = perfect(data)
    data["annotations"] = [a for a in data["annotations"] if a["category_id"] == 1]
    (tmp_path / "test.json").write_text(json.dumps(data))
    score = score_split(tmp_path / "test.json", alarms, threshold=0.5)
    box, can = score.classes
    assert (score.mean_iou, box.mean_iou, box.mask_ap) == (1.0, 1.0, 1.0)
    assert (can.images, can.mean_iou, can.mask_ap, can.false_alarms) == (0, None, None, 5)
    data["annotations"] = []
    (tmp_path / "test.json").write_text(json.dumps(data))
    nothing = score_split(tmp_path / "test.json", alarms, threshold=0.5)
    assert (nothing.mean_iou, nothing.mask_ap) == (None, None) and " - " in table(nothing)


def test_nothing_found_scores_0(coco):
    score = score_split(coco / "train.json", [], threshold=0.5)
    assert (score.mean_iou, score.box_ap, score.mask_ap50) == (0.0, 0.0, 0.0)


def test_more_than_100_instances_all_count(coco):
    data = read_coco(coco / "train.json")
    pattern = data["annotations"][0]
    data["annotations"] = []
    for number in range(150):
        pixels = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
        row, column = 8 * (number // 15), 10 * (number % 15)
        pixels[row : row + 6, column : column + 8] = True
        entry = {"id": number + 1, "segmentation": rle(pixels), "bbox": [column, row, 8, 6], "area": 48}
        data["annotations"].append({**pattern, **entry})
    assert average_precision(data, perfect(data), "segm").all == 1.0
    assert average_precision(data, perfect(data)[:75], "segm").all == pytest.approx(0.5, abs=0.01)


# Programs -----------------------------------------------------------------------------------------


def test_evaluate_writes_results_that_pycocotools_reads(coco, segmenter, tmp_path):
    score = evaluate(segmenter, coco / "train.json", tmp_path)
    results = COCO(str(coco / "train.json")).loadRes(str(tmp_path / "train_results.json"))
    assert len(results.getAnnIds()) > 0 and set(results.getCatIds()) == {1, 2}
    written = json.loads((tmp_path / "train_scores.json").read_text())
    assert written["threshold"] == 0.5 and written["mask_ap"] == score.mask_ap


def test_a_network_of_other_objects_is_not_scored(coco, segmenter):
    """Results name classes by number, so a can would be judged as a box."""
    turned = replace(segmenter, names=("background", "can", "box"))
    with pytest.raises(DataError, match="has the objects box, can, the checkpoint can, box"):
        evaluate(turned, coco / "train.json")


def test_predict_a_folder_an_image_and_a_video(coco, segmenter, tmp_path):
    source, none = coco / "images" / "desk", Counter()
    images, drawn = predict_to(segmenter, source, tmp_path / "folder", threshold=0.0, unreadable=none)
    listed = json.loads((tmp_path / "folder" / "images.json").read_text())
    results = json.loads((tmp_path / "folder" / "results.json").read_text())
    assert images == len(listed["images"]) == 6 and drawn == len(results) > 6
    names = [image["file_name"] for image in listed["images"]]
    assert names == sorted(path.name for path in source.iterdir())
    assert {entry["image_id"] for entry in results} == {image["id"] for image in listed["images"]}
    for name in names:
        drawn, plain = (cv2.imread(str(folder / name)) for folder in (tmp_path / "folder", source))
        assert drawn.shape == plain.shape and (drawn != plain).any()
    assert predict_to(segmenter, source / names[0], tmp_path / "image", threshold=2.0, unreadable=none) == (
        1,
        0,
    )
    np.testing.assert_array_equal(
        cv2.imread(str(tmp_path / "image" / names[0])), cv2.imread(str(source / names[0]))
    )
    writer = cv2.VideoWriter(
        str(tmp_path / "clip.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 12.0, (CAMERA.width, CAMERA.height)
    )
    for name in names[:3]:
        writer.write(cv2.imread(str(source / name)))
    writer.release()
    video = predict_to(segmenter, tmp_path / "clip.avi", tmp_path / "video", threshold=0.0, unreadable=none)
    assert video[0] == 3 and not none
    film = cv2.VideoCapture(str(tmp_path / "video" / "clip.mp4"))
    assert (film.get(cv2.CAP_PROP_FRAME_COUNT), film.get(cv2.CAP_PROP_FPS)) == (3, 12)


def test_predict_refuses_what_it_cannot_read(segmenter, coco, tmp_path):
    (tmp_path / "notes.txt").write_text("no video")
    (tmp_path / "empty").mkdir()
    for source in (tmp_path / "notes.txt", tmp_path / "empty", tmp_path / "absent.mp4"):
        with pytest.raises(DataError, match=source.name):
            predict_to(segmenter, source, tmp_path / "out", threshold=0.5, unreadable=Counter())
    assert not (tmp_path / "out" / "results.json").exists()
    with pytest.raises(DataError, match="would replace"):
        predict_masks(coco / "images/desk", tmp_path / "last.ckpt", out=coco / "images/desk")


# COCO files without us ----------------------------------------------------------------------------


def test_torchvision_and_pycocotools_alone_train_on_an_export(coco, tmp_path, monkeypatch, capsys):
    roots = {
        name.split(".")[0] for node in ast.walk(ast.parse(EXAMPLE.read_text())) for name in _imported(node)
    }
    assert roots == {"argparse", "pathlib", "torch", "torchvision", "pycocotools"}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(coco / "train.json"), "--steps", "1", "--size", "64"])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    said = capsys.readouterr().out.splitlines()
    losses = [float(line.split()[-1]) for line in said if line.startswith("step")]
    assert len(losses) == 1 and all(0 < loss < 50 for loss in losses)


def _imported(node):
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module] if isinstance(node, ast.ImportFrom) else []


def test_fields_are_what_detectron2_expects(coco):
    """detectron2/data/datasets/coco.py, load_coco_json: the asserts and the fields it copies."""
    data = json.loads((coco / "train.json").read_text())
    assert sorted(c["id"] for c in data["categories"]) == list(range(1, len(data["categories"]) + 1))
    ids = [a["id"] for a in data["annotations"]]
    assert len(set(ids)) == len(ids) and all(isinstance(number, int) and number > 0 for number in ids)
    images = {image["id"]: image for image in data["images"]}
    for image in images.values():
        picture = cv2.imread(str(coco / image["file_name"]))
        assert picture.shape == (image["height"], image["width"], 3)
    for a in data["annotations"]:
        image = images[a["image_id"]]
        assert a.get("ignore", 0) == 0 and a["iscrowd"] == 0 and len(a["bbox"]) == 4
        assert isinstance(a["segmentation"], dict) and isinstance(a["segmentation"]["counts"], str)
        assert a["segmentation"]["size"] == [image["height"], image["width"]]
        # keypoints: flat triples; it adds half a pixel to x and y itself, ours being pixel indices.
        names = data["categories"][a["category_id"] - 1]["keypoints"]
        assert len(a["keypoints"]) == 3 * len(names)


def test_fields_are_what_mmdetection_expects(coco):
    """mmdet/datasets/coco.py, parse_data_info: an annotation it would skip would be lost in silence."""
    data = json.loads((coco / "train.json").read_text())
    images, categories = {i["id"]: i for i in data["images"]}, {c["id"] for c in data["categories"]}
    assert data["annotations"]
    for a in data["annotations"]:
        x, y, width, height = a["bbox"]
        image = images[a["image_id"]]
        inside_width = max(0, min(x + width, image["width"]) - max(x, 0))
        inside_height = max(0, min(y + height, image["height"]) - max(y, 0))
        assert not a.get("ignore", False) and inside_width * inside_height > 0
        assert a["area"] > 0 and width >= 1 and height >= 1 and a["category_id"] in categories
        assert (inside_width, inside_height) == (width, height)
    assert all({"id", "name"} <= set(c) for c in data["categories"])
