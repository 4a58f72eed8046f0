"""Votes of given masks on the surface: what is seen mostly outside them is not the object.

Masks of another program may be wrong, in single frames or all over: pixels near an outline have no vote, and
a frame whose mask contradicts what the others agree on is left out and named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int8, Int64
from scipy.spatial import cKDTree

from rpl_data.geometry import NEAREST_M, Points, project, transform
from rpl_data.meshes import joined, select
from rpl_data.segment.free_space import DepthView
from rpl_data.types import PointCloud
from rpl_data.wording import counted

OUTLINE_PX = 5
"""Pixels this near to an outline do not vote: masks, poses and depth are off by some there."""
SEEN_M = 0.01
"""A point is seen where the depth image measures a surface within this of it."""
LEAST_VOTES = 2
"""A single frame decides nothing."""
LEAST_AGREEMENT = 0.5
"""Share of the object's points, and of the others, that a frame must call so to be believed."""
LEAST_FRAMES = 3
"""With fewer, none can be out-voted."""


@dataclass(frozen=True)
class MaskView:
    """A given mask, and the depth image of its frame.

    Attributes:
        frame: number of the frame, for messages.
        mask: True on the object.
    """

    frame: int
    view: DepthView
    mask: Bool[np.ndarray, "height width"]


@dataclass(frozen=True)
class Verdict:
    """What the masks of a scene say about points.

    Attributes:
        inside, outside: points that most frames which see them call the object, or not; others are open.
        hardly_seen: points that too few frames see to decide.
        wrong_frames: frames that contradict what the others agree on; they were not counted.
    """

    inside: Bool[np.ndarray, " n"]
    outside: Bool[np.ndarray, " n"]
    hardly_seen: Bool[np.ndarray, " n"]
    wrong_frames: tuple[int, ...]


def regions_by_masks(
    grown: Mapping[str, PointCloud],
    above: Mapping[str, PointCloud],
    views: Sequence[MaskView],
    keypoints: Points,
) -> tuple[dict[str, PointCloud], list[str]]:
    """Take from the regions what the masks deny, and add what they claim; also returns lines for the user.

    Args:
        grown: the regions grown from the keypoints, by scene.
        above: all points of the scenes that are not on what the object stands on.
        views: masks of any of these scenes; a scene without any keeps its region.
    """
    regions, lines = dict(grown), []
    for scene in grown:
        own = [each for each in views if each.view.scene == scene]
        if not own:
            continue
        count = len(grown[scene].points)
        both = joined([grown[scene], above[scene]])
        found = mask_verdict(both.points, own, keypoints)
        if isinstance(found, str):
            lines.append(f"scene {scene}: {found}")
            continue
        region = np.arange(len(both.points)) < count
        denied = found.outside | _beside_denied(both.points, region, found)
        regions[scene] = select(both, (region & ~denied) | (~region & found.inside))
        if found.wrong_frames:
            lines.append(
                f"scene {scene}: the given masks of {counted(len(found.wrong_frames), 'frame')} are "
                f"out-voted by the others and not used: {', '.join(map(str, found.wrong_frames))}"
            )
    return {scene: region for scene, region in regions.items() if len(region.points)}, lines


