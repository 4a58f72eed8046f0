"""Hand-held camera paths: a smooth partial orbit, with the sway and tremor of a hand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from rpl_data.geometry import rigid

SWAY_HZ = (0.2, 1.2)
TREMOR_HZ = (4.0, 9.0)
"""Physiological hand tremor lies at 4 to 12 Hz (McAuley & Marsden, Brain 123, 2000)."""


def hand_held(
    rng: np.random.Generator,
    *,
    times_s: Float64[np.ndarray, " n"],
    target_m: Float64[np.ndarray, "3"],
    sweep_deg: float,
    distance_m: tuple[float, float],
    elevation_deg: tuple[float, float],
    span_s: tuple[float, float],
    sway_m: float = 0.012,
    tremor_m: float = 0.0005,
    aim_m: float = 0.02,
    roll_deg: float = 5.0,
) -> Float64[np.ndarray, "n 4 4"]:
    """Make `table_from_camera` poses along a partial orbit around a point on the table (z is up).

    The speed along the orbit varies; distance and elevation vary between their bounds; the camera looks at
    the target up to an error of `aim_m`.

    Args:
        sweep_deg: azimuth between the start and the end of `span_s`.
        span_s: start and end of the orbit; `times_s` may reach a little beyond.
        sway_m, tremor_m: standard deviation of slow and of fast movements of the hand, per axis.
    """
    progress = (times_s - span_s[0]) / max(span_s[1] - span_s[0], 1e-6)
    uneven = progress + 0.35 / (2 * np.pi) * np.sin(2 * np.pi * progress + rng.uniform(0, 2 * np.pi))
    direction = rng.choice([-1.0, 1.0])
    azimuth = rng.uniform(0, 2 * np.pi) + direction * np.deg2rad(sweep_deg) * (uneven - uneven[0])
    elevation = np.deg2rad(_between(rng, elevation_deg, progress))
    distance = _between(rng, distance_m, progress)
    around = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1
    )
    hand = sway_m * _wobble(rng, times_s, SWAY_HZ, 3) + tremor_m * _wobble(rng, times_s, TREMOR_HZ, 3)
    position = target_m + distance[:, None] * around + hand
    aim = target_m + aim_m * _wobble(rng, times_s, SWAY_HZ, 3)
    roll = np.deg2rad(roll_deg) * _wobble(rng, times_s, SWAY_HZ, 1)[:, 0]
    return np.stack([look_at(*row) for row in zip(position, aim, roll, strict=True)])


def look_at(
    position_m: Float64[np.ndarray, "3"], target_m: Float64[np.ndarray, "3"], roll_rad: float
) -> Float64[np.ndarray, "4 4"]:
    """`table_from_camera` of a camera that looks at a point, upright up to the roll."""
    forward = target_m - position_m
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    return rigid(np.stack([cos * right + sin * down, cos * down - sin * right, forward], axis=1), position_m)


def _wobble(
    rng: np.random.Generator, times_s: Float64[np.ndarray, " n"], band_hz: tuple[float, float], axes: int
) -> Float64[np.ndarray, "n axes"]:
    """Unit-variance noise with frequencies in a band: a sum of waves of random frequency and phase."""
    waves = 12
    frequency = rng.uniform(*band_hz, (waves, axes))
    phase = rng.uniform(0, 2 * np.pi, (waves, axes))
    total = np.sin(2 * np.pi * frequency * times_s[:, None, None] + phase).sum(axis=1)
    wobble: Float64[np.ndarray, "n axes"] = total * np.sqrt(2 / waves)
    return wobble


def _between(
    rng: np.random.Generator, bounds: tuple[float, float], progress: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """A slow wave between two bounds."""
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * rng.uniform(0.4, 0.9) * progress + rng.uniform(0, 2 * np.pi))
    return bounds[0] + (bounds[1] - bounds[0]) * wave
