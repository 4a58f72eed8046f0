"""Whose estimate is whose where an image shows an object twice, and which pose it is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from rpl_data.geometry import project, transform
from rpl_data.pose.errors import INFINITE
from rpl_data.pose.estimate import PoseEstimate
from rpl_data.types import DataError, InstanceLabel, Intrinsics, KeypointModel, Rle, SquareBox
from training.evaluate_pose import figures_of, line_of, refuse_nothing_judged, say_figures
from training.pose.evaluation import TrueObject, _judged, _seen_of
from training.pose.pictures import named
from training.pose.pipeline import PosePipeline, SeenKeypoints, check_detected
from training.pose.scores import Judged, load_judged, save_judged
from training.predict import counts_of

IMAGE = np.zeros((4, 4, 3), dtype=np.uint8)
RLE = Rle(size=[4, 4], counts="0")
LEFT = InstanceLabel(
    "cup", np.eye(4), np.array([[10.0, 10.0]]), np.array([2]), np.array([1.0]), SquareBox(10.0, 10.0, 8.0),
    (6.0, 6.0, 14.0, 14.0), (6.0, 6.0, 14.0, 14.0), RLE, RLE, 1.0, False, 1.0,
)  # fmt: skip
RIGHT = replace(LEFT, keypoints_px=np.array([[50.0, 10.0]]), square_box=SquareBox(50.0, 10.0, 8.0))


@dataclass
class AtTheMiddle:
    """Sees the keypoint in the middle of a crop, as a network does that is right; its detector finds one."""

    detected: np.ndarray

    def see(
        self, image: np.ndarray, squares_px: Mapping[str, np.ndarray] | None = None
    ) -> list[SeenKeypoints]:
        squares = {"cup": self.detected} if squares_px is None else squares_px
        return [seen_at(name, np.asarray(square)) for name, square in squares.items()]


def seen_at(name: str, square: np.ndarray) -> SeenKeypoints:
    return SeenKeypoints(name, square, 1.0, square[None, :2], np.ones(1), np.eye(2)[None])


def seen(crops: Any) -> list[SeenKeypoints | None]:
    pipeline = cast(PosePipeline, AtTheMiddle(np.array([49.0, 11.0, 8.0])))
    return _seen_of(pipeline, IMAGE, [LEFT, RIGHT], crops)


def test_each_instance_is_seen_in_its_own_crop() -> None:
    left, right = seen("given")
    assert left is not None and right is not None
    assert (left.positions_px == LEFT.keypoints_px).all() and (right.positions_px == RIGHT.keypoints_px).all()


def test_the_one_detection_counts_for_the_nearest_instance() -> None:
    left, right = seen("detected")
    assert left is None and right is not None


def test_a_pose_that_looks_the_same_is_right_where_symmetries_are_known() -> None:
    """A plate seen from ahead, turned by half a turn about its normal, which leaves it looking the same."""
    points = np.array([[-0.1, -0.05, 0.0], [0.1, -0.05, 0.0], [0.1, 0.05, 0.02], [-0.1, 0.05, 0.02]])
    camera = Intrinsics(500.0, 500.0, 320.0, 240.0, 640, 480)
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose = np.eye(4)
    pose[2, 3] = 0.8
    model = KeypointModel("plate", ("a", "b", "c", "d"), points)
    label = replace(
        LEFT, object="plate", camera_from_object=pose, keypoints_px=project(camera, transform(pose, points)),
        visibility=np.array([2, 2, 1, 0]), sigma_px=np.ones(4), square_box=SquareBox(320.0, 240.0, 190.0),
    )  # fmt: skip
    turned = pose @ half
    positions = project(camera, transform(turned, points))
    saw = SeenKeypoints("plate", np.zeros(3), 1.0, positions, np.ones(4), np.tile(np.eye(2), (4, 1, 1)))
    found = PoseEstimate(turned, np.arange(4), np.eye(6), 1.0)
    truth = TrueObject(1, model, np.stack([np.eye(4), half]), points, np.zeros(3))
    plain = replace(truth, symmetries=np.eye(4)[None])
    right, wrong = (
        _judged(
            saw, found, label, image="0.png", method="epnp", truth=each, intrinsics=camera,
            truth_from_trained=np.eye(4),
        )
        for each in (truth, plain)
    )  # fmt: skip
    assert right.errors.orientation_rad < 1e-6 and right.errors.add_m < 1e-9
    assert len(right.keypoint_errors) == 3 and right.keypoint_errors.max() < 1e-9
    assert wrong.errors.orientation_rad > 3 and wrong.keypoint_errors.min() > 0.5


def test_a_detector_of_other_objects_is_refused() -> None:
    detector = cast(Any, SimpleNamespace(names=["background", "cup"]))
    check_detected(PosePipeline({"cup": cast(Any, None)}, detector), "d.ckpt")
    with pytest.raises(DataError, match="d.ckpt: the detector does not know egg, .* it knows cup"):
        check_detected(PosePipeline(dict.fromkeys(("cup", "egg"), cast(Any, None)), detector), "d.ckpt")


def test_what_has_no_pose_is_told_why(capsys: pytest.CaptureFixture[str]) -> None:
    none = Judged("cup", "0.png", "epnp", "not detected", INFINITE, np.array([np.inf]), None, None)
    judged = [none, replace(none, found="too few keypoints"), none]
    say_figures(figures_of(judged, {"cup": np.random.default_rng(0).normal(size=(9, 3))}, ["epnp"]), judged)
    assert "no pose: not detected (2), too few keypoints (1)" in capsys.readouterr().out
    seen = {"camera_from_object": np.eye(4), "failure": None}
    missed = {"camera_from_object": None, "failure": "too few keypoints"}
    said = counts_of([{"objects": [seen, missed]}, {"objects": []}])
    assert said == "2 images, 2 objects, 1 with a pose; no pose: too few keypoints (1)"


def test_an_overlay_names_each_object() -> None:
    picture = np.zeros((60, 200, 3), dtype=np.uint8)
    words = named(picture.copy(), seen_at("cup", np.array([100.0, 50.0, 40.0])), "too few keypoints")
    assert words[:30].any() and not words[35:].any()


def test_half_a_turn_that_earlier_versions_wrote_for_no_pose_is_infinite(tmp_path: Path) -> None:
    half = replace(INFINITE, orientation_rad=np.pi)
    failed = Judged("cup", "0.png", "epnp", "not detected", half, np.array([np.inf]), None, None)
    save_judged(tmp_path / "judged.json", [failed])
    (again,) = load_judged(tmp_path / "judged.json")
    assert again.errors == INFINITE


def test_scores_of_nothing_are_refused_and_an_object_without_instances_has_none(tmp_path):
    coco_json, names = tmp_path / "test.json", ("cup", "drill")
    with pytest.raises(DataError, match="test.json: no image with cup, drill shows a tenth of it or more"):
        refuse_nothing_judged([], names, coco_json, {})
    with pytest.raises(DataError, match=r"can be read .cannot read 1.jpg., so there is nothing"):
        refuse_nothing_judged([], names, coco_json, {"cannot read 1.jpg": 2})
    assert line_of({"instances": 0, "position_mm": float("nan")}) == "   0 instances: nothing to score"
