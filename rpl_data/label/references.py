"""Choose the frames whose print of an object others are aligned to, and settle where they stand.

A reference is a slow frame. No single frame is right, however: its pose on the camera path is as uncertain as
that of its neighbours. So its slowest neighbours are aligned to it, and what most of them would have to be
corrected by is an error of the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from rpl_data.directions import view_direction
from rpl_data.geometry import Transform, from_rotvec, invert, transform
from rpl_data.label.alone import Body, ObjectAlone, object_alone
from rpl_data.label.masks import MaskPatch
from rpl_data.label.motion import Motion
from rpl_data.label.occlusion import FAR_M, Tolerances, hidden_pixels
from rpl_data.label.print_alignment import Prior, align_print, step_between
from rpl_data.label.prints import FEWEST_POINTS, Print, look_at, print_of
from rpl_data.raycast import PixelTable
from rpl_data.types import Frame, GreyImage, ReadDepth, Trajectory

APART_DEG = 12.0
"""Views of an object that differ by less than this need one reference between them."""
NEIGHBOURS = 8
"""Slow frames near a reference that say where it stands."""
TIMING_SIGMA_S = 0.012
"""A frame's pose is that of another moment by about this much: of the object's rows, of the depth image, or
of another device. How far the object moves in that time is how far its label may be off. It only bounds
corrections: a third of it and three times as much gave the same on a real recording."""
STILL_M, STILL_RAD = 0.001, float(np.deg2rad(0.15))
"""How far off the pose of a still camera may be, standard deviation per axis."""


@dataclass(frozen=True)
class Reference:
    """A slow frame that others are aligned to.

    Attributes:
        view: direction it sees the object from, object frame.
    """

    frame: int
    view: Float64[np.ndarray, "3"]
    print: Print


@dataclass(frozen=True)
class Sight:
    """An object as the frames of a scene see it."""

    camera: PixelTable
    motion: Motion
    trajectory: Trajectory
    body: Body
    read_depth: ReadDepth
    read_grey: Callable[[Frame], GreyImage]
    tolerances: Tolerances

    def pose(self, frame: Frame) -> Transform:
        """`camera_from_object` by the trajectory."""
        return self.body.item.camera_from_object(self.trajectory, frame.index)

    def speed_px_s(self, frame: Frame) -> float:
        """How fast the object passes through the image."""
        return self.motion.speed_px_s(self.camera, frame.index, self.body.item)

    def seen(self, frame: Frame) -> tuple[ObjectAlone, MaskPatch] | None:
        """The object in a frame and its pixels that no measured depth hides; None where too few are seen."""
        alone = object_alone(self.camera, self.body, self.pose(frame))
        if alone is None:
            return None
        nothing = np.full_like(alone.depth_m, FAR_M)
        measured = self.read_depth(frame)[alone.window]
        visible = alone.mask & ~hidden_pixels(alone.depth_m, nothing, measured, self.tolerances)
        return (alone, visible) if np.count_nonzero(visible) >= FEWEST_POINTS else None


def choose_references(sight: Sight, frames: Sequence[Frame]) -> list[Reference]:
    """The slowest frames whose views lie apart, as far as they show enough of the object."""
    found: list[Reference] = []
    for frame in sorted(frames, key=sight.speed_px_s):
        view = view_direction(sight.pose(frame))
        if any(_are_near(one.view, view) for one in found):
            continue
        seen = sight.seen(frame)
        if seen is not None:
            alone, visible = seen
            look = look_at(sight.read_grey(frame), alone, visible)
            shown = print_of(sight.camera, look, visible, alone.camera_from_object)
            if len(shown.points) >= FEWEST_POINTS:
                found.append(Reference(frame.index, view, shown))
    return found


def settled(sight: Sight, references: Sequence[Reference], frames: Sequence[Frame]) -> list[Reference]:
    """The references as their neighbours would have them: moved by the median of what these are moved."""
    middle = np.nanmean(sight.body.item.model.points_object, axis=0)
    views = [view_direction(sight.pose(frame)) for frame in frames]
    found = []
    for one in references:
        near = [frame for frame, view in zip(frames, views, strict=True) if _are_near(view, one.view)]
        near = [f for f in sorted(near, key=sight.speed_px_s) if f.index != one.frame][:NEIGHBOURS]
        steps = [np.zeros(6)]
        for frame in near:
            seen = sight.seen(frame)
            if seen is not None:
                alone, visible = seen
                prior = prior_of(sight.camera, alone, sight.speed_px_s(frame))
                look = look_at(sight.read_grey(frame), alone, visible)
                corrected = align_print(sight.camera, look, [one.print], middle, prior)
                steps.append(step_between(np.eye(4), invert(alone.camera_from_object) @ corrected, middle))
        shift = np.median(steps, axis=0)
        object_from_stood = from_rotvec(shift[:3], np.zeros(3))
        object_from_stood[:3, 3] = middle + shift[3:] - object_from_stood[:3, :3] @ middle
        points = transform(object_from_stood, one.print.points)
        found.append(Reference(one.frame, one.view, Print(points, one.print.brightness)))
    return found


def prior_of(camera: PixelTable, alone: ObjectAlone, speed_px_s: float) -> Prior:
    """The trajectory's pose and how far off it may be: more, the faster the object passes."""
    known = alone.depth_m[alone.mask]
    known = known[known < FAR_M]
    depth_m = float(np.median(known)) if len(known) else 1.0
    moved_m = speed_px_s * TIMING_SIGMA_S * depth_m / camera.intrinsics.fx
    points = alone.body.item.model.points_object
    radius_m = max(float(np.nanmax(np.linalg.norm(points - np.nanmean(points, axis=0), axis=1))), STILL_M)
    shift_m = float(np.hypot(np.hypot(STILL_M, alone.body.item.strayed_m), moved_m))
    return Prior(alone.camera_from_object, float(np.hypot(STILL_RAD, moved_m / (2 * radius_m))), shift_m)


def _are_near(one: Float64[np.ndarray, "3"], other: Float64[np.ndarray, "3"]) -> bool:
    return bool(one @ other > np.cos(np.deg2rad(APART_DEG)))
