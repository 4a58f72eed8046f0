"""The data that the server sends to the page, JSON-ready."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from rpl_data.annotate.advice import next_step
from rpl_data.annotate.live import FEWEST
from rpl_data.annotate.log import Revision
from rpl_data.annotate.session import Result
from rpl_data.annotate.settled import weak_scenes
from rpl_data.annotate.stores.scenes import PosedScene
from rpl_data.clicks.log import Annotation, Event
from rpl_data.json_arrays import Json, numbers, rows_to_json
from rpl_data.overlay import keypoint_color
from rpl_data.types import ClickResidual, Solution, Statement
from rpl_data.types.instances import frame_of, places_in
from rpl_data.types.keypoint_names import keypoint_titles


def scene_payload(posed: PosedScene) -> Json:
    """Describe a scene without its frames."""
    camera = posed.scene.intrinsics
    return {
        "name": posed.scene.name,
        "width": camera.width,
        "height": camera.height,
        "camera": [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion],
        "metres_per_unit": posed.scene.metres_per_unit,
        "registered": posed.scene.registered,
        "frames": len(posed.frames),
        "without_pose": len(posed.scene.frames) - len(posed.frames),
    }


def object_payload(revision: Revision) -> Json:
    """Describe the state of an object's log."""
    annotation = revision.annotation
    count = len(annotation.keypoints)
    grasp = annotation.grasp
    return {
        "object": annotation.object,
        "revision": revision.number,
        "keypoints": [
            {"name": name, "color": "#{:02x}{:02x}{:02x}".format(*keypoint_color(k, count))}
            for k, name in enumerate(annotation.keypoints)
        ],
        "clicks": [
            {"keypoint": c.keypoint, "scene": c.scene, "frame": c.frame, "u_px": c.u_px, "v_px": c.v_px}
            for c in annotation.clicks
        ],
        "skipped": sorted(annotation.skipped),
        "known_points": annotation.known_points,
        "grasp": None if grasp is None else {**vars(grasp)},
        "crop_m": annotation.crop_m,
        "undo": described(revision.undo, annotation.keypoints),
        "redo": described(revision.redo, annotation.keypoints),
    }


def described(event: Event | None, keypoints: tuple[str, ...]) -> str | None:
    """Describe an action in words, for the undo and redo buttons."""
    if event is None:
        return None
    number = event.get("keypoint")
    title = keypoint_titles(keypoints)[number] if number is not None and number < len(keypoints) else ""
    name = f"keypoint {title}"
    words = {
        "click": f"the click on {name}",
        "move": f"moving {name}",
        "delete": f"deleting the click on {name}",
        "skip": f"skipping {name}",
        "unskip": f"no longer skipping {name}",
        "keypoints": "the list of keypoints",
        "order": "the order of the keypoints",
        "model": "the known model",
        "grasp": "the grasp",
        "crop": "the crop box",
        "batch": "several changes at once",
    }
    return words[event["op"]]


def result_payload(result: Result, scenes: Sequence[str]) -> Json:
    """Describe the solution of a revision, how well it fits each scene and click, and what to do next."""
    revision, live = result.revision, result.live
    solution, places = live.solution, places_of(revision.annotation, scenes)
    return {
        "revision": revision.number,
        "problem": live.problem,
        "seconds": round(live.seconds, 4),
        "checking": live.check is not None,
        "loose": dict(live.loose),
        "warnings": [] if solution is None else list(solution.warnings),
        "statements": [] if solution is None else [_statement(s) for s in solution.statements],
        "points_m": None if solution is None else rows_to_json(solution.model.points_object, 7),
        "known_to_mm": [] if solution is None else _known_to_mm(solution),
        "scene_from_object": {}
        if solution is None
        else {name: numbers(matrix, 9) for name, matrix in solution.scene_from_object.items()},
        "skeleton": [] if solution is None else [list(pair) for pair in solution.model.skeleton],
        "clicks": [] if solution is None else [_residual(r) for r in solution.residuals],
        "scenes": _scenes(result),
        "lifted": [
            {"keypoint": click.keypoint, "scene": click.scene, "point_m": numbers(point, 6)}
            for click, point in result.lifted
        ],
        "grasp": None if result.grasp is None else numbers(result.grasp, 7),
        "grasp_problem": result.grasp_problem,
        "next": asdict(next_step(revision.annotation, live, places, result.rough_scenes(), result.judged)),
    }


