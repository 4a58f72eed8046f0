"""Follow an object that is moved, frame by frame, on its own surface.

From frames in which its pose is known, by clicks, the pose is carried to the frames before and after them.
In each, depth near the object is drawn to its mesh (point to plane; Chen and Medioni, 1992), and what nearer
frames show printed on it is laid over the image (`print_alignment`), in one system of equations: depth alone
lets a flat or round object slide, brightness alone hardly tells its distance. A frame in which the result
does not hold is lost; the next one starts from the last that held.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float64

from rpl_data.directions import view_direction
from rpl_data.geometry import Points, Transform, depth_sigma_m, invert, transform
from rpl_data.label.alone import Body, ObjectAlone, object_alone
from rpl_data.label.masks import MaskPatch
from rpl_data.label.occlusion import FAR_M, Tolerances, hidden_pixels
from rpl_data.label.print_alignment import likeness, print_equations, step_between, stepped
from rpl_data.label.prints import FEWEST_POINTS, Print, look_at, print_of
from rpl_data.raycast import PixelTable
from rpl_data.types import DepthImage, Frame, GreyImage, ReadDepth, Window

PREDICTED_RAD, PREDICTED_M = 0.15, 0.03
"""Standard deviation of a predicted pose, per axis."""
BESIDE_PX = 12
"""Depth is taken from the object's silhouette and so far around it, since it may have moved."""
MOST_POINTS = 600
ROUNDS: tuple[tuple[float, int | None], ...] = (
    (0.03, None),
    (0.012, None),
    (0.008, 0),
    (0.008, 1),
    (0.008, 2),
)
"""Coarse to fine: how far from the mesh depth points count for little, and with which of its blurs the print
takes part. A print is laid wrongly where the guess is farther off than it is blurred: depth comes first."""
STEPS = 6
"""Steps per blur, at most."""
CONVERGED = 2e-4
"""No more after a step smaller than this (radians, metres)."""
INDEPENDENT = 0.1
"""Errors of neighbouring points are correlated, so each counts as this share of an independent one."""
MESH_SIGMA_M = 0.002
"""A mesh that was fused from depth lies about this far from the surface."""
LEAST_PX = 150
"""An object that shows fewer pixels with depth is too small, or too hidden, to follow."""
LEAST_NEAR = 0.75
"""Share of the pixels that nothing hides whose depth must lie within `NEAR_M` of the mesh's."""
NEAR_M = 0.01
MOST_THROUGH = 0.15
"""Share of the pixels through which the camera may see what lies behind: edges do that, an absent object does
it everywhere."""
LEAST_LIKE = 0.7
"""Correlation of the print with those of similar views: above 0.9 at right poses, 0.5 to 0.8 at poses ten
degrees off (measured on a rendered carton)."""
APART_RAD = np.deg2rad(20.0)
"""A view this far from those of all prints gives a print of its own."""
FAR_ROWS = 10**9
PRINTS = 3
"""Prints compared per frame: those with the most similar views."""


@dataclass(frozen=True)
class Followed:
    """Where an object is in the frames of a scene.

    Attributes:
        camera_from_object: by `Frame.index`, of the frames in which it was found.
        lost: why it was not found in others, by `Frame.index`.
    """

    camera_from_object: Mapping[int, Transform]
    lost: Mapping[int, str]


