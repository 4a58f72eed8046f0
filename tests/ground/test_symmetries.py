"""Symmetries as transforms: hand-worked turns, other frames, and bop_toolkit's rule for steps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rpl_data.geometry import from_rotvec, transform
from rpl_data.symmetries import (
    moved_symmetries,
    symmetries_from_json,
    symmetries_to_json,
    symmetry_transforms,
    turn,
)
from rpl_data.types import Symmetries, SymmetryAxis

UPRIGHT = SymmetryAxis((0.0, 0.0, 1.0), (0.1, 0.0, 0.0))
HALF_TURN = tuple(np.diag([-1.0, 1.0, -1.0, 1.0]).ravel().tolist())
BOTH = Symmetries((HALF_TURN,), (UPRIGHT,))


def test_no_symmetry_is_the_identity_alone():
    np.testing.assert_array_equal(symmetry_transforms(Symmetries()), np.eye(4)[None])


def test_a_quarter_turn_about_an_axis_beside_the_origin():
    moved = transform(turn(UPRIGHT, math.pi / 2), np.array([[0.2, 0.0, 0.5]]))
    np.testing.assert_allclose(moved, [[0.1, 0.1, 0.5]], atol=1e-15)


def test_steps_are_those_of_bop_toolkit():
    """ceil(pi / 0.01) = 315 steps, each combined with each discrete symmetry."""
    found = symmetry_transforms(BOTH)
    assert len(found) == 2 * 315
    np.testing.assert_array_equal(found[0], np.eye(4))
    radius = 1 / 2  # of an object as wide as its diameter
    assert radius * 2 * math.pi / 315 <= 0.01
    np.testing.assert_allclose(found[1], turn(UPRIGHT, 2 * math.pi / 315), atol=1e-15)
    np.testing.assert_allclose(found[316], turn(UPRIGHT, 2 * math.pi / 315) @ np.diag([-1, 1, -1, 1]))


def test_a_moved_frame_moves_the_transforms():
    other = from_rotvec(np.array([0.3, -0.2, 0.9]), np.array([0.01, 0.2, -0.1]))
    for one, same in zip(
        symmetry_transforms(BOTH, max_deviation=1.0),
        symmetry_transforms(moved_symmetries(BOTH, other), max_deviation=1.0),
        strict=True,
    ):
        np.testing.assert_allclose(other @ one, same @ other, atol=1e-12)


def test_json_keeps_them_and_millimetres_scale_translations_only():
    assert symmetries_from_json(symmetries_to_json(BOTH)) == BOTH
    assert symmetries_to_json(Symmetries()) == {}
    lifted = np.eye(4)
    lifted[2, 3] = 0.25
    in_mm = symmetries_to_json(Symmetries((tuple(lifted.ravel().tolist()),), (UPRIGHT,)), unit_m=0.001)
    assert in_mm["symmetries_discrete"][0][11] == 250 and in_mm["symmetries_discrete"][0][0] == 1
    assert in_mm["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [100, 0, 0]}]


def test_an_axis_without_a_direction_is_refused():
    with pytest.raises(ValueError, match="0, 0, 0"):
        symmetries_from_json({"symmetries_continuous": [{"axis": [0, 0, 0], "offset": [0, 0, 0]}]})