def mask_verdict(
    points: Points, views: Sequence[MaskView], keypoints: Float64[np.ndarray, "k 3"]
) -> Verdict | str:
    """Let the masks of one scene vote on points of its surface.

    Args:
        points: object frame.
        keypoints: points that are on the object for certain; where the masks deny most of those that they
            judge, they are of another object or of another place.

    Returns:
        The verdict, or why the masks cannot be used.
    """
    looks = [_seen_at(points, view) for view in views]
    votes = np.array([_votes(look, view) for look, view in zip(looks, views, strict=True)])
    believed = np.ones(len(views), bool)
    for _ in range(2):  # A wrong frame spoils what the others agree on a little; without it they agree better
        consensus = np.sign(votes[believed].sum(axis=0, dtype=np.int64))
        believed = np.array([_agrees(vote, consensus) for vote in votes], dtype=bool)
    wrong = tuple(view.frame for view, good in zip(views, believed, strict=True) if not good)
    if believed.sum() < LEAST_FRAMES or believed.sum() <= len(views) / 2:
        return (
            f"given masks are not used: those of {counted(len(wrong), 'frame')} of {len(views)} contradict "
            "the rest, so none can be believed"
        )
    if not (votes[believed].sum(axis=0) > 0).any():
        return "given masks are not used: they agree on no part of the surface as the object"
    on_object = np.array([_votes(_seen_at(keypoints, view), view) for view in views])[believed].sum(axis=0)
    if (on_object < 0).sum() > (on_object > 0).sum():
        return "given masks are not used: most clicked keypoints lie outside them; say which object they show"
    total = votes[believed].sum(axis=0)
    for_, against = (votes[believed] > 0).sum(axis=0), (votes[believed] < 0).sum(axis=0)
    seen = np.array([look.seen for look in looks])[believed].sum(axis=0)
    return Verdict(
        inside=(total > 0) & (for_ >= LEAST_VOTES),
        outside=(total < 0) & (against >= LEAST_VOTES),
        hardly_seen=seen < LEAST_VOTES,
        wrong_frames=wrong,
    )


def _beside_denied(points: Points, region: Bool[np.ndarray, " n"], found: Verdict) -> Bool[np.ndarray, " n"]:
    """Points of a region that hardly a frame sees, where the nearest that is judged is denied."""
    asked, judged = region & found.hardly_seen, region & (found.inside | found.outside)
    denied = np.zeros(len(points), bool)
    if asked.any() and judged.any():
        nearest = cKDTree(points[judged]).query(points[asked])[1]
        denied[asked] = found.outside[judged][nearest]
    return denied


@dataclass(frozen=True)
class _Look:
    """Where a frame sees points.

    Attributes:
        seen: points that its depth image measures.
        rows, columns: pixels of those.
    """

    seen: Bool[np.ndarray, " n"]
    rows: Int64[np.ndarray, " m"]
    columns: Int64[np.ndarray, " m"]


def _seen_at(points: Points, view: MaskView) -> _Look:
    in_camera = transform(view.view.camera_from_object, points)
    ahead = np.flatnonzero(in_camera[:, 2] > NEAREST_M)
    pixel = np.round(project(view.view.intrinsics, in_camera[ahead])).astype(np.int64)
    height, width = view.mask.shape
    within = ((pixel >= 0) & (pixel < [width, height])).all(axis=1)
    ahead, (u, v) = ahead[within], pixel[within].T
    measured_m = view.view.depth_m[v, u]
    agrees = (measured_m > 0) & (np.abs(measured_m - in_camera[ahead, 2]) < SEEN_M)
    seen = np.zeros(len(points), bool)
    seen[ahead[agrees]] = True
    return _Look(seen, v[agrees], u[agrees])


def _votes(look: _Look, view: MaskView) -> Int8[np.ndarray, " n"]:
    """1 for points seen inside the mask, -1 outside, 0 near its outline and where the point is not seen."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * OUTLINE_PX + 1,) * 2)
    mask = view.mask.astype(np.uint8)
    sides = cv2.erode(mask, kernel, borderValue=1).astype(np.int8) - (1 - cv2.dilate(mask, kernel))
    votes = np.zeros(len(look.seen), np.int8)
    votes[look.seen] = sides[look.rows, look.columns]
    return votes


def _agrees(vote: Int8[np.ndarray, " n"], consensus: Int64[np.ndarray, " n"]) -> bool:
    """Whether a frame calls most points of either side as the others do; a frame that judges none agrees."""
    for side in (1, -1):
        judged = vote[(consensus == side) & (vote != 0)]
        if len(judged) and (judged == side).mean() < LEAST_AGREEMENT:
            return False
    return True
