"""Symmetries of the objects of a workspace: found, confirmed by a person, and read for the exports."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from rpl_data.geometry import Points, Transform, fit_rigid
from rpl_data.meshes import load_cloud
from rpl_data.pipeline.carved import is_carved
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.recipe import AxisRecipe, ObjectRecipe
from rpl_data.symmetries import moved_axis, moved_turns
from rpl_data.types import DataError, FoundAxis, KeypointModel, SymmetryAxis, SymmetryRecord, Turns
from rpl_data.version import installed_version

LEAST_SEEN = 0.5
"""Share of the dense model that must have been seen to call an object without symmetry."""


def symmetry_turns(context: Context, item: ObjectRecipe) -> tuple[Turns, ...]:
    """The symmetries that hold for an object: the recipe's, else those that a person confirmed.

    Axes are in the object frame as it is now.
    """
    if item.symmetry is not None:
        return recipe_turns(item)
    record = context.workspace.load_symmetry(item.name)
    if record is None or not record.confirmed:
        return ()
    return moved_turns(record.confirmed, _now_from_then(context, item.name, record))


def recipe_turns(item: ObjectRecipe) -> tuple[Turns, ...]:
    """The symmetries that the recipe gives an object; none where it says nothing.

    Raises:
        DataError: an axis has no direction, or fewer than two turns.
    """
    given = () if item.symmetry in (None, "none") else item.symmetry
    return tuple(_turns_of_recipe(axis) for axis in given if isinstance(axis, AxisRecipe))


def _turns_of_recipe(axis: AxisRecipe) -> Turns:
    length = math.hypot(*axis.axis)
    if not length > 0:
        raise DataError("symmetry: axis is 0, 0, 0 in the recipe; write a direction, as `rpl symmetry` shows")
    if axis.turns != "any" and axis.turns < 2:
        raise DataError(f"symmetry: turns is {axis.turns} in the recipe; write 2 or more, or `any`")
    x, y, z = (value / length for value in axis.axis)
    return Turns(SymmetryAxis((x, y, z), axis.point_m), None if axis.turns == "any" else axis.turns)


def frame_change(to: KeypointModel, of: KeypointModel) -> Transform:
    """The motion from one object frame to another of the same object: that of the keypoints both have.

    The object frame follows its keypoints, which later clicks move; that of the truth is another one.

    Raises:
        DataError: the models share fewer than three keypoints.
    """
    places = dict(zip(of.keypoints, of.points_object, strict=True))
    pairs = [
        (point, places[name])
        for name, point in zip(to.keypoints, to.points_object, strict=True)
        if name in places and np.isfinite(point).all() and np.isfinite(places[name]).all()
    ]
    if len(pairs) < 3:
        raise DataError(
            f"object {to.name}: two models of it share {len(pairs)} keypoints, and 3 are needed to bring "
            f"its symmetry from one to the other; run `rpl symmetry --object {to.name}` again, and confirm it"
        )
    return fit_rigid(*(np.array(side) for side in zip(*pairs, strict=True)))


def _now_from_then(context: Context, name: str, record: SymmetryRecord) -> Transform:
    now = context.workspace.load_placed(name).model
    if len(now.points_object) != len(record.points_object):
        raise DataError(
            f"object {name}: its symmetry was found for {len(record.points_object)} keypoints, and it has "
            f"{len(now.points_object)} now; delete {context.workspace.symmetry_file(name)}, and run "
            f"`rpl symmetry --object {name}` again"
        )
    return frame_change(now, dataclasses.replace(now, points_object=record.points_object))


def find_object_symmetry(context: Context, name: str) -> SymmetryRecord:
    """Look for the symmetries of an object's dense model and keep what was found beside what is confirmed."""
    from rpl_data.symmetry import find_symmetry

    workspace = context.workspace
    mesh, cloud = workspace.mesh(name), None
    if workspace.cloud_file(name).exists():
        cloud = load_cloud(workspace.cloud_file(name))
    found, seen = find_symmetry(mesh, cloud)
    if is_carved(workspace, name):
        seen = 0.0
    before = workspace.load_symmetry(name)
    points: Points = workspace.load_placed(name).model.points_object
    record = SymmetryRecord(points, found, seen)
    if before is not None and before.confirmed is not None:
        confirmed = moved_turns(before.confirmed, _now_from_then(context, name, before))
        record = dataclasses.replace(record, confirmed=confirmed, by=before.by)
    workspace.save_symmetry(name, record)
    return record


