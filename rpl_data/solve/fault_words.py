"""Faults as sentences: what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpl_data.solve.trial import Explanation, Fault, Trial
from rpl_data.types import Click


def whole_scene_text(scene: str, clicks: int, *, known_model: bool) -> str:
    """What is said of a scene whose clicks contradict those of all others, or the model that is known."""
    others = "the model" if known_model else "those of the other scenes"
    return (
        f"scene {scene}: its {clicks} clicks contradict {others} as a whole; check that it "
        "shows the same object and that left and right are not exchanged, then mark it again"
    )


class FaultWords:
    """Faults as sentences, with the names and distances that they need."""

    def __init__(
        self, scenes: Sequence[str], keypoints: Sequence[str], clicks: Sequence[Click], mended: Trial
    ) -> None:
        self.scenes, self.keypoints, self.clicks, self.mended = scenes, keypoints, clicks, mended

    def of(self, fault: Fault) -> str:
        """One sentence: what, where, what to do."""
        if fault.rivals:
            return self._disagree(fault)
        kind = fault.best.kind
        if kind == "swapped":
            return self._swapped(fault.best)
        if kind == "wrong name":
            return self._wrong_name(fault.best)
        return self._whole_scene(fault.best) if kind == "whole scene" else self._wrong_place(fault.best)

    def _swapped(self, best: Explanation) -> str:
        a, b = (self.keypoints[k] for k in best.keypoints)
        return (
            f"scene {self.scenes[best.scene]}: keypoints {a} and {b} are swapped; "
            "each was clicked where the other one is: exchange them"
        )

    def _wrong_name(self, best: Explanation) -> str:
        own, meant = self.keypoints[best.keypoints[0]], self.keypoints[best.meant[0]]
        return (
            f"{self._where(best)}: keypoint {own} was clicked where keypoint {meant} is; move it to its place"
        )

    def _wrong_place(self, best: Explanation) -> str:
        name = self.keypoints[best.keypoints[0]]
        return (
            f"{self._where(best)}: keypoint {name} was clicked {self._distance_px(best):.0f} px away from "
            f"where {'the model and ' * self._known_model}all other clicks put it; move it to its place"
        )

    def _whole_scene(self, best: Explanation) -> str:
        if best.mirrored:
            return self._mirrored(best)
        return whole_scene_text(self.scenes[best.scene], len(best.clicks), known_model=self._known_model)

    def _mirrored(self, best: Explanation) -> str:
        others = "the model" if self._known_model else "those of the other scenes"
        return (
            f"scene {self.scenes[best.scene]}: its {len(best.clicks)} clicks contradict {others}, and fit "
            "as a mirror image; check that left and right are not exchanged, then mark it again"
        )

    @property
    def _known_model(self) -> bool:
        """The keypoints were not solved for, so there are no other scenes."""
        return self.mended.fit.hold_points

    def _disagree(self, fault: Fault) -> str:
        """That one of several is wrong; what to click to find out which."""
        everyone = (fault.best, *fault.rivals)
        names = sorted({k for e in everyone for k in e.keypoints})
        scenes = sorted({e.scene for e in everyone})
        if len(names) == 1:
            where = " and ".join(f"scene {self.scenes[s]}" for s in scenes)
            apart = f"{self._distance_px(fault.best):.0f} px"
            disagree = f"keypoint {self.keypoints[names[0]]}: its clicks in {where} disagree by {apart}"
            if self._known_model:
                return f"{disagree}, and nothing tells which is wrong; mark it in one more frame"
            if len(scenes) == 1:  # frames of one scene are tied by the camera's path alone
                doubt = "nothing tells which is wrong, or whether the camera's path strays there"
                return f"{disagree}, and {doubt}; mark it in one more frame, seen from another side"
            more = "mark it in a third scene, or in one more frame of each"
            return f"{disagree}, and nothing tells which is wrong; {more}"
        listed = "; ".join(f"scene {self.scenes[s]}: {self._names(everyone, s)}" for s in scenes)
        return (
            f"one of these keypoints was clicked in the wrong place, by about "
            f"{self._distance_px(fault.best):.0f} px, and nothing tells which ({listed}); look at them, and "
            f"mark one more keypoint of scene {self.scenes[fault.best.scene]}"
        )

    def _names(self, everyone: Sequence[Explanation], scene: int) -> str:
        """Keypoints of one scene."""
        numbers = {k for e in everyone if e.scene == scene for k in e.keypoints}
        return ", ".join(self.keypoints[k] for k in sorted(numbers))

    def _where(self, best: Explanation) -> str:
        frames = sorted({self.clicks[n].frame for n in best.clicks})
        word = "frame" if len(frames) == 1 else "frames"
        return f"scene {self.scenes[best.scene]}, {word} {', '.join(map(str, frames))}"

    def _distance_px(self, best: Explanation) -> float:
        """How far the clicks lie from their keypoints once all mistakes are undone."""
        return float(np.median(self.mended.miss_px(np.array(best.clicks))))
