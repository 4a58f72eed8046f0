"""BOP's errors, recalls and result files, and COCO's keypoint precision: by hand, and beside their own code.

The recorded numbers are those of bop_toolkit (https://github.com/thodan/bop_toolkit, commit cea62d6).
"""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from rpl_data.evaluate.truth import box_mesh
from rpl_data.formats.datasets.bop_results import PoseResult, read_bop_results, write_bop_results
from rpl_data.geometry import from_rotvec
from rpl_data.pose.average_recall import PIXELS, SHARES, Answers, add_auc, average_recall, found, recall
from rpl_data.pose.benchmark_errors import VSD_TAUS, mspd_px, mssd_m, rendered_vsd, vsd
from rpl_data.pose.errors import pose_errors
from rpl_data.pose.oks import SeenInImage, average_precision, oks
from rpl_data.raycast import PixelTable, RayScene
from rpl_data.types import DataError, Intrinsics

CAMERA = Intrinsics(100.0, 100.0, 79.5, 59.5, 160, 120)
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.02, 0.02)])
DIAMETER_M = float(np.linalg.norm(CORNERS[0] - CORNERS[-1]))
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
ALONE = np.eye(4)[None]
TRUE = from_rotvec(np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.8]))
ESTIMATED = from_rotvec(np.array([0.4, -0.1, 0.3]), np.array([0.03, -0.02, 0.82]))
MSSD_MM, MSPD_PX = 46.55189711972246, 4.621927109641962
ADD_MM, ADI_MM = 223.48688495658183, 28.023578435032398
VSD = [225 / 254, 106 / 254, 54 / 254, *[51 / 254] * 3, *[50 / 254] * 4]
"""Of `vsd` with the benchmark's tolerances, given depth images that `RayScene` rendered."""

# Errors -------------------------------------------------------------------------------------------


def test_a_shift_by_hand() -> None:
    """10 mm to the right at 0.5 m is 2 px for the near corners, which are 0.48 m away: 100 * 0.01 / 0.48."""
    true, shifted = np.eye(4), np.eye(4)
    true[2, 3] = shifted[2, 3] = 0.5
    shifted[0, 3] = 0.01
    assert mssd_m(shifted, true, CORNERS, ALONE) == pytest.approx(0.01)
    assert mspd_px(shifted, true, CORNERS, CAMERA, ALONE) == pytest.approx(1 / 0.48)


def test_half_a_turn_of_a_symmetric_object_is_no_error() -> None:
    both = np.stack([np.eye(4), HALF_TURN])
    assert mssd_m(TRUE @ HALF_TURN, TRUE, CORNERS, both) == pytest.approx(0, abs=1e-12)
    assert mspd_px(TRUE @ HALF_TURN, TRUE, CORNERS, CAMERA, both) == pytest.approx(0, abs=1e-9)
    assert mssd_m(TRUE @ HALF_TURN, TRUE, CORNERS, ALONE) == pytest.approx(2 * np.hypot(0.1, 0.05))


def test_errors_are_those_of_the_toolkit() -> None:
    both = np.stack([np.eye(4), HALF_TURN])
    turned = ESTIMATED @ HALF_TURN
    assert 1e3 * mssd_m(ESTIMATED, TRUE, CORNERS, ALONE) == pytest.approx(MSSD_MM, rel=1e-9)
    assert mspd_px(ESTIMATED, TRUE, CORNERS, CAMERA, ALONE) == pytest.approx(MSPD_PX, rel=1e-9)
    assert 1e3 * mssd_m(turned, TRUE, CORNERS, both) == pytest.approx(MSSD_MM, rel=1e-9)
    assert mspd_px(turned, TRUE, CORNERS, CAMERA, both) == pytest.approx(MSPD_PX, rel=1e-9)
    errors = pose_errors(turned, TRUE, CORNERS, centre_object=np.zeros(3))
    assert 1e3 * errors.add_m == pytest.approx(ADD_MM, rel=1e-9)
    assert 1e3 * errors.adds_m == pytest.approx(ADI_MM, rel=1e-9)


