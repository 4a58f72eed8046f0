"""Eq. 2 by Gower's alternation in compiled code; importing this module imports numba.

Where there are ten scenes and a dozen keypoints, NumPy would spend its time on the calls, not on the numbers.
Rotations are the unit quaternions of Horn (JOSA A 4, 1987); the largest eigenvalue by Newton's iteration from
above, as Theobald has it (Acta Crystallographica A61, 2005).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rpl_data.compiled import compiled

LEAST_SLOPE = 1e-5
"""Slope of the characteristic polynomial at the largest eigenvalue, as a share of the eigenvalue's cube. On
points near a line, that is four times the share by which the next eigenvalue is smaller. With less, rounding
decides on the rotation."""


@compiled
def _cofactor(matrix: Any, i: int, j: int) -> Any:
    """Cofactor of a 4x4 matrix; the other rows and columns in cyclic order, which keeps the sign."""
    a, b, c = (i + 1) % 4, (i + 2) % 4, (i + 3) % 4
    x, y, z = (j + 1) % 4, (j + 2) % 4, (j + 3) % 4
    minor = (
        matrix[a, x] * (matrix[b, y] * matrix[c, z] - matrix[b, z] * matrix[c, y])
        - matrix[a, y] * (matrix[b, x] * matrix[c, z] - matrix[b, z] * matrix[c, x])
        + matrix[a, z] * (matrix[b, x] * matrix[c, y] - matrix[b, y] * matrix[c, x])
    )
    return minor if (i + j) % 2 == 0 else -minor


@compiled
def _fit(model: Any, scene: Any, weights: Any, pose: Any) -> bool:
    """The rigid motion that takes weighted points of the model to those of a scene, into `pose`.

    Returns:
        Whether the points determine it: False where they lie on a line, or nearly.
    """
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
    largest = min(bound, np.sqrt(3 * squares))  # neither is less; the first is far off where the fit is poor
    for _ in range(50):
        value = ((largest * largest + c2) * largest + c1) * largest + c0
        slope = (4 * largest * largest + 2 * c2) * largest + c1
        if not slope > LEAST_SLOPE * largest**3:  # it only falls on the way to the root; or it is no number
            return False
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
    return True


@compiled
def alternate(scenes: Any, clicked: Any, weights: Any, poses: Any, points: Any, most: int) -> bool:
    """Gower's alternation to convergence, from the poses; see `procrustes`.

    Args:
        scenes, clicked: as in `Fragments`.
        weights: what each fragment counts.
        poses: `scene_from_model` to start from; the answer is written into them.
        points: the answer's keypoints are written into it.
        most: turns after which it ends without having converged.

    Returns:
        False where the points of some scene do not determine its pose, or are no numbers; the answer is of no
        use then.
    """
    count, keypoints = clicked.shape
    previous, total = np.inf, np.zeros(keypoints)
    for s in range(count):
        for k in range(keypoints):
            total[k] += weights[s, k]
    for turn in range(most + 1):
        if turn:
            for s in range(count):
                if not _fit(points, scenes[s], weights[s], poses[s]):
                    return False
        for k in range(keypoints):
            for i in range(3):
                mean = 0.0
                for s in range(count):
                    for j in range(3):
                        mean += weights[s, k] * poses[s, j, i] * (scenes[s, k, j] - poses[s, j, 3])
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
                    cost += weights[s, k] * (here * here if clicked[s, k] > 0 else 0.0)
        if previous - cost <= 1e-9 * cost + 1e-18:
            return True
        previous = cost
    return True
