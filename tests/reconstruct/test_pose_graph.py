"""Pose graph: exact where edges are, and not led astray by one that is wrong."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rpl_data.geometry import from_rotvec, invert
from rpl_data.motions import adjoint
from rpl_data.reconstruct.information import motion_between, moved
from rpl_data.reconstruct.pose_graph import Edge, optimise

LOOSE = np.eye(6) * 1e-3
TIGHT = np.diag([1e6] * 3 + [1e6] * 3)


def loop(count: int = 8) -> dict[int, np.ndarray]:
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return {
        k: from_rotvec(np.array([0.0, a, 0.0]), np.array([np.sin(a), 0.1 * a, 1 - np.cos(a)]))
        for k, a in enumerate(turns)
    }


def edges_of(poses: dict[int, np.ndarray]) -> list[Edge]:
    count = len(poses)
    return [
        Edge(k, (k + gap) % count, invert(poses[k]) @ poses[(k + gap) % count], TIGHT)
        for gap in (1, 2)
        for k in range(count)
    ]


def disturbed(poses: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
    rng = np.random.default_rng(0)
    return {k: pose @ moved(rng.normal(0, 0.02, 6)) for k, pose in poses.items()}


def worst_between(found: dict[int, np.ndarray], truth: dict[int, np.ndarray]) -> float:
    """Largest error of the motion from the first frame to another."""
    return max(
        np.abs(motion_between(invert(found[0]) @ found[k], invert(truth[0]) @ truth[k])).max() for k in truth
    )


def test_exact_edges_are_met_exactly() -> None:
    truth = loop()
    found = optimise(disturbed(truth), edges_of(truth), prior=LOOSE)
    assert worst_between(disturbed(truth), truth) > 0.02
    assert worst_between(found, truth) < 1e-6


def test_a_wrong_edge_is_outvoted() -> None:
    truth = loop()
    wrong = Edge(0, 4, invert(truth[0]) @ truth[4] @ moved(np.full(6, 0.05)), TIGHT)
    found = optimise(disturbed(truth), [*edges_of(truth), wrong], prior=LOOSE)
    assert worst_between(found, truth) < 1e-3


def test_without_edges_the_poses_stay() -> None:
    given = disturbed(loop())
    found = optimise(given, [], prior=LOOSE)
    for k, pose in given.items():
        np.testing.assert_allclose(found[k], pose, atol=1e-12)


def test_the_adjoint_moves_a_motion_to_other_axes() -> None:
    rng = np.random.default_rng(1)
    b_from_a = np.eye(4)
    b_from_a[:3, :3], b_from_a[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    motion = rng.normal(0, 1e-5, 6)
    direct = b_from_a @ moved(motion) @ invert(b_from_a)
    np.testing.assert_allclose(moved(adjoint(b_from_a) @ motion), direct, atol=1e-9)