def places_of(annotation: Annotation, scenes: Sequence[str]) -> list[str]:
    """The scenes, each followed by the places of further instances that were clicked in it.

    Of a scene in which the object is moved, the clicked frames alone.
    """
    clicked, found = {click.scene for click in annotation.clicks}, []
    for scene in scenes:
        there = places_in(scene, clicked)
        moved = any(frame_of(place) is not None for place in there)
        found += there if moved else sorted({scene, *there})
    return found


def _known_to_mm(solution: Solution) -> list[float | None]:
    """Root mean square distance of each keypoint from its true place in the object."""
    distances_mm = 1e3 * np.sqrt(np.trace(solution.covariance, axis1=1, axis2=2))
    return [round(float(d), 2) if math.isfinite(d) else None for d in distances_mm]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def _statement(statement: Statement) -> Json:
    return {
        "kind": statement.kind,
        "text": statement.text,
        "blames": statement.blames,
        "clicks": [{"keypoint": c.keypoint, "scene": c.scene, "frame": c.frame} for c in statement.clicks],
    }


def _residual(residual: ClickResidual) -> Json:
    click = residual.click
    return {
        "keypoint": click.keypoint,
        "scene": click.scene,
        "frame": click.frame,
        "error_px": round(residual.error_px, 3),
        "error_mm": None if residual.error_m is None else round(1e3 * residual.error_m, 3),
        "depth_state": residual.depth_state,
        "outlier": residual.outlier,
        "reason": residual.reason,
    }


def _scenes(result: Result) -> dict[str, Json]:
    """Describe each scene with clicks or a pose: its state, how its clicks fit, and its expected error."""
    live, clicks = result.live, result.revision.annotation.clicks
    residuals = live.solution.residuals if live.solution else ()
    found = {}
    for scene in sorted({click.scene for click in clicks} | set(live.placed)):
        mine = [r for r in residuals if r.click.scene == scene]
        found[scene] = {
            "state": _state(result, scene, mine),
            "clicked": len({click.keypoint for click in clicks if click.scene == scene}),
            "bad": sum(r.outlier for r in mine),
            "miss_px": round(float(np.median([r.error_px for r in mine])), 2) if mine else None,
            "expected_mm": _rounded(live.solution.expected_mm.get(scene)) if live.solution else None,
            "expected_px": _rounded(result.expected_px.get(scene)),
            "text": live.loose.get(scene, ""),
        }
    return found


def _state(result: Result, scene: str, residuals: Sequence[ClickResidual]) -> str:
    """What is to be said of a scene first: mistakes, then what is missing, then how good it is."""
    live = result.live
    clicked = {c.keypoint for c in result.revision.annotation.clicks if c.scene == scene}
    rough_px, left_out_px = result.limits_px
    expected_px = result.expected_px.get(scene, 0.0)
    if any(r.outlier for r in residuals):
        return "bad"
    if any(r.reason for r in residuals):
        return "doubt"
    if live.solution is None or scene not in live.solution.scene_from_object:
        return "few" if len(clicked) < FEWEST else "loose"
    if live.check is not None and clicked:
        return "checking"
    if expected_px > rough_px:
        return "unfit" if expected_px > left_out_px else "rough"
    if any(statement.clicks[0].scene == scene for statement in weak_scenes(live)):
        return "weak"
    return "tied" if clicked else "found"
