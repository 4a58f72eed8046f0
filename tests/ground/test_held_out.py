"""Blocks that are left out, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from rpl_data.held_out import are_black, block_means, blocks_of, in_standard_errors


def test_neighbours_on_the_chessboard_differ_on_both_sides_of_the_origin() -> None:
    points = np.array([[0.01, 0.01, 0.01], [-0.01, 0.01, 0.01], [0.01, 0.04, 0.01], [-0.01, -0.01, 0.01]])
    blocks = blocks_of(points, edge_m=0.03)
    np.testing.assert_array_equal(blocks, [[0, 0, 0], [-1, 0, 0], [0, 1, 0], [-1, -1, 0]])
    np.testing.assert_array_equal(are_black(blocks), [True, False, False, True])


def test_each_block_counts_once() -> None:
    blocks = np.array([[0, 0, 0], [0, 0, 0], [5, 0, 0]])
    np.testing.assert_allclose(block_means(blocks, np.array([1.0, 3.0, 7.0])), [2.0, 7.0])
    assert block_means(np.zeros((0, 4), np.int64), np.zeros(0)).shape == (0,)


def test_evidence_in_standard_errors_by_hand() -> None:
    assert in_standard_errors(np.array([1.0, 2.0, 3.0])) == pytest.approx(2 * np.sqrt(3))
    assert in_standard_errors(np.array([5.0, 5.0])) == 0
