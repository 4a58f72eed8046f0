"""Lighting of a twin: a lamp, a window, light reflected by the room, and reflections on glossy things.

Everything works on rows of points, in linear light, in the table frame (z up).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

Rows = Float32[np.ndarray, "n 3"]
Row = Float32[np.ndarray, " n"]

GAMMA = 2.2
TO_LINEAR = (np.arange(256, dtype=np.float32) / 255) ** np.float32(GAMMA)
BRIGHTEST = 4.0
"""Light beyond this is white in the image."""
KNEE = 0.6
"""The camera's response is linear up to here (before gamma); brighter highlights are compressed."""
FRESNEL = 0.04
"""Share of light that plastic, varnish or glass reflects at normal incidence (index 1.5)."""


@dataclass(frozen=True)
class Light:
    """A lamp above the table, a window, and the light that the room reflects.

    Attributes:
        position_m, radius_m: centre and radius of the lamp, a ball.
        strength: light of the lamp on the table below it.
        ambient: light of the ceiling.
        color: colour of the lamp.
        window: unit direction to the centre of the window.
        daylight: light of the window on a surface that faces it.
        below: colour of the light that the table reflects.
    """

    position_m: Float64[np.ndarray, "3"]
    radius_m: float
    strength: float
    ambient: float
    color: Float64[np.ndarray, "3"]
    window: Float64[np.ndarray, "3"]
    daylight: float
    below: Float64[np.ndarray, "3"]


def shaded(
    light: Light,
    *,
    albedo: Rows,
    gloss: Row,
    points: Rows,
    normals: Rows,
    view: Rows,
    lamp_seen: Row,
    room_seen: Row,
) -> Rows:
    """Compute the linear light that reaches the camera from each point.

    Args:
        view: unit vectors to the camera.
        lamp_seen: share of the lamp that is not hidden.
        room_seen: share of the room that nearby things do not hide.
    """
    to_lamp = light.position_m.astype(np.float32) - points
    squared = np.einsum("nk,nk->n", to_lamp, to_lamp)
    to_lamp *= (1 / np.sqrt(squared))[:, None]
    reference = np.float32(light.strength * (light.position_m @ light.position_m))
    lamp = lamp_seen * reference / squared
    facing = np.einsum("nk,nk->n", normals, to_lamp)
    color = light.color.astype(np.float32)
    received = _room(light, normals) * room_seen[:, None] + (lamp * facing.clip(0))[:, None] * color
    linear = albedo * received
    shiny = np.flatnonzero(gloss > 0.02)
    if len(shiny):
        mirrored = _mirrored(
            light, normals[shiny], view[shiny], to_lamp[shiny], gloss[shiny], lamp[shiny], room_seen[shiny]
        )
        linear[shiny] += mirrored
    result: Rows = linear
    return result


def _room(light: Light, normals: Rows) -> Rows:
    """Light from ceiling, table and window on surfaces with these normals."""
    up = 0.5 + 0.5 * normals[:, 2:]
    ceiling = np.float32(light.ambient) * np.array([0.97, 1.0, 1.02], np.float32)
    below = np.float32(0.8 * light.ambient) * light.below.astype(np.float32)
    window = (0.5 + 0.5 * normals @ light.window.astype(np.float32)) ** 2
    day = np.float32(light.daylight) * np.array([0.9, 1.0, 1.12], np.float32)
    room: Rows = below + up * (ceiling - below) + window[:, None] * day
    return room


def _mirrored(
    light: Light, normals: Rows, view: Rows, to_lamp: Rows, gloss: Row, lamp: Row, room_seen: Row
) -> Rows:
    """Reflection of the lamp (Blinn, SIGGRAPH 1977) and of the room (Schlick's Fresnel term, 1994)."""
    cos = np.einsum("nk,nk->n", normals, view).clip(0)
    fresnel = FRESNEL + (1 - FRESNEL) * (1 - cos) ** 5
    half = to_lamp + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    power = 12 * 16**gloss
    shine = np.einsum("nk,nk->n", normals, half).clip(1e-6) ** power * (power + 8) / 50
    turned = 2 * cos[:, None] * normals - view
    room = _surroundings(light, turned) * (gloss * fresnel * room_seen)[:, None]
    mirrored: Rows = room + (gloss * shine * lamp)[:, None] * light.color.astype(np.float32)
    return mirrored.astype(np.float32)


def _surroundings(light: Light, directions: Rows) -> Rows:
    """Light that a mirror would show: a bright window with crossbars, the ceiling, the table below."""
    w = light.window.astype(np.float32)
    side = np.cross(w, [0.0, 0.0, 1.0]).astype(np.float32)
    side /= np.linalg.norm(side)
    ahead = directions @ w
    x = np.abs(directions @ side) / np.maximum(ahead, 1e-3)
    y = np.abs(directions @ np.cross(side, w).astype(np.float32)) / np.maximum(ahead, 1e-3)
    pane = _step(0.34, x) * _step(0.46, y) * (1 - _step(0.025, x)) * (1 - _step(0.025, y)) * (ahead > 0)
    up = (0.5 + 2.5 * directions[:, 2:]).clip(0, 1)
    below = np.float32(light.ambient) * light.below.astype(np.float32)
    room: Rows = below + up * (np.float32(2.2 * light.ambient) - below)
    room += (np.float32(9 * light.daylight) * pane)[:, None]
    return room


def _step(edge: float, value: Row) -> Row:
    """A smooth step: 1 well below the edge, 0 well above."""
    step: Row = ((np.float32(edge + 0.03) - value) / np.float32(0.06)).clip(0, 1)
    return step


def _response() -> np.ndarray:
    """Grey levels of linear light 0 .. BRIGHTEST in 4096 steps: highlights are compressed, then gamma."""
    light = np.linspace(0, BRIGHTEST, 4096)
    rolled = np.where(light < KNEE, light, KNEE + (1 - KNEE) * (1 - np.exp(-(light - KNEE) / (1 - KNEE))))
    return np.round(255 * rolled ** (1 / GAMMA)).astype(np.uint8)


RESPONSE = _response()


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Convert linear light to grey levels, any shape."""
    grey: np.ndarray = RESPONSE[(linear * np.float32(4095 / BRIGHTEST)).clip(0, 4095).astype(np.int32)]
    return grey