def test_a_point_behind_the_camera_is_infinitely_far_off() -> None:
    behind = np.eye(4)
    behind[2, 3] = -0.5
    assert mspd_px(behind, TRUE, CORNERS, CAMERA, ALONE) == np.inf


def test_visible_surfaces_by_hand() -> None:
    """Four pixels: apart by 0.2 diameters, equal, seen in one pose only, hidden by a nearer surface."""
    true = np.array([[1.0, 1.0, 1.0, 1.0]])
    estimated = np.array([[1.02, 1.0, 0.0, 1.0]])
    measured = np.array([[1.0, 0.0, 1.0, 0.5]])
    found = vsd(estimated, true, measured, diameter_m=0.1, taus=(0.1, 0.19, 0.3))
    np.testing.assert_allclose(found, [2 / 3, 2 / 3, 1 / 3])
    nowhere = np.zeros((1, 4))
    np.testing.assert_array_equal(vsd(nowhere, nowhere, measured, diameter_m=0.1), np.ones(10))


def test_rendered_surfaces_are_those_of_the_toolkit() -> None:
    """A wall at 0.9 m that comes forward to 0.7 m in the left half, and no depth in every seventh column."""
    measured = np.full((120, 160), 0.9)
    measured[:, :80] = 0.7
    measured[:, ::7] = 0.0
    mesh = box_mesh(CORNERS)
    rays, table = RayScene([mesh], threads=1), PixelTable.of(CAMERA)
    found = rendered_vsd(
        ESTIMATED, TRUE, measured, rays=rays, table=table, corners=CORNERS, diameter_m=DIAMETER_M
    )
    np.testing.assert_allclose(found, VSD, atol=1e-6)
    away = TRUE.copy()
    away[0, 3] = 50.0
    far = {"rays": rays, "table": table, "corners": CORNERS, "diameter_m": DIAMETER_M}
    assert rendered_vsd(away, away, measured, **far).tolist() == [1.0] * 10


# Recalls ------------------------------------------------------------------------------------------


def test_each_target_is_found_once_by_the_surest_estimate() -> None:
    """Two targets, three estimates: the third is not looked at, the second must take what is left."""
    errors = np.array([[0.1, 0.2], [0.05, 0.6], [0.0, 0.0]])
    answers = Answers(np.array([0.9, 0.8, 0.1]), errors)
    assert [found(answers, threshold) for threshold in (0.05, 0.15, 0.7)] == [0, 1, 2]
    none = Answers(np.zeros(0), np.zeros((0, 2)))
    assert recall([answers, none], 0.7) == 0.5
    assert recall([], 0.7) == 0.0


def test_average_recall_by_hand() -> None:
    """An error of 0.22 is below the last six of the ten thresholds 0.05, 0.1, ... 0.5."""
    one = Answers(np.ones(1), np.array([[0.22]]))
    assert average_recall([one], SHARES) == pytest.approx(0.6)
    assert average_recall([one, Answers(np.ones(1), np.array([[np.inf]]))], SHARES) == pytest.approx(0.3)
    assert (len(SHARES), len(VSD_TAUS)) == (10, 10) and PIXELS.tolist() == list(range(5, 51, 5))


def test_area_under_the_curve_of_add_by_hand() -> None:
    assert add_auc(np.array([0.0, 0.05, 0.1, np.inf])) == pytest.approx(1.5 / 4)
    assert np.isnan(add_auc(np.zeros(0)))


# Results ------------------------------------------------------------------------------------------


