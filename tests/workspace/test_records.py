"""Records as JSON and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.geometry import from_rotvec
from rpl_data.types import (
    Click,
    ClickResidual,
    DepthCamera,
    DepthCoding,
    Frame,
    FrameLabel,
    InstanceLabel,
    Intrinsics,
    KeypointModel,
    NextClick,
    Recording,
    Scene,
    Solution,
    SquareBox,
    Statement,
)
from rpl_data.workspace import records
from rpl_data.workspace.recording_records import recording_from_json, recording_to_json


def through_json(data: dict[str, Any]) -> dict[str, Any]:
    """What JSON makes of it; NaN is refused as it is when written."""
    content: dict[str, Any] = json.loads(json.dumps(data, allow_nan=False))
    return content


def test_recording_round_trip() -> None:
    scene = Scene(
        "00",
        Intrinsics(600.5, 601.0, 320.25, 240.0, 640, 480, (0.1, -0.2, 0.0, 0.0)),
        0.00025,
        (
            Frame(2, 10.1, Path("/a/rgb/2.jpg"), Path("/a/depth/2.png")),
            Frame(3, 10.2, Path("/a/3.jpg"), None),
        ),
        registered=False,
        no_depth_units=(65535,),
        source="rpl: /a",
        depth_coding=DepthCoding(bits_turned=True, along_ray=True),
        depth_camera=DepthCamera(
            Intrinsics(200.0, 200.0, 79.5, 59.5, 160, 120), tuple(map(float, range(16)))
        ),
    )
    recording = Recording(scene, None, ("1 frame left out: 0",), ("assumed",))
    assert recording_from_json(through_json(recording_to_json(recording))) == recording


def test_solution_round_trip() -> None:
    model = KeypointModel("cube", ("a", "b"), np.array([[0.1, -1e-9, 0.3], [np.nan] * 3]), ((0, 1),))
    covariance = np.array([np.diag([1e-6, 2e-6, 3e-6]), np.full((3, 3), np.nan)])
    transforms = {"00": np.eye(4), "01": from_rotvec(np.array([0.1, 2, 3]), np.array([0.0, 1, 2]))}
    click = Click("cube", 0, "00", 3, 1.5, 2.5)
    residuals = (
        ClickResidual(click, 1.25, 0.002, 0.7, "agrees"),
        ClickResidual(click, 9.0, None, None, "none", outlier=True, reason="far off"),
    )
    in_scene = {"01": 2 * covariance}
    solution = Solution(
        model,
        covariance,
        transforms,
        residuals,
        ("keypoint b was never clicked",),
        in_scene,
        1.5,
        1.25,
        (Statement("wrong place", (click,), "scene 00, frame 3: keypoint a ...", 21.5),),
        (NextClick("01", 4, 1, 0.75, 3.25),),
        {"01": 0.002},
        one_side=(1,),
    )
    back = records.solution_from_json(through_json(records.solution_to_json(solution)))
    np.testing.assert_array_equal(back.model.points_object, model.points_object)
    np.testing.assert_array_equal(back.covariance, covariance)
    assert (back.model.keypoints, back.model.skeleton) == (model.keypoints, model.skeleton)
    assert (back.residuals, back.warnings) == (residuals, solution.warnings)
    assert (back.click_sigma_px, back.depth_sigma_ratio) == (1.5, 1.25)
    assert (back.statements, back.next_clicks) == (solution.statements, solution.next_clicks)
    assert (back.trajectory_sigma_m, back.one_side) == ({"01": 0.002}, (1,))
    np.testing.assert_array_equal(back.covariance_in_scene["01"], in_scene["01"])
    assert list(back.scene_from_object) == ["00", "01"]
    for name, matrix in transforms.items():
        np.testing.assert_array_equal(back.scene_from_object[name], matrix)


def test_solutions_of_older_versions_are_read() -> None:
    model = KeypointModel("cube", ("a",), np.array([[0.1, 0.2, 0.3]]))
    written = records.solution_to_json(Solution(model, np.eye(3)[None], {"00": np.eye(4)}))
    for new in (
        "covariance_in_scene",
        "click_sigma_px",
        "depth_sigma_ratio",
        "statements",
        "next_clicks",
        "one_side",
    ):
        del written[new]
    back = records.solution_from_json(through_json(written))
    assert (back.covariance_in_scene, back.click_sigma_px, back.depth_sigma_ratio) == ({}, None, None)
    np.testing.assert_array_equal(back.covariance_at("00"), np.eye(3)[None])


def test_frame_label_round_trip() -> None:
    instance = InstanceLabel(
        object="cube",
        camera_from_object=from_rotvec(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.1, 0.7])),
        keypoints_px=np.array([[10.123, -4.5], [np.nan, np.nan]]),
        visibility=np.array([2, 0]),
        sigma_px=np.array([0.25, np.nan]),
        square_box=SquareBox(10.0, 20.0, 30.5),
        box=None,
        box_full=(1.0, 2.0, 3.0, 4.5),
        mask={"size": [480, 640], "counts": "Sl16j>000mfX9"},
        mask_full={"size": [480, 640], "counts": "PP\\9"},
        visib_fract=0.0,
        truncated=True,
        quality=0.5,
        corrected_px=1.25,
    )
    data = through_json(records.frame_label_to_json(FrameLabel("00", 3, 10.5, (instance,))))
    assert data["instances"][0]["keypoints_px"] == [[10.123, -4.5], None]
    back = records.frame_label_from_json(data)
    assert (back.scene, back.frame, back.timestamp_s) == ("00", 3, 10.5)
    (got,) = back.instances
    np.testing.assert_allclose(got.camera_from_object, instance.camera_from_object, atol=1e-9)
    for name in ("keypoints_px", "visibility", "sigma_px"):
        np.testing.assert_array_equal(getattr(got, name), getattr(instance, name))
    for name in ("square_box", "box", "box_full", "mask", "mask_full", "visib_fract", "truncated", "quality"):
        assert getattr(got, name) == getattr(instance, name)
    assert got.corrected_px == 1.25
    del data["instances"][0]["corrected_px"]  # as older versions wrote it
    assert records.frame_label_from_json(data).instances[0].corrected_px is None


def test_a_row_with_one_nan_is_null() -> None:
    rows = np.array([[1.0, 2.0], [np.nan, 3.0]])
    assert records.rows_to_json(rows) == [[1.0, 2.0], None]
    assert np.isnan(records.rows_from_json([[1.0, 2.0], None], 2)[1]).all()
    assert records.rows_from_json([], 3).shape == (0, 3)
