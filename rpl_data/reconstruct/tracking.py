"""A recording without poses -> where the camera was: every frame against a model of the frames before it.

A frame is predicted from the two before it, aligned to the keyframe with the most similar view
(`alignment`: brightness and depth), and where that does not say enough also to the Gaussians of all
keyframes (`model_map`: VGICP). A frame that looks at something new becomes a keyframe. A fit that does
not hold is tried again from where the frame's corners say the camera is (`relocalise`); when that fails
too the frame is lost, and the next one is tried from the last good pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rpl_data.geometry import Transform
from rpl_data.reconstruct.alignment import Fit, align
from rpl_data.reconstruct.information import Estimate, motion_between, moved, size_m, weakest_sigma_m
from rpl_data.reconstruct.model_map import Keyframe, ModelMap
from rpl_data.reconstruct.relocalise import keyframe_from_camera, landmarks_of
from rpl_data.reconstruct.view import View, Viewer
from rpl_data.types import DepthImage, Frame, GreyImage, Scene

KEYFRAME_M = 0.08
"""A view this far from that of every keyframe becomes one; a turn counts by its arc (`LEVER_M`)."""

PREDICTED = np.diag([10.0**2] * 3 + [20.0**2] * 3)
"""How well a frame is predicted: 0.1 rad and 5 cm."""

SURE_M = 0.002
"""Alignment to a keyframe that is less sure than this asks the map, too."""

KNOWN_M = 0.02
"""A pose that is less sure than this is not known."""

UNREGISTERED_TRUST = 0.01
"""Weight of brightness where depth does not lie on the pixels of the colour image."""

LEAST_SEEN, LEAST_AGREEING, LEAST_CORRELATION = 0.25, 0.7, 0.85
"""What a fit that holds reaches at least (`Fit`). Right ones on real recordings reached 0.77, 0.73 and 0.89;
wrong ones that looked good 0.8, 0.75 and 0.84."""

DOUBTFUL = 3.0
"""A fit whose correlation lacks this many times more of 1 than usual may be wrong: others are tried."""

LEAST_DEPTH = 0.05
"""Share of pixels with depth below which there is nothing to align."""

SEARCHED = 8
"""Keyframes looked through for a lost camera, a frame: the nearest ones, and others by turns."""


@dataclass(frozen=True)
class Tracked:
    """What became of a frame: its pose, or None when it was lost."""

    frame: Frame
    scene_from_camera: Transform | None


def track(scene: Scene, images: Iterable[tuple[Frame, GreyImage, DepthImage]]) -> Iterator[Tracked]:
    """Poses of the frames, in order; the first frame that shows something is where the scene's frame is.

    Memory grows with what the camera sees, not with the number of frames.

    Args:
        images: frames in the order of time, their brightness at `1 / view.REDUCE` of the size, their depth
            at the full size.
    """
    viewer = Viewer(scene.intrinsics)
    tracker = Tracker(color_trust=1.0 if scene.registered else UNREGISTERED_TRUST)
    for frame, grey, depth_m in images:
        yield Tracked(frame, tracker.step(frame, viewer.look(grey, depth_m)))


class Tracker:
    """The model and the motion of the camera, as far as it has been followed."""

    def __init__(self, *, color_trust: float) -> None:
        self._color_trust = color_trust
        self._map = ModelMap()
        self._pose: Transform = np.eye(4)
        self._velocity = np.zeros(6)
        self._time_s = 0.0
        self._turn = 0
        self._unlike = 0.02  # as it usually is here

    @property
    def keyframes(self) -> Sequence[Keyframe]:
        """The keyframes so far."""
        return self._map.keyframes

    def step(self, frame: Frame, view: View) -> Transform | None:
        """`scene_from_camera` of the next frame; None when it is lost."""
        if np.count_nonzero(view.levels[0].depth_m) < LEAST_DEPTH * view.levels[0].depth_m.size:
            self._velocity[:] = 0
            return None
        if not self._map.keyframes:
            self._map.add(frame.index, view, self._pose)
            self._time_s = frame.timestamp_s
            return self._pose
        elapsed_s = max(frame.timestamp_s - self._time_s, 1e-3)
        fit = self._follow(view, elapsed_s)
        if fit is None:
            self._velocity[:] = 0  # after a gap the last pose is a better guess than a long extrapolation
            return None
        pose = fit.estimate.scene_from_camera
        self._velocity = motion_between(self._pose, pose) / elapsed_s
        self._pose, self._time_s = pose, frame.timestamp_s
        if self._map.by_distance(pose)[0][0] > KEYFRAME_M:
            self._map.add(frame.index, view, pose)
        return pose

    def _follow(self, view: View, elapsed_s: float) -> Fit | None:
        """The first fit that holds and is as good as usual, else the best that holds."""
        best: Fit | None = None
        for number, guess in enumerate(self._guesses(view, elapsed_s)):
            if best is not None and number > SEARCHED // 2:
                break
            fit = self._fit(view, guess)
            if self._doubtful(fit) and holds(fit):  # it may have stopped on the way
                fit = self._fit(view, fit.estimate.scene_from_camera)
            if holds(fit) and (best is None or unlike(fit) < unlike(best)):
                best = fit
            if best is not None and not self._doubtful(best):
                break
        if best is not None:
            self._unlike += 0.1 * (unlike(best) - self._unlike)
        return best

    def _doubtful(self, fit: Fit) -> bool:
        return unlike(fit) > DOUBTFUL * self._unlike

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
        """Half of them near the last pose, half others, so that all get their turn while it is lost."""
        ordered = [keyframe for _, keyframe in self._map.by_distance(self._pose)]
        near, others = ordered[: SEARCHED // 2], ordered[SEARCHED // 2 :]
        self._turn += SEARCHED // 2
        start = self._turn % max(len(others), 1)
        return near + (others[start:] + others[:start])[: SEARCHED // 2]

    def _fit(self, view: View, guess: Transform) -> Fit:
        """Align coarsely, then finely, with the map where the keyframe alone is not enough."""
        keyframe = self._map.by_distance(guess)[0][1]
        prior = Estimate(guess, PREDICTED)
        trust = self._color_trust
        fit = align(view, keyframe, guess, prior, levels=(2, 1))  # a shift of depth is small at these sizes
        near = fit.estimate.scene_from_camera
        if size_m(motion_between(guess, near)) > KEYFRAME_M:
            keyframe = self._map.by_distance(near)[0][1]
        if trust == 1.0:
            fit = align(view, keyframe, near, prior, levels=(0,))
        if trust == 1.0 and weakest_sigma_m(fit.estimate.information - PREDICTED) < SURE_M:
            return fit
        known = self._map.align(view, fit.estimate.scene_from_camera)
        return align(view, keyframe, known.scene_from_camera, known, levels=(0,), color_trust=trust)


def unlike(fit: Fit) -> float:
    """What the correlation of brightness lacks of 1; 0 where there is nothing to see."""
    return 0.0 if np.isnan(fit.correlation) else 1 - fit.correlation


def holds(fit: Fit) -> bool:
    """Whether a fit is the truth: most of what both frames see is equally far and equally bright."""
    alike = unlike(fit) < 1 - LEAST_CORRELATION
    known = weakest_sigma_m(fit.estimate.information - PREDICTED) < KNOWN_M
    return fit.seen > LEAST_SEEN and fit.agreeing > LEAST_AGREEING and alike and known