def follow(
    camera: PixelTable,
    body: Body,
    frames: Sequence[Frame],
    known: Mapping[int, Transform],
    read_depth: ReadDepth,
    read_grey: Callable[[Frame], GreyImage],
    *,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Followed:
    """Follow an object through frames in the order of time.

    Each frame starts from its neighbour on the side of the nearest frame whose pose is known, so errors do
    not grow farther than from there.

    Args:
        known: `camera_from_object` by clicks, by `Frame.index`.
        read_grey: brightness at full size.
    """
    follower = _Follower(camera, body, read_depth, read_grey)
    starts = [
        row
        for row, frame in enumerate(frames)
        if frame.index in known and follower.settle(frame, [known[frame.index]], clicked=True)
    ]
    order = sorted(range(len(frames)), key=lambda row: _to_nearest(row, starts)[0])
    for done, row in enumerate(order):
        advance(done, len(frames))
        distance, nearest = _to_nearest(row, starts)
        if distance:
            side = 1 if row < nearest else -1
            before = [frames[other].index for other in range(row + side, nearest + side, side)]
            follower.step(frames[row], [index for index in before if index in follower.found][:2])
    return Followed(follower.found, follower.lost)


def _to_nearest(row: int, starts: Sequence[int]) -> tuple[int, int]:
    """How many rows away the nearest start is, and which row it is; far away without any."""
    return min(((abs(row - start), start) for start in starts), default=(FAR_ROWS, row))


@dataclass(frozen=True)
class _Judged:
    """A pose, and how it fits a frame.

    Attributes:
        problem: why it does not hold; empty where it does.
        like: correlation of the print with that of other frames; 0 where there is none to compare.
        near, through: shares of the object's pixels whose depth is the mesh's, and lies behind it.
        alone, visible: the object there, and its pixels that nothing hides.
    """

    camera_from_object: Transform
    problem: str
    near: float = 0.0
    through: float = 1.0
    like: float = 0.0
    alone: ObjectAlone | None = None
    visible: MaskPatch = field(default_factory=lambda: np.zeros((0, 0), bool))


@dataclass
class _Follower:
    """What was found so far, and the prints to compare with."""

    camera: PixelTable
    body: Body
    read_depth: ReadDepth
    read_grey: Callable[[Frame], GreyImage]
    found: dict[int, Transform] = field(default_factory=dict)
    lost: dict[int, str] = field(default_factory=dict)
    prints: list[tuple[Float64[np.ndarray, "3"], Print]] = field(default_factory=list)

    def step(self, frame: Frame, before: Sequence[int]) -> None:
        """Follow to a frame from those beside it, the nearest first."""
        if not before:
            self.lost.setdefault(frame.index, "the object was found in no clicked frame")
            return
        guesses = [self.found[before[0]]]
        if len(before) == 2 and abs(before[0] - before[1]) == abs(before[0] - frame.index):
            last, earlier = (self.found[index] for index in before)
            guesses.insert(0, last @ invert(earlier) @ last)
        self.settle(frame, guesses)

    def settle(self, frame: Frame, guesses: Sequence[Transform], *, clicked: bool = False) -> bool:
        """Find the pose from guesses, and keep the best where it holds; returns whether it does."""
        if frame.depth is None:
            self.lost[frame.index] = "it has no depth image"
            return False
        depth_m, grey = self.read_depth(frame), self.read_grey(frame)
        tried = [self._judged(self._drawn(guess, depth_m, grey), depth_m) for guess in guesses]
        tried = [self._beside_prints(one, grey) for one in tried]
        best = max(tried, key=lambda one: one.near - one.through + one.like)
        if best.problem or best.alone is None:
            self.lost[frame.index] = best.problem
            return False
        self.found[frame.index] = best.camera_from_object
        self._remember(best.camera_from_object, best.alone, best.visible, grey, new=clicked)
        return True

    def _drawn(self, guess: Transform, depth_m: DepthImage, grey: GreyImage) -> Transform:
        """The pose at which depth, print and the prediction agree best."""
        known = np.diag([PREDICTED_RAD**-2] * 3 + [PREDICTED_M**-2] * 3)
        middle = np.nanmean(self.body.item.model.points_object, axis=0)
        pose = guess
        for gate_m, level in ROUNDS:
            alone = object_alone(self.camera, self.body, pose)
            if alone is None:
                return pose
            points = self._measured(alone, depth_m)
            look = look_at(grey, alone, self._visible(alone, depth_m))
            prints = [] if level is None else self._nearest_prints(pose)
            for _ in range(STEPS):
                centre = transform(pose, middle)
                information, pull = known.copy(), known @ step_between(pose, guess, centre)
                terms = [_depth_equations(self.body, points, pose, centre, gate_m)]
                terms += [print_equations(self.camera, look, one, pose, centre, level or 0) for one in prints]
                for more, towards in terms:
                    information, pull = information + more, pull + towards
                step = np.linalg.solve(information, pull)
                pose = stepped(pose, step, centre)
                if np.abs(step).max() < CONVERGED:
                    break
        return pose

    def _measured(self, alone: ObjectAlone, depth_m: DepthImage) -> Points:
        """Points that the sensor measured on and around the object, camera frame."""
        rows, columns = _widened(alone.window, depth_m.shape)
        inside = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
        inside[
            alone.window[0].start - rows.start : alone.window[0].stop - rows.start,
            alone.window[1].start - columns.start : alone.window[1].stop - columns.start,
        ] = alone.mask
        size = 2 * BESIDE_PX + 1
        near = np.asarray(cv2.dilate(inside, np.ones((size, size), np.uint8))) > 0
        patch = depth_m[rows, columns]
        row, column = np.nonzero(near & (patch > 0))
        every = max(1, -(-len(row) // MOST_POINTS))
        row, column = row[::every], column[::every]
        directions = self.camera.directions[rows, columns][row, column].astype(np.float64)
        return directions * patch[row, column, None].astype(np.float64)

    def _visible(self, alone: ObjectAlone, depth_m: DepthImage) -> MaskPatch:
        nothing = np.full_like(alone.depth_m, FAR_M)
        hidden = hidden_pixels(alone.depth_m, nothing, depth_m[alone.window], Tolerances())
        visible: MaskPatch = alone.mask & ~hidden
        return visible

    def _nearest_prints(self, pose: Transform) -> list[Print]:
        view = view_direction(pose)
        return [one for _, one in sorted(self.prints, key=lambda kept: -float(kept[0] @ view))[:PRINTS]]

    def _judged(self, pose: Transform, depth_m: DepthImage) -> _Judged:
        """Whether a pose holds."""
        alone = object_alone(self.camera, self.body, pose)
        if alone is None:
            return _Judged(pose, "the object left the image")
        visible, measured = self._visible(alone, depth_m), depth_m[alone.window]
        compared = visible & (measured > 0) & (alone.depth_m < FAR_M)
        if np.count_nonzero(compared) < LEAST_PX:
            return _Judged(
                pose, "too few of its pixels are seen with depth: it is too far, hidden, or out of view"
            )
        behind_m = measured[compared] - alone.depth_m[compared]
        through = float((behind_m > Tolerances().depth_at_m(alone.depth_m[compared])).mean())
        near = float((np.abs(behind_m) < NEAR_M).mean())
        problem = ""
        if through > MOST_THROUGH or near < LEAST_NEAR:
            problem = "depth does not show the object's shape where it should be"
        return _Judged(pose, problem, near, through, 0.0, alone, visible)

    def _beside_prints(self, judged: _Judged, grey: GreyImage) -> _Judged:
        """A pose that depth allows, beside what other frames show printed on the object."""
        pose, prints = judged.camera_from_object, self._nearest_prints(judged.camera_from_object)
        if judged.problem or judged.alone is None:
            return judged
        look = look_at(grey, judged.alone, judged.visible)
        like = [likeness(self.camera, look, one, pose) for one in prints]
        found = [one for one in like if np.isfinite(one)]
        if not found:
            return judged
        unlike = max(found) < LEAST_LIKE
        problem = "what is printed on the object is not found where it should be" if unlike else ""
        return replace(judged, like=max(found), problem=problem)

    def _remember(
        self, pose: Transform, alone: ObjectAlone, visible: MaskPatch, grey: GreyImage, *, new: bool
    ) -> None:
        """Keep the print of a view that no kept print shows."""
        view = view_direction(pose)
        if not new and any(float(other @ view) > np.cos(APART_RAD) for other, _ in self.prints):
            return
        shown = print_of(self.camera, look_at(grey, alone, visible), visible, pose)
        if len(shown.points) >= FEWEST_POINTS:
            self.prints.append((view, shown))


def _depth_equations(
    body: Body, points: Points, pose: Transform, centre: Float64[np.ndarray, "3"], gate_m: float
) -> tuple[Float64[np.ndarray, "6 6"], Float64[np.ndarray, "6"]]:
    """Information and pull of measured depth on a turn about the centre and a shift, camera axes."""
    if not len(points):
        return np.zeros((6, 6)), np.zeros(6)
    nearest = body.rays.closest(transform(invert(pose), points))
    normals = nearest.normals @ pose[:3, :3].T
    normals *= np.where((normals * points).sum(axis=1) > 0, -1.0, 1.0)[:, None]
    offset_m = points - transform(pose, nearest.points)
    before_m = (offset_m * normals).sum(axis=1)
    sigma_m = np.hypot(np.asarray(depth_sigma_m(points[:, 2])), MESH_SIGMA_M)
    weight = 1 / (1 + (offset_m**2).sum(axis=1) / np.maximum(gate_m, 3 * sigma_m) ** 2) ** 2 / sigma_m**2
    rows = np.hstack([np.cross(points - offset_m - centre, normals), normals])
    weighted = rows * weight[:, None]
    return INDEPENDENT * weighted.T @ rows, INDEPENDENT * weighted.T @ before_m


def _widened(window: Window, shape: tuple[int, ...]) -> Window:
    low = [max(side.start - BESIDE_PX, 0) for side in window]
    high = [min(side.stop + BESIDE_PX, size) for side, size in zip(window, shape, strict=True)]
    return slice(low[0], high[0]), slice(low[1], high[1])
