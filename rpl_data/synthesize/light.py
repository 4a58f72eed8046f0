"""Light: what makes one surface differ in brightness from scene to scene, by the direction that it faces.

Brightness, as images store it, is colour x E(normal), where E is a sum of spherical harmonics up to degree 2
for each channel. Nine numbers describe how a convex, dull object is lit (Ramamoorthi and Hanrahan, "An
efficient representation for irradiance environment maps", SIGGRAPH 2001); shadows and gloss are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from rpl_data.synthesize.turning import shortest_turn, turn_about

TERMS = 9
DARKEST, BRIGHTEST = 0.25, 2.0
"""Limits of E, where the sum is carried beyond the normals that it was fitted to."""
GAIN = 0.1
"""Largest share by which all of an image's objects are brighter or darker than the light says."""
TINT = 0.03
"""The same for each colour channel alone."""

Coefficients = Float64[np.ndarray, "9 3"]


@dataclass(frozen=True)
class SceneLight:
    """The light of a scene.

    Attributes:
        up: unit vector against gravity, or out of the table, scene frame.
        coefficients: for normals in the scene frame.
    """

    up: Float64[np.ndarray, "3"]
    coefficients: Coefficients


@dataclass(frozen=True)
class Light:
    """The light of an image.

    Attributes:
        light_from_camera: takes normals to the frame of the coefficients.
    """

    light_from_camera: Float64[np.ndarray, "3 3"]
    coefficients: Coefficients


def harmonics(normals: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 9"]:
    """The real spherical harmonics up to degree 2 at unit vectors, each scaled to at most about 1."""
    x, y, z = normals.astype(np.float32).T
    return np.column_stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, x * x - y * y, 1.5 * z * z - 0.5])


def shade(normals_camera: Float32[np.ndarray, "n 3"], light: Light) -> Float32[np.ndarray, "n 3"]:
    """E for each channel: the factors on the colours of surfaces with these normals."""
    turned = normals_camera @ light.light_from_camera.T.astype(np.float32)
    factor: Float32[np.ndarray, "n 3"] = harmonics(turned) @ light.coefficients.astype(np.float32)
    return factor.clip(DARKEST, BRIGHTEST)


def draw_lights(
    own: Mapping[str, Mapping[str, SceneLight]],
    up_camera: Float64[np.ndarray, "3"],
    rng: np.random.Generator,
) -> dict[str, Light]:
    """Draw the light of one of the scenes, turned about the vertical by any angle, for each object.

    Colours and lights were fitted to each object by itself, so each is lit by its own fit to the scene; an
    object that was not in the scene, by that of another one.

    Args:
        own: by object, then by scene.
        up_camera: the direction against gravity, or out of the table, in the image.
    """
    scenes = sorted({scene for lights in own.values() for scene in lights})
    chosen, spin_rad = scenes[int(rng.integers(len(scenes)))], rng.uniform(0, 2 * np.pi)
    gain = (1 + rng.uniform(-GAIN, GAIN)) * (1 + rng.uniform(-TINT, TINT, 3))
    found = {}
    for name, lights in own.items():
        other = sorted(lights)[int(rng.integers(len(lights)))]
        light = lights[chosen if chosen in lights else other]
        turn = turn_about(light.up, spin_rad) @ shortest_turn(up_camera, light.up)
        found[name] = Light(turn, light.coefficients * gain)
    return found
