"""Track the camera through a recording without poses, frame by frame.

The pose of a frame is predicted from the two frames before it. The frame is then aligned to the keyframe with
the most similar view (`alignment`: brightness and depth), and, where that leaves the pose uncertain, to the
Gaussians of all keyframes (`model_map`: VGICP). A frame with a new view becomes a keyframe. A fit that does
not hold is tried again from the pose that the frame's corners give (`relocalise`). When that fails too, the
frame is lost, and the next one starts from the last good pose. At the end the lost frames are tried again,
since later keyframes may show what they see.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from rpl_data.geometry import Transform
from rpl_data.reconstruct.alignment import PLAIN, Fit, align, approach
from rpl_data.reconstruct.information import Estimate, motion_between, moved, size_m, weakest_sigma_m
from rpl_data.reconstruct.model_map import Keyframe, ModelMap
from rpl_data.reconstruct.relocalise import keyframe_from_camera, landmarks_of
from rpl_data.reconstruct.view import View, Viewer
from rpl_data.types import DepthImage, Frame, GreyImage, Scene

KEYFRAME_M = 0.08
"""A frame becomes a keyframe when it is at least this far from every keyframe, in `size_m`."""

PREDICTED = np.diag([10.0**2] * 3 + [20.0**2] * 3)
"""Information of the predicted pose: 0.1 rad and 5 cm."""

SURE_M = 0.005
"""A pose with a larger standard deviation than this is aligned to the map as well."""

KNOWN_M = 0.02
"""A fit with a larger standard deviation than this does not hold."""

UNREGISTERED_TRUST = 0.01
"""Weight of brightness where depth is not registered to colour."""

LEAST_SEEN, LEAST_AGREEING, LEAST_CORRELATION = 0.25, 0.7, 0.85
"""Smallest values of `Fit.seen`, `agreeing` and `correlation` with which a fit holds. On real recordings,
right fits had at least 0.77, 0.73 and 0.89; wrong fits had at most 0.8, 0.75 and 0.84."""

DOUBTFUL = 3.0
"""A fit is doubtful when its dissimilarity (1 - correlation of brightness) is this many times its running
mean; other starting poses are then tried."""

LEAST_DEPTH = 0.05
"""A frame with a smaller share of pixels with depth than this is lost."""

SEARCHED = 8
"""Keyframes tried per frame when the camera is lost: the nearest, and a few others in rotation."""


PASSES = 3
"""Largest number of times that the lost frames are tried again."""

Look = Callable[[Frame], tuple[GreyImage, DepthImage]]


class Loss(Enum):
    """Why a frame was lost, as a clause about the frame."""

    NO_DEPTH = "has hardly any depth"
    DARK = "has an image without contrast"
    PLAIN = "shows neither edges nor shapes that would fix the camera"
    UNLIKE = "is blurred or shows too little of what the tracked frames show"


@dataclass(frozen=True)
class Tracked:
    """A frame and its pose; where the frame was lost, None and the reason."""

    frame: Frame
    scene_from_camera: Transform | None
    loss: Loss | None = None


def track(
    scene: Scene, images: Iterable[tuple[Frame, GreyImage, DepthImage]], *, again: Look | None = None
) -> Iterator[Tracked]:
    """Track the frames in order; the first frame that another can be tracked from defines the scene frame.

    Memory grows with what the camera sees, not with the number of frames.

    Args:
        images: frames in the order of time, with their brightness at `1 / view.REDUCE` of the size and their
            depth at full size.
        again: reads the images of a frame again. With it, lost frames are tried again at the end, and those
            found are yielded a second time; of a frame that is yielded twice, the last word counts.
    """
    viewer = Viewer(scene.intrinsics)
    trust = 1.0 if scene.registered else UNREGISTERED_TRUST
    tracker = Tracker(color_trust=trust)
    found: dict[int, Transform] = {}
    lost: list[Frame] = []
    start: Frame | None = None
    for frame, grey, depth_m in images:
        view = viewer.look(grey, depth_m)
        result = tracker.step(frame, view)
        if start is not None and len(found) == 1 and result.loss is Loss.UNLIKE:
            yield Tracked(start, None, Loss.UNLIKE)  # nothing follows from the start: start here
            lost.append(start)
            found.clear()
            tracker = Tracker(color_trust=trust)
            result = tracker.step(frame, view)
        if result.scene_from_camera is not None and not found:
            start = frame
        yield result
        if result.scene_from_camera is not None:
            found[frame.index] = result.scene_from_camera
        elif result.loss is not Loss.NO_DEPTH:
            lost.append(frame)
    if again is None or not found:
        return
    for _ in range(PASSES):
        still: list[Frame] = []
        for frame in lost:
            nearest = min(found, key=lambda index: abs(index - frame.index))
            result = tracker.find(frame, viewer.look(*again(frame)), near=found[nearest])
            if result.scene_from_camera is None:
                still.append(frame)
            else:
                found[frame.index] = result.scene_from_camera
                yield result
        if len(still) == len(lost):
            return
        lost = still


class Tracker:
    """The state of tracking: the map so far, and the last pose and velocity of the camera."""

    def __init__(self, *, color_trust: float) -> None:
        self._color_trust = color_trust
        self._map = ModelMap()
        self._pose: Transform = np.eye(4)
        self._velocity = np.zeros(6)
        self._time_s = 0.0
        self._turn = 0
        self._usual_dissimilarity = 0.02  # running mean

    @property
    def keyframes(self) -> Sequence[Keyframe]:
        """The keyframes so far."""
        return self._map.keyframes

    def step(self, frame: Frame, view: View) -> Tracked:
        """Track the next frame: its `scene_from_camera`, or why it is lost."""
        if np.count_nonzero(view.levels[0].depth_m) < LEAST_DEPTH * view.levels[0].depth_m.size:
            self._velocity[:] = 0
            return Tracked(frame, None, Loss.NO_DEPTH)
        if not self._map.keyframes:
            self._map.add(frame.index, view, self._pose)
            self._time_s = frame.timestamp_s
            return Tracked(frame, self._pose)
        elapsed_s = max(frame.timestamp_s - self._time_s, 1e-3)
        fit, loss = self._follow(view, elapsed_s)
        if fit is None:
            self._velocity[:] = 0  # after a gap the last pose is a better guess than a long extrapolation
            return Tracked(frame, None, loss)
        pose = fit.estimate.scene_from_camera
        self._velocity = motion_between(self._pose, pose) / elapsed_s
        self._pose, self._time_s = pose, frame.timestamp_s
        if self._map.by_distance(pose)[0][0] > KEYFRAME_M:
            self._map.add(frame.index, view, pose)
        return Tracked(frame, pose)

    def find(self, frame: Frame, view: View, *, near: Transform) -> Tracked:
        """Track a lost frame again with all that is now known.

        Args:
            near: a pose that may be near its own.
        """
        self._pose, self._time_s, self._velocity = near, frame.timestamp_s, np.zeros(6)
        return self.step(frame, view)

    def _follow(self, view: View, elapsed_s: float) -> tuple[Fit | None, Loss | None]:
        """The first fit that holds and is not doubtful, else the best one that holds, else why none does."""
        best: Fit | None = None
        nearly: Fit | None = None
        for number, guess in enumerate(self._guesses(view, elapsed_s)):
            if best is not None and number > SEARCHED // 2:
                break
            fit = self._fit(view, guess)
            if self._doubtful(fit) and holds(fit):  # the iteration may have stopped too early
                fit = self._fit(view, fit.estimate.scene_from_camera)
            if holds(fit) and (best is None or dissimilarity(fit) < dissimilarity(best)):
                best = fit
            if nearly is None or fit.seen * fit.agreeing > nearly.seen * nearly.agreeing:
                nearly = fit
            if best is not None and not self._doubtful(best):
                break
        if best is not None:
            self._usual_dissimilarity += 0.1 * (dissimilarity(best) - self._usual_dissimilarity)
            return best, None
        if view.levels[0].grey.std() < PLAIN:
            return None, Loss.DARK
        return None, Loss.PLAIN if nearly is not None and fits(nearly) else Loss.UNLIKE

    def _doubtful(self, fit: Fit) -> bool:
        return dissimilarity(fit) > DOUBTFUL * self._usual_dissimilarity

    def _guesses(self, view: View, elapsed_s: float) -> Iterator[Transform]:
        yield self._pose @ moved(self._velocity * elapsed_s)
        if self._velocity.any():
            yield self._pose
        corners = landmarks_of(view.levels[0])
        for keyframe in self._candidates():
            found = keyframe_from_camera(view.levels[0], corners, keyframe.landmarks)
            if found is not None:
                yield keyframe.scene_from_camera @ found

    def _candidates(self) -> list[Keyframe]:
        """Keyframes to relocalise at: half are nearest to the last pose, half rotate through all others."""
        ordered = [keyframe for _, keyframe in self._map.by_distance(self._pose)]
        near, others = ordered[: SEARCHED // 2], ordered[SEARCHED // 2 :]
        self._turn += SEARCHED // 2
        start = self._turn % max(len(others), 1)
        return near + (others[start:] + others[:start])[: SEARCHED // 2]

    def _fit(self, view: View, guess: Transform) -> Fit:
        """Align coarsely, then finely; use the map where the keyframe alone leaves the pose uncertain."""
        keyframe = self._map.by_distance(guess)[0][1]
        prior = Estimate(guess, PREDICTED)
        trust = self._color_trust
        near = approach(view, keyframe, guess, prior)
        if size_m(motion_between(guess, near)) > KEYFRAME_M:
            keyframe = self._map.by_distance(near)[0][1]
        fit = align(view, keyframe, near, prior, color_trust=trust)
        if weakest_sigma_m(fit.estimate.information - PREDICTED) < SURE_M:
            return fit
        known = self._map.align(view, fit.estimate.scene_from_camera)
        # The map may know nothing, or not how the camera slides along a plane: the prediction still holds.
        known = Estimate(known.scene_from_camera, known.information + PREDICTED)
        return align(view, keyframe, known.scene_from_camera, known, color_trust=trust)


def dissimilarity(fit: Fit) -> float:
    """1 - correlation of brightness; 0 where brightness is too uniform to correlate."""
    return 0.0 if np.isnan(fit.correlation) else 1 - fit.correlation


def fits(fit: Fit) -> bool:
    """Whether most of what both frames see agrees in depth and brightness."""
    alike = dissimilarity(fit) < 1 - LEAST_CORRELATION
    return fit.seen > LEAST_SEEN and fit.agreeing > LEAST_AGREEING and alike


def holds(fit: Fit) -> bool:
    """Whether a fit can be trusted: the frames agree, and that leaves no motion open."""
    return fits(fit) and weakest_sigma_m(fit.estimate.information - PREDICTED) < KNOWN_M
