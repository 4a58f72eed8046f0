"""What a person says of an object: kept, moved with the object frame, and refused where it is unclear."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from built_once import moved_copy

from rpl_data.formats.datasets.coco import objects_from_coco, read_coco
from rpl_data.geometry import from_rotvec, invert, transform
from rpl_data.pipeline.automatic import _without_colors
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.carved import is_carved
from rpl_data.pipeline.ledger import Ledger, Outcome, Step
from rpl_data.pipeline.recipe import AxisRecipe, ObjectRecipe
from rpl_data.pipeline.stages.export import EXPORTS
from rpl_data.pipeline.symmetry import (
    confirm_symmetry,
    frame_change,
    recipe_turns,
    symmetry_lines,
    symmetry_turns,
)
from rpl_data.symmetries import symmetries_of
from rpl_data.types import (
    DataError,
    FoundAxis,
    KeypointModel,
    SymmetryAxis,
    SymmetryRecord,
    Turns,
    UnsureError,
)
from rpl_data.workspace.workspace import Workspace

UPRIGHT = SymmetryAxis((0.0, 0.0, 1.0), (0.01, 0.0, 0.0))
FREE = FoundAxis(UPRIGHT, None, None, 0.9, 0.001, 0.02, True)
LABELLED = FoundAxis(UPRIGHT, 1, None, 0.9, 0.001, 0.6, True)
POINTS = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, np.nan]])
CUP = ObjectRecipe("cup", 4)


def test_a_record_comes_back_from_its_file(tmp_path):
    record = SymmetryRecord(POINTS, (FREE, LABELLED), 0.8, (Turns(UPRIGHT, None), Turns(UPRIGHT, 4)), "me")
    place = Workspace(tmp_path)
    assert place.load_symmetry("cup") is None
    place.save_symmetry("cup", record)
    back = place.load_symmetry("cup")
    assert back is not None
    np.testing.assert_array_equal(back.points_object[:3], POINTS[:3])
    assert dataclasses.replace(back, points_object=POINTS) == record


def test_a_damaged_record_is_named(tmp_path):
    place = Workspace(tmp_path)
    place.save_symmetry("cup", SymmetryRecord(POINTS, (), 1.0))
    file = place.symmetry_file("cup")
    file.write_text(file.read_text().replace('"found": []', '"found": [{"axis": [0, 0, 1]}]'))
    with pytest.raises(DataError, match="symmetry.json"):
        place.load_symmetry("cup")


def test_the_recipe_says_none_or_axes_of_any_length():
    assert recipe_turns(dataclasses.replace(CUP, symmetry="none")) == ()
    axes = (AxisRecipe((0.0, 0.0, 2.0), "any"), AxisRecipe((1.0, 0.0, 0.0), 2))
    free, half = recipe_turns(dataclasses.replace(CUP, symmetry=axes))
    assert free == Turns(SymmetryAxis((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), None) and half.turns == 2
    assert len(symmetries_of([half]).discrete) == 1 and symmetries_of([free]).continuous == (free.axis,)
    for wrong in (AxisRecipe((0.0, 0.0, 0.0), 2), AxisRecipe((0.0, 0.0, 1.0), 1)):
        with pytest.raises(DataError, match="symmetry"):
            recipe_turns(dataclasses.replace(CUP, symmetry=(wrong,)))


def test_turns_about_two_axes_bring_all_that_follow_from_them() -> None:
    """A square prism from two of its axes, one of them found two degrees off: eight poses, each closed."""
    tilted = (float(np.cos(0.035)), float(np.sin(0.035)), 0.0)
    axes = (
        Turns(SymmetryAxis((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), 4),
        Turns(SymmetryAxis(tilted, (0.0,) * 3), 2),
    )
    found = np.array([np.eye(4), *np.reshape(symmetries_of(axes).discrete, (-1, 4, 4))])
    assert len(found) == 8
    for one in found:
        for other in found:
            traces = np.einsum("nij,ij->n", found[:, :3, :3], (one @ other)[:3, :3])
            assert traces.max() > 1 + 2 * np.cos(np.deg2rad(5))
    cube = [Turns(SymmetryAxis(axis, (0.0,) * 3), 4) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    assert len(symmetries_of(cube).discrete) == 23


def test_axes_that_contradict_one_another_are_refused() -> None:
    near = (float(np.cos(0.7)), float(np.sin(0.7)), 0.0)
    turns = [Turns(SymmetryAxis(axis, (0.0,) * 3), 5) for axis in ((1.0, 0.0, 0.0), near)]
    with pytest.raises(DataError, match="some axis is wrong"):
        symmetries_of(turns)


def test_frames_change_by_the_keypoints_both_models_have():
    moved = from_rotvec(np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]))
    points = np.vstack([POINTS[:3], [[0.0, 0.0, 0.1]]])
    one = KeypointModel("cup", ("a", "b", "c", "d"), points)
    other = KeypointModel("cup", ("c", "b", "a", "e"), transform(moved, points[[2, 1, 0, 3]]) + 0.0)
    np.testing.assert_allclose(frame_change(other, one), moved, atol=1e-12)
    with pytest.raises(DataError, match="share 1 keypoints"):
        frame_change(dataclasses.replace(other, keypoints=("a", "x", "y", "z")), one)


def test_only_what_was_looked_at_well_enough_is_called_asymmetric():
    poor = "\n".join(symmetry_lines(CUP, SymmetryRecord(POINTS, (), 0.3)))
    assert "too little to judge by: 30%" in poor
    assert "no symmetry found" in "\n".join(symmetry_lines(CUP, SymmetryRecord(POINTS, (), 0.9)))
    proposed = "\n".join(symmetry_lines(CUP, SymmetryRecord(POINTS, (FREE,), 0.9)))
    assert "not confirmed, so not used" in proposed
    printed = "\n".join(symmetry_lines(CUP, SymmetryRecord(POINTS, (LABELLED,), 0.9)))
    assert "the shape has some, the print does not" in printed and "colours differ on 60%" in printed


@pytest.mark.parametrize(
    ("unseen", "carved"), [({"unseen_triangles": 9}, True), ({"unseen_triangles": 4}, False), ({}, False)]
)
def test_what_was_carved_was_not_seen(tmp_path, unseen, carved):
    place = Workspace(tmp_path)
    step = Step("segment", "cup", 1, {}, {}, (), (), lambda advance: Outcome())
    Ledger(place.stages_file).record(step, Outcome(details={"triangles": 9} | unseen), 0.0)
    assert is_carved(place, "cup") is carved
    refused = _without_colors(place, "cup", "00")
    assert isinstance(refused, UnsureError) is carved and ("rpl build" in str(refused)) is not carved


def test_confirmed_axes_follow_the_object_frame_into_the_export(tiny_workspace, tmp_path):
    place = Workspace(moved_copy(tiny_workspace.root, tmp_path / "copy"))
    context = context_of(place)
    then_from_now = from_rotvec(np.array([0.0, np.pi / 2, 0.0]), np.array([0.0, 0.0, 0.3]))
    points = transform(then_from_now, place.load_placed("carton").model.points_object)
    with pytest.raises(DataError, match="run `rpl symmetry --object carton` first"):
        confirm_symmetry(context, "carton", "found")
    confirm_symmetry(context, "carton", "none")  # though nobody has looked for any
    known = place.load_symmetry("carton")
    assert known is not None and known.confirmed == () and np.isnan(known.seen)
    place.save_symmetry("carton", SymmetryRecord(points, (FREE, LABELLED), 0.9))
    for answer in ("3", "0", "all"):
        with pytest.raises(
            DataError, match=f"no axis {answer} to confirm, since the axes .* numbers 1 to 2;"
        ):
            confirm_symmetry(context, "carton", answer)
    record = confirm_symmetry(context, "carton", "found")
    assert record.confirmed is not None and [one.turns for one in record.confirmed] == [None]
    EXPORTS["coco"](context)
    (item,) = objects_from_coco(read_coco(place.export("coco") / "train.json"))
    (axis,) = item.symmetries.continuous
    np.testing.assert_allclose(axis.direction, [-1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(
        axis.point_m, transform(invert(then_from_now), np.array([[0.01, 0.0, 0.0]]))[0], atol=1e-9
    )
    assert [one.turns for one in confirm_symmetry(context, "carton", "1,2").confirmed] == [None, None]
    assert confirm_symmetry(context, "carton", "none").confirmed == ()
    assert symmetry_turns(context, context.objects[0]) == ()
