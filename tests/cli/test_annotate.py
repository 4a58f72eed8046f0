"""What the annotation page is told by the stages."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpl_data.cli.annotate import _expected_px
from rpl_data.geometry import rigid
from rpl_data.types import Frame, Intrinsics, KeypointModel, Recording, Scene, Solution, Trajectory
from rpl_data.workspace.workspace import Workspace


def test_the_expected_error_in_the_image_does_not_depend_on_how_the_object_is_turned(tmp_path: Path) -> None:
    """1 m away, known to 2 mm across the line of sight (1.2 px of 600) and to 20 mm along it (0 px)."""
    workspace, camera = Workspace(tmp_path), Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480)
    scene = Scene("00", camera, 0.001, (Frame(0, 0.0, tmp_path / "0.png", None),))
    workspace.save_recording(Recording(scene, Trajectory(np.array([0]), np.eye(4)[None])))
    turned = rigid(Rotation.from_euler("y", 90, degrees=True).as_matrix(), np.array([0, 0, 1.0]))
    solution = Solution(
        KeypointModel("it", ("a",), np.zeros((1, 3))),
        np.zeros((1, 3, 3)),
        {"00": turned},
        covariance_in_scene={"00": np.diag([4e-6, 4e-6, 4e-4])[None]},
    )
    assert _expected_px(workspace, solution, "00") == pytest.approx(1.2 * np.sqrt(2))
