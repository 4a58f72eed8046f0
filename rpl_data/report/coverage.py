"""From which sides each object was seen: its views as dots on two halves of a sphere around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64

from rpl_data.directions import COVERED_DEG, Directions, coverage
from rpl_data.overlay import keypoint_color
from rpl_data.report.html import chip, section, text

RADIUS = 100
"""Of a half, in units of the picture."""
MOST_DOTS = 1500
"""Per object; more would hide one another."""


def coverage_section(views: Mapping[str, Mapping[str, Directions]]) -> str:
    """The section with a picture per object; empty text where nothing is labelled.

    Args:
        views: by object, then by scene.
    """
    parts = [_object_part(name, by_scene) for name, by_scene in sorted(views.items()) if by_scene]
    note = (
        "Every dot is a frame: the side from which it shows the object. The left half of the sphere is the "
        "one that was seen most, the right half is what lies behind it; equal areas are equal shares of all "
        "directions. Training learns little about sides without dots."
    )
    return section("views", "Views", "".join(parts), note=note) if parts else ""


def _object_part(name: str, by_scene: Mapping[str, Directions]) -> str:
    together = np.concatenate(list(by_scene.values()))
    share = coverage(together)
    chips = "".join(
        chip(keypoint_color(number, len(by_scene)), f"scene {scene}: {len(views)}")
        for number, (scene, views) in enumerate(by_scene.items())
    )
    words = (
        f"{len(together)} views; {share:.0%} of all directions lie within {COVERED_DEG:.0f} degrees of one"
    )
    return (
        f'<h3>{text(name)}</h3><p class="note">{text(words)}</p>'
        f'<div class="chips">{chips}</div>{_picture(list(by_scene.values()), together)}'
    )


def _picture(scenes: Sequence[Directions], together: Directions) -> str:
    """Both halves of the sphere, by Lambert's projection, which keeps areas."""
    axes = _axes_around(together.mean(axis=0))
    every = max(1, -(-len(together) // MOST_DOTS))
    dots = []
    for number, views in enumerate(scenes):
        red, green, blue = keypoint_color(number, len(scenes))
        for x, y in _positions(views[::every] @ axes.T):
            dots.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="rgb({red},{green},{blue})"/>')
    halves = "".join(
        f'<circle cx="{centre}" cy="0" r="{RADIUS}" class="half"/>' for centre in (-RADIUS - 10, RADIUS + 10)
    )
    width = 4 * RADIUS + 60
    return (
        f'<svg class="sphere" viewBox="{-width / 2} {-RADIUS - 10} {width} {2 * RADIUS + 20}" role="img" '
        f'aria-label="sides from which the object was seen">{halves}{"".join(dots)}</svg>'
    )


def _positions(views: Directions) -> Float64[np.ndarray, "n 2"]:
    """Where views stand in the picture; their third axis points at the middle of the left half."""
    front = views[:, 2] >= 0
    depth = np.abs(views[:, 2])
    flat = views[:, :2] / np.sqrt(1 + depth)[:, None] * RADIUS
    centre = np.where(front, -RADIUS - 10, RADIUS + 10)
    return np.column_stack([flat[:, 0] * np.where(front, 1, -1) + centre, flat[:, 1]])


def _axes_around(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Rows of a rotation whose third axis is the direction; that of z where there is none."""
    length = float(np.linalg.norm(direction))
    third = direction / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    first = np.cross(np.eye(3)[np.abs(third).argmin()], third)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(third, first), third])
