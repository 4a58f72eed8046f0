"""Correct the object's pose in single frames, by the print that slower frames show of it.

A camera path is right for a whole image; where the camera moves fast, it is not for the rows that show the
object, which a rolling shutter takes at another moment, and blur misleads it. So the label of each frame is
aligned to the print that the slowest frames with a similar view show of the object (`references`,
`print_alignment`). Its correction is believed where parts of the print that were left out of it agree with
it, and where it matters; else the label keeps the pose that the trajectory gives it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from rpl_data.directions import view_direction
from rpl_data.geometry import Points, Transform, transform
from rpl_data.held_out import are_black, block_means, blocks_of, in_standard_errors
from rpl_data.label.alone import Body, ObjectAlone, SceneObject, object_alone
from rpl_data.label.masks import MaskPatch
from rpl_data.label.motion import Motion
from rpl_data.label.occlusion import DepthPatch, Tolerances, hidden_pixels
from rpl_data.label.print_alignment import Prior, align_print, disagreements
from rpl_data.label.prints import FEWEST_POINTS, Look, Print, look_at
from rpl_data.label.references import Reference, Sight, choose_references, prior_of, settled
from rpl_data.raycast import PixelTable
from rpl_data.types import DepthImage, Frame, GreyImage, ReadDepth, Scene, Trajectory

NEAREST = 2
"""References that a frame is aligned to: those with the most similar views."""
BLOCK_M = 0.012
"""Parts of the print that are left out are blocks of this edge, a chessboard of them."""
GAIN_SIGMAS = 1.645
"""The parts left out must gain by this many standard errors: chance alone does in 5 % of the frames."""
LEAST_MOVED_PX = 0.5
"""Smaller corrections are left: the poses of the references are hardly better known."""


@dataclass(frozen=True)
class Correction:
    """What a frame's own print says of a label's pose.

    Attributes:
        camera_from_object: the pose that fits the print.
        moved_px: how far it moves the keypoints, root mean square.
        gain_sigmas: by how much the left-out parts of the print agree better with it, in standard errors; 0
            where it is too small to matter.
    """

    camera_from_object: Transform
    moved_px: float
    gain_sigmas: float

    @property
    def believed(self) -> bool:
        """Whether held-out evidence is for it, and it matters."""
        return self.gain_sigmas >= GAIN_SIGMAS and self.moved_px >= LEAST_MOVED_PX


@dataclass(frozen=True)
class FrameCorrector:
    """Corrects the labels of one scene.

    Attributes:
        references: per instance, by `SceneObject.key`.
        unproven: also apply corrections without held-out evidence, and small ones.
    """

    camera: PixelTable
    motion: Motion
    references: Mapping[tuple[str, str], Sequence[Reference]]
    unproven: bool = False

    def corrected(
        self,
        frame: int,
        objects_alone: Sequence[ObjectAlone],
        others_m: Sequence[DepthPatch],
        depth_m: DepthImage,
        grey: GreyImage,
        tolerances: Tolerances,
    ) -> tuple[list[ObjectAlone], list[Correction | None]]:
        """The objects of a frame where they are corrected to, and what the frame says of each.

        Args:
            others_m: for each object, the depth of the nearest other one in its window.
        """
        result, found = [], []
        for alone, other_m in zip(objects_alone, others_m, strict=True):
            hidden = hidden_pixels(alone.depth_m, other_m, depth_m[alone.window], tolerances)
            correction = self.correction(frame, alone, alone.mask & ~hidden, grey)
            there = None
            if correction is not None and (correction.believed or self.unproven):
                there = object_alone(self.camera, alone.body, correction.camera_from_object)
            result.append(there or alone)
            found.append(correction)
        return result, found

    def correction(
        self, frame: int, alone: ObjectAlone, visible: MaskPatch, grey: GreyImage
    ) -> Correction | None:
        """The correction of an object's label in a frame; None without a print.

        Args:
            visible: the object's pixels that nothing hides, in its window.
        """
        item, pose = alone.body.item, alone.camera_from_object
        references = self.references.get(item.key, ())
        if not references or np.count_nonzero(visible) < FEWEST_POINTS:
            return None
        view = view_direction(pose)
        nearest = sorted(references, key=lambda one: -float(one.view @ view))[:NEAREST]
        prints = [one.print for one in nearest]
        look = look_at(grey, alone, visible)
        prior = prior_of(self.camera, alone, self.motion.speed_px_s(self.camera, frame, item))
        middle = np.nanmean(item.model.points_object, axis=0)
        corrected = align_print(self.camera, look, prints, middle, prior)
        moved_px = _moved_px(self.camera, item.model.points_object, pose, corrected)
        if moved_px < LEAST_MOVED_PX:  # evidence would change nothing
            return Correction(corrected, moved_px, 0.0)
        gains = self._held_out_gains(look, prints, middle, prior)
        return Correction(corrected, moved_px, in_standard_errors(gains))

    def _held_out_gains(
        self, look: Look, prints: Sequence[Print], middle: Float64[np.ndarray, "3"], prior: Prior
    ) -> Float64[np.ndarray, " b"]:
        """By how much blocks of the print agree better at a pose that was found without them."""
        black = [are_black(blocks_of(one.points, edge_m=BLOCK_M)) for one in prints]
        gains = []
        for side in (True, False):
            fitted = [_part(one, b == side) for one, b in zip(prints, black, strict=True)]
            left_out = [_part(one, b != side) for one, b in zip(prints, black, strict=True)]
            found = align_print(self.camera, look, fitted, middle, prior)
            gains += [_gains(self.camera, look, one, prior.camera_from_object, found) for one in left_out]
        return np.concatenate(gains)


def frame_corrector(
    scene: Scene,
    trajectory: Trajectory,
    items: Sequence[SceneObject],
    frames: Sequence[Frame],
    read_depth: ReadDepth,
    read_grey: Callable[[Frame], GreyImage],
    *,
    tolerances: Tolerances | None = None,
    unproven: bool = False,
) -> FrameCorrector:
    """Prepare the correction of a scene's labels: choose the references and take their prints.

    Args:
        frames: all frames of the scene that are labelled.
        unproven: as in `FrameCorrector`.
    """
    camera, motion = PixelTable.of(scene.intrinsics), Motion.of(scene, trajectory)
    usable = [frame for frame in frames if frame.depth is not None]
    found = {}
    for item in items:
        sight = Sight(
            camera, motion, trajectory, Body.of(item), read_depth, read_grey, tolerances or Tolerances()
        )
        found[item.key] = settled(sight, choose_references(sight, usable), usable)
    return FrameCorrector(camera, motion, found, unproven)


def _gains(
    camera: PixelTable, look: Look, left_out: Print, before: Transform, after: Transform
) -> Float64[np.ndarray, " b"]:
    """By how much each left-out block disagrees less than before."""
    (first, second), seen = disagreements(camera, look, left_out, [before, after])
    return block_means(blocks_of(left_out.points[seen], edge_m=BLOCK_M), (first - second)[seen])


def _part(whole: Print, chosen: Bool[np.ndarray, " n"]) -> Print:
    return Print(whole.points[chosen], whole.brightness[:, chosen])


def _moved_px(camera: PixelTable, points_object: Points, before: Transform, after: Transform) -> float:
    steps = camera.project(transform(after, points_object)) - camera.project(transform(before, points_object))
    steps = steps[np.isfinite(steps).all(axis=1)]
    return float(np.sqrt((steps**2).sum(axis=1).mean())) if len(steps) else 0.0
