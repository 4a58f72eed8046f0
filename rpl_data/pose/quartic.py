"""Solve quartics, in compiled code; importing this module imports numba."""

from __future__ import annotations

from rpl_data.compiled import compiled


@compiled
def quartic_roots(
    constant: float, linear: float, quadratic: float, cubic: float, quartic: float
) -> tuple[float, float, float, float]:
    """Real parts of the four roots; NaN or infinite where the highest coefficient is 0.

    Ferrari's solution (Abramowitz and Stegun, 3.8.3), with a root of its resolvent by Cardano's formula.
    """
    b, c, d, e = cubic / quartic, quadratic / quartic, linear / quartic, constant / quartic
    p = c - 0.375 * b * b
    q = d + b * (0.125 * b * b - 0.5 * c)
    r = e + b * (b * (c / 16 - 3 / 256 * b * b) - 0.25 * d)
    m = _cubic_root(p, 0.25 * p * p - r, -0.125 * q * q)
    s = (2 * m) ** 0.5
    rest, tilt = -2 * p - 2 * m, 0j
    if s != 0:  # else the four roots are one
        tilt = 2 * q / s
    half_s, plus, minus = 0.5 * s.real, 0.5 * ((rest - tilt) ** 0.5).real, 0.5 * ((rest + tilt) ** 0.5).real
    shift = 0.25 * b
    return half_s + plus - shift, half_s - plus - shift, minus - half_s - shift, -minus - half_s - shift


@compiled
def _cubic_root(b: float, c: float, d: float) -> complex:
    """Root of ``x^3 + b x^2 + c x + d`` of largest modulus, which is 0 only if all roots are."""
    first, second = b * b - 3 * c, b * (b * b - 4.5 * c) + 13.5 * d
    inner = complex(second * second - first**3) ** 0.5
    larger = second - inner if second < 0 else second + inner
    u: complex = larger ** (1 / 3)
    if u == 0:  # the three roots are one; dividing a complex number by 0 is an error in compiled code, too
        return complex(-b / 3)
    largest = 0j
    for _ in range(3):
        root = -(b + u + first / u) / 3
        if not abs(root) <= abs(largest):
            largest = root
        u *= complex(-0.5, 3**0.5 / 2)
    return largest