def confirm_symmetry(context: Context, name: str, answer: str) -> SymmetryRecord:
    """Keep what a person says of an object's symmetry.

    Args:
        context: the workspace with its recipe.
        name: of the object.
        answer: `none`; `found`, all that shape and print allow; or numbers of found axes, such as `1,3`,
            which hold for the shape even where the print differs.

    Raises:
        DataError: nothing was looked for yet, or there is no axis of that number.
    """
    record = context.workspace.load_symmetry(name)
    if answer == "none":
        points = context.workspace.load_placed(name).model.points_object
        record = record or SymmetryRecord(points, None, math.nan)
        chosen: tuple[Turns, ...] = ()
    else:
        if record is None or record.found is None:
            raise DataError(f"object {name}: run `rpl symmetry --object {name}` first, then confirm")
        axes = _now_axes(record.found, _now_from_then(context, name, record))
        points = context.workspace.load_placed(name).model.points_object
        record = dataclasses.replace(record, points_object=points, found=axes)
        chosen = _chosen(axes, name, answer)
    record = dataclasses.replace(record, confirmed=chosen, by=_by(answer))
    context.workspace.save_symmetry(name, record)
    return record


def _by(answer: str) -> str:
    return f"rpl symmetry --confirm {answer} (rpl-data {installed_version()})"


def _now_axes(axes: tuple[FoundAxis, ...], now_from_then: Transform) -> tuple[FoundAxis, ...]:
    return tuple(dataclasses.replace(one, axis=moved_axis(one.axis, now_from_then)) for one in axes)


def _chosen(axes: tuple[FoundAxis, ...], name: str, answer: str) -> tuple[Turns, ...]:
    if answer == "found":
        return tuple(Turns(one.axis, one.turns) for one in axes if one.turns != 1)
    try:
        numbers = [int(part) for part in answer.split(",")]
        if not all(1 <= number <= len(axes) for number in numbers):
            raise ValueError
    except ValueError:
        raise DataError(
            f"object {name}: there is no axis {answer} to confirm, since {_numbered(len(axes))}; confirm "
            f"`found` (all of them), `none`, or some by their numbers; `rpl symmetry --object {name}` lists "
            "them"
        ) from None
    picked = [axes[number - 1] for number in dict.fromkeys(numbers)]
    return tuple(Turns(one.axis, one.shape_turns if one.turns == 1 else one.turns) for one in picked)


def _numbered(axes: int) -> str:
    """Which numbers the axes of an object have, in words."""
    few = {0: "no axis was found", 1: "one axis was found, number 1"}
    return few.get(axes, f"the axes found have the numbers 1 to {axes}")


def symmetry_lines(item: ObjectRecipe, record: SymmetryRecord) -> list[str]:
    """What was found and what holds, in words."""
    found = record.found or ()
    lines = [f"{item.name}: {_summary(record)}"]
    lines += [f"    {number}: {_described(one)}" for number, one in enumerate(found, start=1)]
    if item.symmetry is not None:
        lines.append("    the recipe's `symmetry` holds, whatever is confirmed here")
    elif record.confirmed is not None:
        held = "; ".join(
            f"{_turn_words(one.turns)} about {_axis_words(one.axis)}" for one in record.confirmed
        )
        lines.append(f"    confirmed: {held or 'none'}")
    elif any(one.turns != 1 for one in found):
        lines.append(
            f"    not confirmed, so not used: rpl symmetry --object {item.name} --confirm found (or none)"
        )
    return lines


def _summary(record: SymmetryRecord) -> str:
    share = f"{record.seen:.0%} of its surface was seen"
    if record.found is None:
        return "nobody has looked for symmetries"
    if record.seen < LEAST_SEEN:
        return f"too little to judge by: {share}; record it from more sides. What shows so far:"
    held = [one for one in record.found if one.turns != 1]
    if held:
        return (
            f"symmetric about {'one axis' if len(held) == 1 else f'{len(held)} axes'}, as proposed ({share})"
        )
    if record.found:
        return f"no symmetry: the shape has some, the print does not ({share})"
    return f"no symmetry found ({share})"


def _described(one: FoundAxis) -> str:
    fits = f"95 % of the surface within {1000 * one.off_m:.1f} mm, {one.compared:.0%} of it compared"
    if math.isnan(one.print_off):
        colour = "colours unknown: look whether its print is the same"
    else:
        colour = f"colours differ on {one.print_off:.0%}"
    how = "sure" if one.sure else "unsure: look at it"
    if one.turns == 1:
        return (
            f"shape only: {_turn_words(one.shape_turns)} about {_axis_words(one.axis)} ({fits}); its print "
            f"differs: {colour} ({how})"
        )
    return f"{_turn_words(one.turns)} about {_axis_words(one.axis)} ({fits}; {colour}; {how})"


def _turn_words(turns: int | None) -> str:
    return "any turn" if turns is None else f"{turns} equal turns"


def _axis_words(axis: SymmetryAxis) -> str:
    direction = ", ".join(f"{value:.3f}" for value in axis.direction)
    point = ", ".join(f"{value:.4f}" for value in axis.point_m)
    return f"axis [{direction}] through point_m [{point}]"
