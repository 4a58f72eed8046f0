"""sparse_model.txt and saved_meta_data.npz of RapidPoseLabels."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from rpl_data.formats.models.meta_data import clicked_points, read_meta_data, write_meta_data
from rpl_data.formats.models.sparse_model import (
    points_in_first_scene,
    read_sparse_model,
    write_sparse_model,
)
from rpl_data.geometry import from_rotvec, transform
from rpl_data.types import Click, ClickResidual, DataError, KeypointModel, Observation, Solution

POINTS = np.array([[0.1, -0.2, 0.3], [1e-05, -3.0, -2.5e-17], [0.0, 4.0, -1e10]])


def solution() -> Solution:
    scenes = {
        "01": from_rotvec(np.array([0.3, -2.9, 0.1]), np.array([0.1, 0.2, 0.9])),
        "00": from_rotvec(np.array([0.1, 0.2, 0.3]), np.array([-0.1, 0.0, 0.7])),
    }
    model = KeypointModel("cube", ("a", "b", "c"), np.array([[0, 0, 0.1], [0.2, 0, 0], [np.nan] * 3]))
    return Solution(model, np.zeros((3, 3, 3)), scenes)


def test_exponents_and_signs_survive(tmp_path: Path) -> None:
    write_sparse_model(tmp_path / "sparse_model.txt", POINTS)
    np.testing.assert_array_equal(read_sparse_model(tmp_path / "sparse_model.txt"), POINTS)
    text = (tmp_path / "sparse_model.txt").read_text()
    assert '\t<point x="1e-05" y="-3.0" z="-2.5e-17" name="1"/>\n' in text


def test_keypoints_without_a_position_keep_their_number(tmp_path: Path) -> None:
    points = np.array([[np.nan] * 3, [1.0, 2.0, 3.0]])
    write_sparse_model(tmp_path / "m.txt", points)
    np.testing.assert_array_equal(read_sparse_model(tmp_path / "m.txt"), points)


def test_what_other_tools_write(tmp_path: Path) -> None:
    """Integers, any order of attributes and points, an earlier model, a grasp point."""
    old = '<SparseObjectPoints>\n\t<point x="9" y="9" z="9" name="7"/>\n</SparseObjectPoints>\n'
    new = (
        '<SparseObjectPoints>\n\t<point name="1" z="-3" y="2E-3" x="+1"/>\n'
        '\t<point x="4" y="5" z="6" name="0" />\n'
        "</SparseObjectPoints>\n<GraspPoint>\n\t[1.0, 0.0, 0.0, 0.5]\n\t[0.0, 1.0, 0.0, 0.5]\n</GraspPoint>\n"
    )
    (tmp_path / "m.txt").write_text(old + new)
    np.testing.assert_array_equal(read_sparse_model(tmp_path / "m.txt"), [[4, 5, 6], [1, 2e-3, -3]])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ("", "has no point"),
        ('<point x="1" y="2" name="0"/>', "needs numbers x, y, z"),
        ('<point x="1" y="2" z="q" name="0"/>', "needs numbers x, y, z"),
        ('<point x="1" y="2" z="nan" name="0"/>', "is not finite"),
        ('<point x="1" y="2" z="3" name="0"/><point x="1" y="2" z="3" name="0"/>', "used twice"),
    ],
)
def test_broken_models_are_refused(tmp_path: Path, points: str, message: str) -> None:
    (tmp_path / "m.txt").write_text(f"<SparseObjectPoints>{points}</SparseObjectPoints>")
    with pytest.raises(DataError, match=message):
        read_sparse_model(tmp_path / "m.txt")
    (tmp_path / "n.txt").write_text("nothing")
    with pytest.raises(DataError, match="no <SparseObjectPoints> block"):
        read_sparse_model(tmp_path / "n.txt")


def test_the_papers_frame_is_the_first_scenes() -> None:
    s = solution()
    in_first = points_in_first_scene(s)
    np.testing.assert_allclose(in_first, transform(s.scene_from_object["00"], s.model.points_object))


def test_meta_data_round_trip(tmp_path: Path) -> None:
    s = solution()
    clicked = {name: transform(matrix, s.model.points_object) for name, matrix in s.scene_from_object.items()}
    clicked["01"][0] = np.nan
    write_meta_data(tmp_path / "saved_meta_data.npz", s, clicked)
    meta = read_meta_data(tmp_path / "saved_meta_data.npz")
    np.testing.assert_allclose(meta.points_world, points_in_first_scene(s))
    np.testing.assert_allclose(meta.scene_from_world[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(meta.clicked_scene, np.array([clicked["00"], clicked["01"]]))
    # T_s takes the model into scene s
    np.testing.assert_allclose(
        transform(meta.scene_from_world[1], meta.points_world)[1], clicked["01"][1], atol=1e-12
    )


def test_meta_data_of_the_original_by_hand(tmp_path: Path) -> None:
    """Two scenes, two keypoints, three clicks; scene 1 turned by 90 degrees about z: w x y z."""
    h = np.sqrt(0.5)
    scenes = np.array([0, 0, 0, 1, 2, 3, 1, 0, 0, 0, h, 0, 0, h], dtype=float)
    ref = np.arange(12, dtype=float).reshape(2, 3, 2)
    sm = np.zeros((9, 12))
    sm[0:3, 0:3] = sm[3:6, 3:6] = sm[6:9, 9:12] = np.eye(3)  # (0, 0), (0, 1), (1, 1)
    today, before = tmp_path / "today.npz", tmp_path / "before.npz"
    np.savez(today, model=np.ones((2, 3)), scenes=scenes, ref=ref, sm=sm)
    meta = read_meta_data(today)
    np.testing.assert_allclose(
        meta.scene_from_world[1], [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-12
    )
    np.testing.assert_array_equal(meta.clicked_scene[0], [[0, 2, 4], [1, 3, 5]])
    np.testing.assert_array_equal(meta.clicked_scene[1], [[np.nan] * 3, [7, 9, 11]])
    np.savez(before, model=np.ones((2, 3)), scenes=scenes[[3, 4, 5, 10, 11, 12, 13]], ref=ref, sm=sm)
    np.testing.assert_array_equal(read_meta_data(before).scene_from_world, meta.scene_from_world)
    oldest, points = tmp_path / "oldest.npz", np.array([[1.0, 2, 3], [4, 5, 6]])
    np.savez(oldest, res=np.concatenate([scenes[[3, 4, 5, 10, 11, 12, 13]], points.ravel()]), ref=ref, sm=sm)
    found = read_meta_data(oldest)
    np.testing.assert_array_equal(found.points_world, points)
    np.testing.assert_array_equal(found.scene_from_world, meta.scene_from_world)
    np.testing.assert_array_equal(found.clicked_scene, meta.clicked_scene)


def arrays(scenes: int, ref: tuple[int, ...], sm: tuple[int, ...]) -> dict[str, np.ndarray]:
    return {"model": np.ones((2, 3)), "scenes": np.zeros(scenes), "ref": np.ones(ref), "sm": np.ones(sm)}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"res": np.zeros(5)}, r"lacks model, scenes, ref, sm \(it has res\)"),
        (arrays(14, (2, 2, 3), (3, 12)), "do not fit"),
        (arrays(14, (2, 3, 2), (3, 9)), r"sm has shape \(3, 9\)"),
        (arrays(13, (2, 3, 2), (3, 12)), "scenes has 13 numbers; expected 14"),
    ],
)
def test_broken_meta_data_is_refused(tmp_path: Path, content: dict[str, np.ndarray], message: str) -> None:
    np.savez(tmp_path / "m.npz", **content)
    with pytest.raises(DataError, match=message):
        read_meta_data(tmp_path / "m.npz")
    (tmp_path / "text.npz").write_text("text")
    with pytest.raises(DataError, match="not an npz archive"):
        read_meta_data(tmp_path / "text.npz")


def test_clicked_points_by_hand() -> None:
    """Two clicks average, an outlier and a click without depth count for nothing."""
    clicks = [Click("cube", k, "00", f, 0.0, 0.0) for k, f in ((0, 0), (0, 1), (1, 0), (2, 0))]
    moved = from_rotvec(np.zeros(3), np.array([1.0, 0, 0]))
    observations = [
        Observation(c, np.array([0, 0, 1.0]), moved, np.array([0.5]), np.array([0.002]), 0.002)
        for c in clicks
    ]
    residuals = (
        ClickResidual(clicks[0], 0.0, 0.0, 0.5, "agrees"),
        ClickResidual(clicks[1], 0.0, 0.0, 0.7, "agrees"),
        ClickResidual(clicks[2], 0.0, 0.0, 0.7, "agrees", outlier=True),
        ClickResidual(clicks[3], 0.0, None, None, "none"),
    )
    s = solution()
    points = clicked_points(observations, Solution(s.model, s.covariance, s.scene_from_object, residuals))
    np.testing.assert_allclose(points["00"], [[1, 0, 0.6], [np.nan] * 3, [np.nan] * 3])


def test_a_long_file_of_beginnings_is_read_in_no_time(tmp_path: Path) -> None:
    for text in (
        "<SparseObjectPoints>" * 50_000,
        "<SparseObjectPoints>" + "<point " * 100_000 + "</SparseObjectPoints>",
    ):
        (tmp_path / "m.txt").write_text(text)
        started = time.process_time()
        with pytest.raises(DataError):
            read_sparse_model(tmp_path / "m.txt")
        assert time.process_time() - started < 2


def test_a_keypoint_with_an_enormous_number_is_refused(tmp_path: Path) -> None:
    point = '<point x="0" y="0" z="0" name="999999999"/>'
    (tmp_path / "m.txt").write_text(f"<SparseObjectPoints>{point}</SparseObjectPoints>")
    with pytest.raises(DataError, match="from 0 to 9999"):
        read_sparse_model(tmp_path / "m.txt")
