"""The report says where networks and labels are apart, and marks what their images do not explain."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec
from rpl_data.report.networks import networks_section
from rpl_data.types import KeypointModel, NetworkView, Solution

POINTS = np.array([[0.1, 0, 0], [-0.1, 0, 0], [0, 0.05, 0]])
LABELS = Solution(KeypointModel("cup", ("a", "b", "c"), POINTS), np.zeros((3, 3, 3)), {"00": np.eye(4)})


def row(view: NetworkView) -> str:
    return networks_section({"cup": {"00": view}}, {"cup": LABELS}).split("<tbody>")[1]


@pytest.mark.parametrize(
    ("apart_m", "images", "marked"), [(0.015, 20, False), (0.017, 20, True), (0.03, 7, False)]
)
def test_labels_beyond_what_the_images_scatter_are_marked(apart_m: float, images: int, marked: bool) -> None:
    pose = from_rotvec(np.zeros(3), np.array([0, 0, apart_m]))
    off_m = (0.008,) * (images - 2) + (0.04,) * 2  # two that are far off do not hide what strays
    view = NetworkView(24, 22, tuple(range(images)), off_m, pose, POINTS, "cup.ckpt")
    assert ('class="over"' in row(view)) == marked
    assert f">{1e3 * apart_m:.0f}<" in row(view)


def test_what_cannot_be_compared_is_said() -> None:
    assert "no agreement" in row(NetworkView(24, 2, (), (), None, POINTS, "cup.ckpt"))
    fewer = NetworkView(24, 20, (1, 2, 3), (0.01,) * 3, np.eye(4), POINTS[:2], "cup.ckpt")
    assert "other keypoints" in row(fewer)  # one was added to the recipe since
    assert networks_section({"cup": {}}, {"cup": LABELS}) == ""
