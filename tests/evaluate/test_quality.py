"""Errors against hand-worked numbers, and the laws a comparison must keep."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pycocotools import mask as coco_mask

from rpl_data.evaluate.quality import (
    compare_workspaces,
    format_table,
    label_errors,
    mask_iou,
    model_error,
    summarise,
)
from rpl_data.geometry import fit_rigid, from_rotvec, invert, transform
from rpl_data.types import DataError, FrameLabel, InstanceLabel, KeypointModel, Rle, Solution, SquareBox
from rpl_data.workspace.workspace import Workspace

POINTS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype=float)
NAMES = ("a", "b", "c", "d")
MOVED = from_rotvec(np.array([0.3, -0.2, 0.9]), np.array([0.4, -0.1, 0.7]))


def rectangle(left: int, top: int, right: int, bottom: int) -> Rle:
    mask = np.zeros((40, 60), dtype=np.uint8, order="F")
    mask[top:bottom, left:right] = 1
    rle = coco_mask.encode(mask)
    return Rle(size=[40, 60], counts=rle["counts"].decode())


def instance(
    pixels: np.ndarray,
    mask: Rle,
    *,
    name: str = "cube",
    pose: np.ndarray | None = None,
    visibility: tuple[int, ...] = (2, 2, 1, 0),
) -> InstanceLabel:
    return InstanceLabel(
        object=name,
        camera_from_object=np.eye(4) if pose is None else pose,
        keypoints_px=pixels,
        visibility=np.array(visibility),
        sigma_px=np.ones(4),
        square_box=SquareBox(10.0, 10.0, 20.0),
        box=(0.0, 0.0, 10.0, 10.0),
        box_full=(0.0, 0.0, 10.0, 10.0),
        mask=mask,
        mask_full=mask,
        visib_fract=1.0,
        truncated=False,
        quality=1.0,
    )


def test_model_error_is_free_of_the_frame() -> None:
    error = model_error(
        KeypointModel("cube", NAMES, transform(MOVED, POINTS)), KeypointModel("cube", NAMES, POINTS)
    )
    np.testing.assert_allclose(error.keypoints_m, 0, atol=1e-12)
    np.testing.assert_allclose(error.truth_from_object, invert(MOVED), atol=1e-12)


def test_model_error_leaves_out_unknown_keypoints() -> None:
    points = transform(MOVED, POINTS)
    points[3] = np.nan
    error = model_error(KeypointModel("cube", NAMES, points), KeypointModel("cube", NAMES, POINTS))
    assert np.isnan(error.keypoints_m[3])
    np.testing.assert_allclose(error.keypoints_m[:3], 0, atol=1e-12)


def test_a_mirrored_model_is_not_forgiven() -> None:
    error = model_error(
        KeypointModel("cube", NAMES, POINTS * [1, 1, -1]), KeypointModel("cube", NAMES, POINTS)
    )
    assert error.keypoints_m.max() > 0.01


def test_different_keypoint_counts_are_refused() -> None:
    with pytest.raises(DataError, match="4 keypoints and its truth 3"):
        model_error(KeypointModel("cube", NAMES, POINTS), KeypointModel("cube", NAMES[:3], POINTS[:3]))


def test_pixels_are_averaged_a_frame_then_over_frames() -> None:
    true = np.array([[10, 10], [20, 10], [10, 20], [20, 20]], dtype=float)
    off = true + np.array([[3, 4], [0, 1], [0, 0], [99, 99]])  # 5, 1, 0; the last is not labelled
    one = true + np.array([[7, 0], [0, 0], [0, 0], [0, 0]])  # 7, only the first labelled
    mask = rectangle(0, 0, 10, 10)
    truth = [FrameLabel("s", i, 0.0, (instance(true, mask),)) for i in range(3)]
    labels = [
        FrameLabel("s", 0, 0.0, (instance(off, mask),)),
        FrameLabel("s", 1, 0.0, (instance(one, mask, visibility=(1, 0, 0, 0)),)),
    ]
    errors = label_errors(labels, truth)["cube"]
    np.testing.assert_allclose([e.mean_px for e in errors.instances], [2, 7])
    model = KeypointModel("cube", NAMES, POINTS)
    row = summarise("cube", model, model_error(model, model), errors)
    assert row.error_2d_mean_px == pytest.approx(4.5)
    assert row.error_2d_median_px == pytest.approx(4.5)
    assert (row.frames, row.truth_frames, row.missed) == (2, 3, 0)


def test_iou_of_half_overlapping_rectangles() -> None:
    assert mask_iou(rectangle(0, 0, 10, 10), rectangle(5, 0, 15, 10)) == pytest.approx(50 / 150)
    assert mask_iou(rectangle(0, 0, 0, 0), rectangle(0, 0, 0, 0)) == 0


def test_missed_invented_and_unjudged_frames_are_counted_apart() -> None:
    pixels, mask = np.ones((4, 2)), rectangle(0, 0, 5, 5)
    cube, cup = instance(pixels, mask), instance(pixels, mask, name="cup")
    truth = [FrameLabel("s", 0, 0.0, (cube,)), FrameLabel("s", 1, 0.0, (cube,)), FrameLabel("s", 2, 0.0)]
    labels = [
        FrameLabel("s", 0, 0.0, (cube, cup)),
        FrameLabel("s", 1, 0.0),
        FrameLabel("s", 2, 0.0, (cube,)),
        FrameLabel("s", 3, 0.0, (cube,)),  # no truth: not judged
    ]
    errors = label_errors(labels, truth)
    assert (len(errors["cube"].instances), errors["cube"].missed, errors["cube"].invented) == (1, 1, 1)
    assert (len(errors["cup"].instances), errors["cup"].missed, errors["cup"].invented) == (0, 0, 1)


def test_pose_error_is_measured_after_the_alignment() -> None:
    """The object frame is free; only what is left after aligning the models counts."""
    camera_from_truth = from_rotvec(np.array([0.1, 0.4, 0.0]), np.array([0.0, 0.1, 0.8]))
    slip = from_rotvec(np.array([0.0, 0.0, 0.02]), np.array([0.003, 0.0, 0.0]))
    pixels, mask = np.ones((4, 2)), rectangle(0, 0, 5, 5)
    label = FrameLabel("s", 0, 0.0, (instance(pixels, mask, pose=camera_from_truth @ MOVED @ slip),))
    truth = FrameLabel("s", 0, 0.0, (instance(pixels, mask, pose=camera_from_truth),))
    error = label_errors([label], [truth], {"cube": MOVED})["cube"].instances[0]
    assert error.position_m == pytest.approx(0.003)
    assert error.rotation_rad == pytest.approx(0.02)
    without = label_errors([label], [truth])["cube"].instances[0]
    assert np.isnan(without.position_m)


def test_workspaces_are_compared_by_object(tmp_path: Path) -> None:
    pixels, mask = np.arange(8, dtype=float).reshape(4, 2), rectangle(0, 0, 10, 10)
    ours, truth = Workspace(tmp_path / "ours"), Workspace(tmp_path / "truth")
    for workspace, points, shift in ((ours, transform(MOVED, POINTS), 2.0), (truth, POINTS, 0.0)):
        model = KeypointModel("cube", NAMES, points)
        workspace.save_solution(Solution(model, np.zeros((4, 3, 3)), {"s": np.eye(4)}))
        workspace.save_labels("s", [FrameLabel("s", 0, 0.0, (instance(pixels + [shift, 0], mask),))])
    (row,) = compare_workspaces(ours, truth)
    assert row.error_3d_mean_mm == pytest.approx(0, abs=1e-9)
    assert row.error_2d_mean_px == pytest.approx(2)
    assert row.iou_full_mean == pytest.approx(1)
    assert (row.frames, row.truth_frames) == (1, 1)


def test_workspaces_without_a_common_object_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no truth for any object"):
        compare_workspaces(Workspace(tmp_path / "ours"), Workspace(tmp_path / "truth"))


def test_the_table_has_a_line_an_object_and_a_dash_for_the_unmeasured() -> None:
    model = KeypointModel("cube", NAMES, POINTS)
    row = summarise("cube", model, model_error(model, model), None)
    table = format_table([row, dataclasses.replace(row, object="a longer name", error_2d_mean_px=6.557)])
    lines = table.splitlines()
    assert len(lines) == 3 and len({len(line) for line in lines}) == 1
    assert "-" in lines[1].split() and "6.56" in lines[2]


def test_the_fit_agrees_with_the_error_it_reports() -> None:
    """Noise moves the fit; the distances are to the fitted model, not to the true one."""
    noisy = POINTS + np.random.default_rng(0).normal(0, 1e-3, POINTS.shape)
    error = model_error(KeypointModel("cube", NAMES, noisy), KeypointModel("cube", NAMES, POINTS))
    moved = transform(fit_rigid(POINTS, noisy), noisy)
    np.testing.assert_allclose(error.keypoints_m, np.linalg.norm(moved - POINTS, axis=1))


def test_a_truth_in_another_order_is_matched_by_name(tmp_path: Path) -> None:
    """The same names in another order: nothing is off, in space or in the image."""
    pixels = np.array([[1.0, 2.0], [30.0, 4.0], [5.0, 25.0], [40.0, 30.0]])
    order = [2, 0, 3, 1]
    workspaces = [Workspace(tmp_path / name) for name in ("labels", "truth")]
    for workspace, rows in zip(workspaces, ([0, 1, 2, 3], order), strict=True):
        names = tuple(NAMES[row] for row in rows)
        model = KeypointModel("cube", names, POINTS[rows])
        workspace.save_solution(Solution(model, np.zeros((4, 3, 3)), {}))
        one = instance(pixels[rows], rectangle(0, 0, 20, 10), visibility=(2, 2, 2, 2))
        workspace.save_labels("00", iter([FrameLabel("00", 0, 0.0, (one,))]))
    (row,) = compare_workspaces(*workspaces)
    assert (row.error_3d_max_mm, row.error_2d_mean_px) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_truth_of_other_names_is_refused_and_one_of_numbers_goes_by_row() -> None:
    model = KeypointModel("cube", NAMES, POINTS)
    with pytest.raises(DataError, match=r"matched by name, and d of a, b, c, d is not among a, b, c, x"):
        model_error(model, KeypointModel("cube", ("a", "b", "c", "x"), POINTS))
    assert model_error(model, KeypointModel("cube", tuple("0123"), POINTS)).keypoints_m.max() < 1e-9


def test_instances_are_compared_with_the_nearest_truth_whatever_they_are_called() -> None:
    here, there, mask = np.zeros((4, 2)), np.full((4, 2), 20.0), rectangle(0, 0, 10, 10)
    one, two = instance(here, mask), replace(instance(there, mask), instance="2")
    truth = FrameLabel("s", 0, 0.0, (replace(two, instance=""), replace(one, instance="left")))
    found = label_errors([FrameLabel("s", 0, 0.0, (one, two))], [truth])["cube"]
    assert [error.mean_px for error in found.instances] == [0.0, 0.0]
    assert (found.truth_frames, found.missed, found.invented) == (2, 0, 0)
    found = label_errors([FrameLabel("s", 0, 0.0, (two,))], [truth])["cube"]
    assert [error.mean_px for error in found.instances] == [0.0] and (found.missed, found.invented) == (1, 0)
    found = label_errors([FrameLabel("s", 0, 0.0, (one, two, one))], [truth])["cube"]
    assert (len(found.instances), found.missed, found.invented) == (2, 0, 1)
