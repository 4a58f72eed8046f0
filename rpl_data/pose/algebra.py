"""Cross products, small rotations and quartics for many small arrays, without the overhead of general code.

`numpy.cross` and `scipy.spatial.transform` spend ten times as long on checking a dozen vectors as on the
arithmetic, while a pose takes a millisecond; numpy cannot solve many polynomials at once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex128, Float64

Numbers = Float64[np.ndarray, " m"]

CUBE_ROOTS_OF_ONE = np.exp(2j * np.pi * np.arange(3) / 3)


def cross(
    a: Float64[np.ndarray, "*batch_a 3"], b: Float64[np.ndarray, "*batch_b 3"]
) -> Float64[np.ndarray, "*batch 3"]:
    """Cross product ``a x b``; leading axes broadcast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x = ay * bz - az * by
    product = np.empty((*x.shape, 3))
    product[..., 0] = x
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def small_rotations(rotvecs_rad: Float64[np.ndarray, "m 3"]) -> Float64[np.ndarray, "m 3 3"]:
    """Rotations that equal those of the rotation vectors to second order; exact rotations for any length.

    Cayley's map: the unit quaternion along (1, rotvec / 2).
    """
    norm = np.sqrt(1 + 0.25 * (rotvecs_rad**2).sum(axis=1))
    w = 1 / norm
    x, y, z = rotvecs_rad.T * (0.5 * w)
    matrices = np.empty((len(rotvecs_rad), 3, 3))
    matrices[:, 0, 0] = 1 - 2 * (y * y + z * z)
    matrices[:, 1, 1] = 1 - 2 * (x * x + z * z)
    matrices[:, 2, 2] = 1 - 2 * (x * x + y * y)
    matrices[:, 0, 1], matrices[:, 1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    matrices[:, 0, 2], matrices[:, 2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    matrices[:, 1, 2], matrices[:, 2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return matrices


def quartic_roots(
    constant: Numbers, linear: Numbers, quadratic: Numbers, cubic: Numbers, quartic: Numbers
) -> Float64[np.ndarray, "m 4"]:
    """Real parts of the four roots of each quartic; NaN or infinite where the highest coefficient is 0.

    Ferrari's solution (Abramowitz and Stegun, 3.8.3), with a root of its resolvent by Cardano's formula.
    """
    b, c, d, e = cubic / quartic, quadratic / quartic, linear / quartic, constant / quartic
    p = c - 0.375 * b * b
    q = d + b * (0.125 * b * b - 0.5 * c)
    r = e + b * (b * (c / 16 - 3 / 256 * b * b) - 0.25 * d)
    m = _cubic_root(p, 0.25 * p * p - r, -0.125 * q * q)
    s = np.sqrt(2 * m)
    rest, tilt = -2 * p - 2 * m, 2 * q / s
    plus, minus = np.sqrt(rest - tilt), np.sqrt(rest + tilt)
    roots = np.stack([s + plus, s - plus, minus - s, -minus - s], axis=1).real
    shifted: Float64[np.ndarray, "m 4"] = 0.5 * roots - 0.25 * b[:, None]
    return shifted


def _cubic_root(b: Numbers, c: Numbers, d: Numbers) -> Complex128[np.ndarray, " m"]:
    """Root of ``x^3 + b x^2 + c x + d`` of largest modulus, which is 0 only if all roots are."""
    first, second = b * b - 3 * c, b * (b * b - 4.5 * c) + 13.5 * d
    inner = np.sqrt((second * second - first**3).astype(complex))
    larger = second + np.where(second < 0, -inner, inner)
    u = larger ** (1 / 3)
    turned = u * CUBE_ROOTS_OF_ONE[:, None]
    roots = -(b + turned + first / turned) / 3
    row = np.abs(roots).argmax(axis=0)[None]
    largest: Complex128[np.ndarray, " m"] = np.take_along_axis(roots, row, axis=0)[0]
    return largest
