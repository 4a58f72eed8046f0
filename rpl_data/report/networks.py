"""Where trained networks see the objects otherwise than the labels have them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rpl_data.pose.agreement import keypoint_distance_m
from rpl_data.report.html import Cell, number, section, table
from rpl_data.types import NetworkView, Solution

FARTHER = 0.95
"""A label that lies farther from the network's pose than this share of the agreeing images is marked."""

FEWEST = 8
"""Agreeing images from which the shares mean anything."""

NOTE = (
    "The pose on which a network's images agree, beside the labels: distance of the keypoints, root mean "
    "square. Red: the labels lie farther from it than {share:.0%} of the agreeing images do; look at that "
    "scene, for this does not say which of the two is wrong. A network can repeat errors of labels that it "
    "was trained on: only a scene that it never saw is an independent check."
)


def networks_section(
    views: Mapping[str, Mapping[str, NetworkView]], solutions: Mapping[str, Solution]
) -> str:
    """The section with a row per object and scene that a network looked at; empty text without any.

    Args:
        views: what networks saw, by object, then by scene.
        solutions: by object, as the labels follow them now.
    """
    rows = [
        _row(name, scene, view, solutions[name])
        for name, by_scene in sorted(views.items())
        if name in solutions
        for scene, view in sorted(by_scene.items())
    ]
    if not rows:
        return ""
    header = (
        "object",
        "scene",
        "apart mm",
        "images apart mm",
        "agree",
        "with a pose",
        "looked at",
        "network",
    )
    body = table(header, rows, left=2)
    return section("networks", "Networks and labels", body, note=NOTE.format(share=FARTHER))


def _row(name: str, scene: str, view: NetworkView, solution: Solution) -> list[str | Cell]:
    return [
        name,
        scene,
        _apart(scene, view, solution),
        number(1e3 * float(np.median(view.off_m)), 0) if view.off_m else "",
        str(len(view.frames)),
        str(view.found),
        str(view.looked),
        view.network,
    ]


def _apart(scene: str, view: NetworkView, solution: Solution) -> str | Cell:
    """The distance between network and labels; marked where the network's images do not explain it."""
    if scene not in solution.scene_from_object:
        return "not labelled"
    if view.scene_from_object is None:
        return "no agreement"
    if view.points_object.shape != solution.model.points_object.shape:
        return "other keypoints"
    apart_m = keypoint_distance_m(
        view.scene_from_object,
        view.points_object,
        solution.scene_from_object[scene],
        solution.model.points_object,
    )
    words = number(1e3 * apart_m, 0)
    marked = len(view.off_m) >= FEWEST and np.mean(np.array(view.off_m) < apart_m) > FARTHER
    return Cell(words, kind="over") if marked else words
