"""Judged poses in the words of the field: perfect poses score 1, and a miss counts in each figure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from labelled_scenes import BOX, CAN, exported, two_boxes

from rpl_data.evaluate.truth import box_mesh
from rpl_data.export import export_coco
from rpl_data.export.bop_models import EVALUATED_TRIANGLES as EXPORTED_TRIANGLES
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import instance_from_coco, read_coco, write_coco
from rpl_data.meshes import save_mesh
from rpl_data.pose.benchmark import EVALUATED_TRIANGLES
from rpl_data.pose.errors import INFINITE, pose_errors
from rpl_data.types import DataError
from training.pose.benchmark import Benchmark
from training.pose.pipeline import SeenKeypoints
from training.pose.scores import Judged

MISSED = ("epnp", "not detected", INFINITE, np.full(3, np.inf), None, None)
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.05)])


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five images with a box and a can each; the box has a mesh."""
    return with_mesh(exported(tmp_path_factory.mktemp("benchmark"), models=(BOX, CAN)))


def with_mesh(folder: Path) -> Path:
    """The training split of an export whose first object, the box, has got a mesh."""
    save_mesh(folder / "box.ply", box_mesh(CORNERS))
    data = read_coco(folder / "train.json")
    data["rpl"]["objects"][0]["mesh"] = "box.ply"
    for image in data["images"]:  # the benchmark has no lens
        image["distortion"] = []
    write_coco(folder / "train.json", data)
    for path in (folder / "depth").rglob("*.png"):
        cv2.imwrite(str(path), np.full((120, 160), 3000, np.uint16))  # a wall behind everything
    return folder / "train.json"


def perfect(coco_json: Path) -> list[Judged]:
    """What a pipeline without errors would be judged as."""
    data = read_coco(coco_json)
    names = {image["id"]: image["file_name"] for image in data["images"]}
    found = []
    for annotation in data["annotations"]:
        if annotation["category_id"] == 1:
            label = instance_from_coco(annotation, "box")
            seen = SeenKeypoints("box", np.ones(3), 0.9, label.keypoints_px, np.ones(4), np.zeros((4, 2, 2)))
            errors = pose_errors(
                label.camera_from_object, label.camera_from_object, CORNERS, centre_object=np.zeros(3)
            )
            name, off = names[annotation["image_id"]], np.zeros(3)
            found.append(Judged("box", name, "epnp", "ok", errors, off, label.camera_from_object, seen))
    return found


def test_what_is_perfect_scores_one(truth: Path) -> None:
    judged = perfect(truth)
    benchmark = Benchmark(truth, metres_per_unit=None)
    found = benchmark.score(judged)
    assert (found.average_recall, found.recall_vsd, found.recall_mssd, found.recall_mspd) == (1, 1, 1, 1)
    assert (found.auc_add, found.auc_adds, found.oks_ap, found.oks_ap50) == pytest.approx((1, 1, 1, 1))
    poses = list(benchmark.results(judged))
    assert [(pose.scene, pose.image, pose.object) for pose in poses] == [(1, n, 1) for n in range(1, 6)]
    assert poses[0].score == pytest.approx(0.9)


def test_a_unit_that_contradicts_the_file_is_refused(truth: Path) -> None:
    with pytest.raises(DataError, match=r"0\.001 m, says the file; metres_per_unit is 0\.0002"):
        Benchmark(truth, metres_per_unit=0.0002).score(perfect(truth))


def test_each_of_two_instances_has_its_own_estimate(tmp_path: Path) -> None:
    """Crops that are given give one each; the one that a detector finds may be of either instance."""
    export_coco(tmp_path / "coco", [two_boxes(tmp_path)], [BOX], split=SplitRule(val_fraction=0.0))
    coco_json = without_units(with_mesh(tmp_path / "coco"))
    benchmark, both = Benchmark(coco_json, metres_per_unit=None), perfect(coco_json)
    for found in ((True, True), (True, False), (False, True)):
        judged = [
            each if found[row % 2] else Judged(each.object, each.image, *MISSED)
            for row, each in enumerate(both)
        ]
        score, share = benchmark.score(judged), sum(found) / 2
        assert (score.recall_mssd, score.recall_mspd) == (share, share)
        assert score.oks_ap == pytest.approx(share, abs=0.01)
        assert len(list(benchmark.results(judged))) == 5 * sum(found)


def without_units(coco_json: Path) -> Path:
    """The file as earlier versions wrote it."""
    data = read_coco(coco_json)
    for image in data["images"]:
        del image["metres_per_unit"]
    older = coco_json.with_name("older.json")
    write_coco(older, data)
    return older


def test_older_exports_need_the_unit_said(truth: Path) -> None:
    older = without_units(truth)
    assert Benchmark(older, metres_per_unit=None).score(perfect(older)).recall_vsd is None
    assert Benchmark(older, metres_per_unit=0.001).score(perfect(older)).recall_vsd == 1


def test_a_miss_counts_in_each_figure(truth: Path) -> None:
    """One of five is not detected, one is 30 mm (0.1047 diameters) off across the view."""
    judged = perfect(truth)
    judged[0] = Judged("box", judged[0].image, *MISSED)
    moved = judged[1].pose.copy()
    moved[0, 3] += 0.03
    errors = pose_errors(moved, judged[1].pose, CORNERS, centre_object=np.zeros(3))
    judged[1] = replace(judged[1], pose=moved, errors=errors)
    benchmark = Benchmark(without_units(truth), metres_per_unit=None)
    found = benchmark.score(judged)
    assert found.average_recall is None and found.recall_vsd is None
    assert found.recall_mssd == pytest.approx((3 + 0.8) / 5)  # below 0.15 and what follows
    assert found.auc_add == pytest.approx((3 + 0.7) / 5)
    assert found.oks_ap == pytest.approx(81 / 101)  # the recalls 0, 0.01, ... 0.8
    assert len(list(benchmark.results(judged))) == 4


def test_models_are_as_coarse_as_those_of_the_export() -> None:
    assert EVALUATED_TRIANGLES == EXPORTED_TRIANGLES
