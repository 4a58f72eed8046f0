"""Eq. 2 by least squares in compiled code; importing this module imports numba.

The same start (`initial_guess.join_clean`) and the same alternation (`procrustes.adjust_points`) as without
it: where there are ten scenes and a dozen keypoints, NumPy spends its time on the calls, not on the numbers.
Rotations are the unit quaternions of Horn (JOSA A 4, 1987); the largest eigenvalue by Newton's iteration from
above, as Theobald has it (Acta Crystallographica A61, 2005).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from rpl_data.compiled import compiled
from rpl_data.solve.initial_guess import LINE_M
from rpl_data.solve.procrustes import MOST_ALTERNATIONS, Adjusted, Fragments


def adjusted_by_least_squares(fragments: Fragments) -> Adjusted | None:
    """The minimum of Eq. 2, reached from scenes joined one by one; None where these cannot be joined so."""
    scenes, keypoints = fragments.clicked.shape
    poses: Float64[np.ndarray, "s 4 4"] = np.zeros((scenes, 4, 4))
    points: Float64[np.ndarray, "k 3"] = np.zeros((keypoints, 3))
    if not _join(fragments.points_scene, fragments.clicked, poses, points):
        return None
    _alternate(fragments.points_scene, fragments.clicked, poses, points)
    return Adjusted(poses, points, fragments.clicked)


@compiled
def _cofactor(matrix: Any, i: int, j: int) -> Any:
    """Of a 4x4 matrix; the other rows and columns in cyclic order, which keeps the sign."""
    a, b, c = (i + 1) % 4, (i + 2) % 4, (i + 3) % 4
    x, y, z = (j + 1) % 4, (j + 2) % 4, (j + 3) % 4
    minor = (
        matrix[a, x] * (matrix[b, y] * matrix[c, z] - matrix[b, z] * matrix[c, y])
        - matrix[a, y] * (matrix[b, x] * matrix[c, z] - matrix[b, z] * matrix[c, x])
        + matrix[a, z] * (matrix[b, x] * matrix[c, y] - matrix[b, y] * matrix[c, x])
    )
    return minor if (i + j) % 2 == 0 else -minor


@compiled
def _fit(model: Any, scene: Any, weights: Any, pose: Any) -> None:
    """The rigid motion that takes weighted points of the model to those of a scene, into `pose`."""
    total, of_model, of_scene, s = 1e-300, np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for k in range(len(weights)):
        total += weights[k]
        for i in range(3):
            of_model[i] += weights[k] * model[k, i]
            of_scene[i] += weights[k] * scene[k, i]
    for i in range(3):
        of_model[i] /= total
        of_scene[i] /= total
    bound, squares = 0.0, 0.0
    for k in range(len(weights)):
        for i in range(3):
            left = model[k, i] - of_model[i]
            bound += weights[k] * (left * left + (scene[k, i] - of_scene[i]) ** 2) / 2
            for j in range(3):
                s[i, j] += weights[k] * left * (scene[k, j] - of_scene[j])
    for i in range(3):
        for j in range(3):
            squares += s[i, j] * s[i, j]
    n = np.empty((4, 4))
    n[0, 0] = s[0, 0] + s[1, 1] + s[2, 2]
    n[0, 1] = n[1, 0] = s[1, 2] - s[2, 1]
    n[0, 2] = n[2, 0] = s[2, 0] - s[0, 2]
    n[0, 3] = n[3, 0] = s[0, 1] - s[1, 0]
    n[1, 1] = s[0, 0] - s[1, 1] - s[2, 2]
    n[2, 2] = s[1, 1] - s[0, 0] - s[2, 2]
    n[3, 3] = s[2, 2] - s[0, 0] - s[1, 1]
    n[1, 2] = n[2, 1] = s[0, 1] + s[1, 0]
    n[1, 3] = n[3, 1] = s[2, 0] + s[0, 2]
    n[2, 3] = n[3, 2] = s[1, 2] + s[2, 1]
    # The characteristic polynomial x^4 + c2 x^2 + c1 x + c0 falls towards its largest root from above.
    c2, c1, c0 = -2 * squares, 0.0, 0.0
    for j in range(4):
        c0 += n[0, j] * _cofactor(n, 0, j)
        c1 -= _cofactor(n, j, j)
    largest = bound
    for _ in range(50):
        value = ((largest * largest + c2) * largest + c1) * largest + c0
        slope = (4 * largest * largest + 2 * c2) * largest + c1
        if slope <= 0:
            break
        step = value / slope
        largest -= step
        if abs(step) <= 1e-15 * largest:
            break
    for j in range(4):
        n[j, j] -= largest
    column, most = 0, 0.0  # every column of the adjugate is the eigenvector; the longest is the most exact
    for j in range(4):
        if abs(_cofactor(n, j, j)) > most:
            column, most = j, abs(_cofactor(n, j, j))
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    if most > 0:
        w, x = _cofactor(n, 0, column), _cofactor(n, 1, column)
        y, z = _cofactor(n, 2, column), _cofactor(n, 3, column)
        length = np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / length, x / length, y / length, z / length
    pose[0, 0], pose[0, 1], pose[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    pose[1, 0], pose[1, 1], pose[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    pose[2, 0], pose[2, 1], pose[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for i in range(3):
        turned = pose[i, 0] * of_model[0] + pose[i, 1] * of_model[1] + pose[i, 2] * of_model[2]
        pose[i, 3] = of_scene[i] - turned
        pose[3, i] = 0.0
    pose[3, 3] = 1.0


@compiled
def _on_a_line(points: Any, chosen: Any, count: float) -> bool:
    """Whether the second of the principal deviations of the chosen points is too small."""
    m, mean = np.zeros((3, 3)), np.zeros(3)
    for k in range(len(chosen)):
        for i in range(3):
            mean[i] += chosen[k] * points[k, i] / count
    for k in range(len(chosen)):
        for i in range(3):
            for j in range(3):
                m[i, j] += chosen[k] * (points[k, i] - mean[i]) * (points[k, j] - mean[j])
    for i in range(3):
        m[i, i] -= LINE_M**2 * count
    # Two eigenvalues below 0, so below the limit before: as many as the principal minors change their sign.
    one, two = m[0, 0], m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    three = (
        m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        - m[1, 2] * (m[0, 0] * m[2, 1] - m[0, 1] * m[2, 0])
        + m[2, 2] * two
    )
    return bool((one < 0) + ((one < 0) != (two < 0)) + ((two < 0) != (three < 0)) >= 2)


@compiled
def _join(scenes: Any, clicked: Any, poses: Any, points: Any) -> bool:
    """Poses and keypoints to start from; False where a scene shares no three keypoints off a line."""
    count, keypoints = clicked.shape
    known, both, waiting = np.zeros(keypoints), np.zeros(keypoints), np.ones(count)
    for number in range(count):
        chosen, most = 0, -1.0
        for s in range(count):  # the one that shares most; first the one that shares most with all others
            shared = 0.0
            for k in range(keypoints):
                if clicked[s, k] > 0:
                    if number:
                        shared += known[k]
                    else:
                        for other in range(count):
                            shared += clicked[other, k] > 0
            if waiting[s] and shared > most:
                chosen, most = s, shared
        waiting[chosen] = 0
        pose = poses[chosen]
        for k in range(keypoints):
            both[k] = known[k] if clicked[chosen, k] > 0 else 0.0
        if number == 0:
            for i in range(4):
                pose[i, i] = 1.0
        elif most < 3 or _on_a_line(scenes[chosen], both, most):
            return False
        else:
            _fit(points, scenes[chosen], both, pose)
        for k in range(keypoints):
            if clicked[chosen, k] > 0 and not known[k]:
                known[k] = 1
                for i in range(3):
                    points[k, i] = 0.0
                    for j in range(3):
                        points[k, i] += pose[j, i] * (scenes[chosen, k, j] - pose[j, 3])
    return True


@compiled
def _alternate(scenes: Any, clicked: Any, poses: Any, points: Any) -> None:
    """Gower's alternation to convergence, from the poses."""
    count, keypoints = clicked.shape
    previous, total = np.inf, np.zeros(keypoints)
    for s in range(count):
        for k in range(keypoints):
            total[k] += clicked[s, k]
    for turn in range(MOST_ALTERNATIONS + 1):
        if turn:
            for s in range(count):
                _fit(points, scenes[s], clicked[s], poses[s])
        for k in range(keypoints):
            for i in range(3):
                mean = 0.0
                for s in range(count):
                    for j in range(3):
                        mean += clicked[s, k] * poses[s, j, i] * (scenes[s, k, j] - poses[s, j, 3])
                points[k, i] = mean / max(total[k], 1e-300)
        if not turn:
            continue
        cost = 0.0
        for s in range(count):
            for k in range(keypoints):
                for i in range(3):
                    here = poses[s, i, 3] - scenes[s, k, i]
                    for j in range(3):
                        here += poses[s, i, j] * points[k, j]
                    cost += clicked[s, k] * (here * here if clicked[s, k] > 0 else 0.0)
        if previous - cost <= 1e-9 * cost + 1e-18:
            return
        previous = cost