def test_results_are_written_as_the_benchmark_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "ours_demo-test.csv"
    write_bop_results(path, [PoseResult(1, 3, 2, 0.5, TRUE), PoseResult(1, 4, 2, 1.0, np.eye(4), 0.2)])
    lines = path.read_text().splitlines()
    assert lines[0] == "scene_id,im_id,obj_id,score,R,t,time"
    identity = "1.0 0.0 0.0 0.0 1.0 0.0 0.0 0.0 1.0"
    assert lines[2] == f"1,4,2,1,{identity},0.0 0.0 0.0,0.2"
    back = read_bop_results(path)
    np.testing.assert_allclose(back[0].camera_from_object, TRUE, atol=1e-15)
    assert (back[0].scene, back[0].image, back[0].object, back[0].score, back[0].seconds) == (
        1,
        3,
        2,
        0.5,
        -1,
    )
    path.write_text(lines[0] + "\n1,4,2,1,1 0 0,0 0 0,0.2\n")
    with pytest.raises(DataError, match="line 2"):
        read_bop_results(path)


# Keypoints ----------------------------------------------------------------------------------------


def test_similarity_by_hand() -> None:
    """Off by 2 * 0.05 * sqrt(area) = 10 px: exp(-1/2); what is not labelled does not count."""
    true = np.zeros((3, 2))
    seen = np.array([[10.0, 0.0], [0.0, 0.0], [500.0, 0.0]])
    both = oks(seen, true, np.array([2, 1, 0]), area_px=100.0**2)
    assert both == pytest.approx((np.exp(-0.5) + 1) / 2)
    assert np.isnan(oks(seen, true, np.zeros(3, np.int64), area_px=1.0))


def test_precision_is_pycocotools() -> None:
    """Images with up to three instances and up to four detections, some of them far off."""
    rng = np.random.default_rng(3)
    truth, results, ours = [], [], []
    for image in range(1, 13):
        places = rng.uniform(50, 400, (rng.integers(0, 4), 1, 2)) + rng.normal(0, 30, (1, 5, 2))
        visibility = rng.integers(0, 3, (len(places), 5))
        visibility[:, 0] = 2
        areas = rng.uniform(3000, 9000, len(places))
        spread = 10 ** rng.uniform(-0.5, 1.5, (4, 1, 1))
        seen = np.concatenate([places, places, rng.uniform(0, 400, (1, 5, 2))])[:4]
        seen = seen + spread[: len(seen)] * rng.normal(size=seen.shape)
        scores = rng.random(len(seen))
        for place, v, area in zip(places, visibility, areas, strict=True):
            flat = np.column_stack([place * (v > 0)[:, None], v]).ravel().tolist()
            truth.append(
                {"id": len(truth) + 1, "image_id": image, "category_id": 1, "keypoints": flat, "iscrowd": 0}
                | {"area": area, "num_keypoints": int((v > 0).sum()), "bbox": [0, 0, 400, 400]}
            )
        for place, score in zip(seen, scores, strict=True):
            flat = np.column_stack([place, np.ones(5)]).ravel().tolist()
            results.append({"image_id": image, "category_id": 1, "keypoints": flat, "score": float(score)})
        table = [
            [oks(s, p, v, area_px=a) for p, v, a in zip(places, visibility, areas, strict=True)] for s in seen
        ]
        ours.append(SeenInImage(scores, np.array(table).reshape(len(seen), len(places))))
    judge = _judge(truth, results)
    assert average_precision(ours) == pytest.approx(judge[0], abs=1e-9) and 0.1 < judge[0] < 0.9
    assert average_precision(ours, np.array([0.5])) == pytest.approx(judge[1], abs=1e-9)
    assert np.isnan(average_precision([SeenInImage(np.ones(1), np.zeros((1, 0)))]))


def _judge(truth: list[dict[str, object]], results: list[dict[str, object]]) -> list[float]:
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        coco.dataset = {
            "images": [{"id": image} for image in range(1, 13)],
            "categories": [{"id": 1, "name": "thing"}],
            "annotations": truth,
        }
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(results), "keypoints")
        evaluation.params.kpt_oks_sigmas = np.full(5, 0.05)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return [float(value) for value in evaluation.stats]
