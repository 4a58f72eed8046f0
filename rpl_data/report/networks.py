"""Where trained networks see the objects otherwise than the labels have them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rpl_data.pose.agreement import FARTHER, FEWEST_TO_JUDGE, keypoint_distance_m, labels_stray
from rpl_data.report.html import Cell, number, section, table
from rpl_data.types import NetworkView, Solution

NOTE = (
    "The pose on which a network's images agree, beside the labels: distance of the keypoints, root mean "
    "square. Red: the labels lie more than {times:g} times as far from it as the middle one of at least "
    "{fewest} agreeing images; look at that scene, for this does not say which of the two is wrong. Errors "
    "that are small beside the distances of the images go unmarked. A network can repeat errors of labels "
    "that it was trained on: only a scene that it never saw is an independent check."
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
    return section(
        "networks", "Networks and labels", body, note=NOTE.format(times=FARTHER, fewest=FEWEST_TO_JUDGE)
    )


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
    return Cell(words, kind="over") if labels_stray(apart_m, view.off_m) else words
