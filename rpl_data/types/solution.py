"""What is solved from clicks: the model, its pose in each scene, and what is wrong with the clicks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float64

from rpl_data.types.clicks import Click


@dataclass(frozen=True)
class KeypointModel:
    """The sparse model Q of an object.

    Attributes:
        name: the object's name.
        keypoints: names, in order.
        points_object: one row per keypoint, metres, object frame; NaN where it was never clicked.
        skeleton: pairs of keypoint numbers to draw a line between.
    """

    name: str
    keypoints: tuple[str, ...]
    points_object: Float64[np.ndarray, "k 3"]
    skeleton: tuple[tuple[int, int], ...] = ()

    @property
    def known(self) -> np.ndarray:
        """Which keypoints have a position; bool, shape (k,)."""
        known: np.ndarray = np.isfinite(self.points_object).all(axis=1)
        return known


DepthState = Literal["agrees", "other surface", "rejected", "none"]
"""What was decided about a click's depth: the candidate at the click agrees; another candidate of the
neighbourhood was chosen; none of the candidates fits; there was no candidate."""


@dataclass(frozen=True)
class ClickResidual:
    """How well the solution explains one click.

    Attributes:
        error_px: distance of the click from the projected keypoint.
        error_m: distance of the keypoint from the lifted click; None when no depth was used.
        depth_m: the chosen depth; None where none of the candidates fits.
        outlier: whether the click itself, not only its depth, is wrong.
        reason: one line for the user, also for a click that may be the wrong one of several; empty when all
            is well.
    """

    click: Click
    error_px: float
    error_m: float | None
    depth_m: float | None
    depth_state: DepthState
    outlier: bool = False
    reason: str = ""


PlacedHow = Literal["clicks", "aligned", "automatic"]

StatementKind = Literal[
    "swapped", "wrong name", "wrong place", "disagree", "whole scene", "everything", "unchecked",
    "weak scene", "unjudged",
]  # fmt: skip
"""What is wrong with clicks: two keypoints of a scene exchanged; a keypoint marked where another one is;
marked somewhere else; clicks of which one is wrong and nothing tells which; a scene that contradicts all
others; so many contradictions that none can be trusted; a click that no other click checks; a scene that
its clicks place badly; clicks that would hardly be contradicted if they were wrong."""
HINTS: tuple[StatementKind, ...] = ("unchecked", "weak scene", "unjudged")
"""What is said of clicks that are missing; the others are about clicks that may be wrong."""


@dataclass(frozen=True)
class Statement:
    """What clicks say about one another, for a person.

    Attributes:
        clicks: the wrong ones; for `disagree`, all those of which one is wrong.
        text: one line: what is wrong, where, and what to do.
        evidence: fall of the squared error, in units of the click noise, when the mistake is undone.
    """

    kind: StatementKind
    clicks: tuple[Click, ...]
    text: str
    evidence: float = 0.0

    @property
    def blames(self) -> bool:
        """Whether these very clicks are wrong, not only one among them."""
        return self.kind in ("swapped", "wrong name", "wrong place", "whole scene")


@dataclass(frozen=True)
class NextClick:
    """A further click and what it should bring.

    Attributes:
        gain_mm: by how much the expected error falls, mean over all scenes and keypoints.
        left_mm: the expected error of this scene's keypoints afterwards, mean.
    """

    scene: str
    frame: int
    keypoint: int
    gain_mm: float
    left_mm: float


@dataclass(frozen=True)
class Placement:
    """Where `rpl register` placed a known object in one more scene; the model was not changed by it.

    Attributes:
        scene_from_object: of the model whose keypoints are `points_object`.
        points_object: one row per keypoint, metres, object frame; NaN where the model had none.
        covariance_in_scene: one 3x3 covariance per keypoint of its position, in m^2, scene frame.
        residuals: one per click in the scene; the placement holds as long as these are the scene's clicks.
        path_key: stands for the camera poses of the scene; the placement holds as long as they are these.
        trajectory_sigma_m: how far these poses stray, which the covariance includes.
        statements, next_clicks: of the clicks in the scene; see `Solution`.
        how: by its clicks alone; aligned to the scene's surface and colours, from its clicks; or
            automatically, with one click or none.
        checked: what speaks for it, one line for a person.
    """

    scene_from_object: Float64[np.ndarray, "4 4"]
    points_object: Float64[np.ndarray, "k 3"]
    covariance_in_scene: Float64[np.ndarray, "k 3 3"]
    residuals: tuple[ClickResidual, ...]
    how: PlacedHow
    checked: str
    path_key: str
    trajectory_sigma_m: float = 0.0
    statements: tuple[Statement, ...] = ()
    next_clicks: tuple[NextClick, ...] = ()


def expected_mm(covariance_in_scene: Float64[np.ndarray, "k 3 3"]) -> float:
    """Root mean square error of the keypoints in space; NaN rows, of unknown keypoints, do not count."""
    return 1e3 * float(np.sqrt(np.nanmean(np.trace(covariance_in_scene, axis1=1, axis2=2))))


@dataclass(frozen=True)
class Solution:
    """The solution of Eq. 2: the sparse model and the object's pose in every scene.

    Attributes:
        model: the sparse model in the object frame (centroid of the keypoints, axes of the first
            scene).
        covariance: one 3x3 covariance per keypoint, in m^2, in the object frame: how well the shape is
            known. NaN where the keypoint was never clicked.
        scene_from_object: one rigid transform per scene, by scene name. The paper's T_s.
        residuals: one per click, in the order of the clicks.
        warnings: lines for the user.
        covariance_in_scene: one 3x3 covariance per keypoint of its position in each scene, in m^2, in that
            scene's frame: shape and pose together, so it is what a label can be off by. A scene is absent
            in solutions written before this was computed.
        click_sigma_px: standard deviation of a click per axis, estimated from the residuals; None when
            it was not.
        depth_sigma_ratio: by how much the errors of the depths exceed what was stated for them; None
            when it was not estimated.
        statements: which clicks contradict the others or are checked by none, the worst first.
        next_clicks: further clicks in frames that have some, the most useful first.
        trajectory_sigma_m: how far the poses of each scene stray, standard deviation per axis, which
            `covariance_in_scene` includes; absent = 0.
        one_side: numbers of the keypoints that all clicks see from one side: how far away they are, the depth
            camera alone tells (`solve.one_side`).
        checked: whether its clicks were checked against one another; the paper's way (SLSQP) has no check.
    """

    model: KeypointModel
    covariance: Float64[np.ndarray, "k 3 3"]
    scene_from_object: Mapping[str, Float64[np.ndarray, "4 4"]]
    residuals: tuple[ClickResidual, ...] = ()
    warnings: tuple[str, ...] = ()
    covariance_in_scene: Mapping[str, Float64[np.ndarray, "k 3 3"]] = field(default_factory=dict)
    click_sigma_px: float | None = None
    depth_sigma_ratio: float | None = None
    statements: tuple[Statement, ...] = ()
    next_clicks: tuple[NextClick, ...] = ()
    trajectory_sigma_m: Mapping[str, float] = field(default_factory=dict)
    one_side: tuple[int, ...] = ()
    checked: bool = True

    @property
    def expected_mm(self) -> dict[str, float]:
        """Expected error of the keypoints in each scene, in space: root mean square over the keypoints."""
        return {name: expected_mm(found) for name, found in self.covariance_in_scene.items()}

    def covariance_at(self, scene: str) -> Float64[np.ndarray, "k 3 3"]:
        """Covariance of each keypoint's position in that scene, in m^2, along the axes of the object frame.

        Where it was not computed, that of the shape alone.
        """
        found = self.covariance_in_scene.get(scene)
        if found is None:
            return self.covariance
        turn = self.scene_from_object[scene][:3, :3]
        turned: Float64[np.ndarray, "k 3 3"] = turn.T @ found @ turn
        return turned
