"""What a person should do next, in one line and with the place to do it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rpl_data.annotate.live import FEWEST, Live
from rpl_data.annotate.settled import (
    OFTEN,
    contradictions,
    doubt,
    path_to_check,
    rarely_marked,
    settled,
    unsettled,
    weak_scenes,
)
from rpl_data.clicks.log import Annotation
from rpl_data.types.keypoint_names import keypoint_titles
from rpl_data.wording import counted

ENOUGH = FEWEST + 1
"""Clicks a scene: three place it, the fourth checks them."""
WORTH_MM, WORTH_SHARE = 0.4, 0.1
"""A further click that lowers the error by less, or by a smaller share of it, is not asked for."""
UNSURE_M = 0.004
"""A keypoint less certain than this wants another click, where it is what limits the labels."""


@dataclass(frozen=True)
class Advice:
    """The next step.

    Attributes:
        scene, frame, keypoint: where; None where it does not matter.
        action: what the page offers to do: `add` a keypoint, or make the `label`s.
        doubt: why the labels will be rough all the same; the page says so when they are made, too.
    """

    text: str
    scene: str | None = None
    frame: int | None = None
    keypoint: int | None = None
    action: Literal["add", "label"] | None = None
    doubt: str = ""


def next_step(
    annotation: Annotation,
    live: Live,
    scenes: Sequence[str],
    rough_px: Mapping[str, float] | None = None,
    judged: Collection[str] = (),
) -> Advice:
    """The first of: settle a contradiction, mark what is missing, check, sharpen, make the labels.

    Args:
        rough_px: expected error of the scenes whose labels will be rough.
        judged: scenes whose camera path was compared with their images.
    """
    if not annotation.keypoints:
        return Advice("name the object's keypoints: corners, screws, spouts", action="add")
    if live.check is not None:
        return Advice("checking the clicks against one another ...")
    return (
        _contradiction(annotation, live, judged)
        or _open_scene(annotation, live, scenes)
        or _unchecked(annotation, live)
        or _stray(annotation, live, judged)
        or _weak_scene(annotation, live)
        or _most_helpful(annotation, live)
        or _unsure(annotation, live)
        or _done(live, doubt(annotation, live, rough_px or {}))
    )


def _done(live: Live, doubtful: str) -> Advice:
    text = f"{settled(live, doubtful)}: make the dense model and the labels"
    return Advice(text, action="label", doubt=doubtful)


def _stray(annotation: Annotation, live: Live, judged: Collection[str]) -> Advice | None:
    """Where clicks were repeated and still disagree, a build looks whether the camera's path is why."""
    text = path_to_check(annotation, live, judged)
    return Advice(text, action="label", doubt=text.partition("; ")[0]) if text else None


def _contradiction(annotation: Annotation, live: Live, judged: Collection[str]) -> Advice | None:
    """Mend a click that is wrong; where only some disagree, mark one more to find out which of them is."""
    settled_not = unsettled(annotation, live)
    worst = next((s for s in contradictions(live) if s not in settled_not), None)
    if worst is None:
        return None
    click = next(iter(rarely_marked(annotation, worst)), worst.clicks[0])
    if worst.kind == "disagree":
        scene = _another_scene(annotation, live, click.keypoint)
        same = {c.keypoint for c in worst.clicks} == {click.keypoint}
        if same and scene is not None:
            return Advice(worst.text, scene, None, click.keypoint)
        if same and len({c.scene for c in worst.clicks}) == 1:
            return Advice(worst.text, click.scene, None, click.keypoint)
        return Advice(worst.text, click.scene, click.frame, click.keypoint)
    also = "; if it is right, mark it in another sharp frame (]) too" if len(worst.clicks) == 1 else ""
    if len(worst.clicks) > 1 and not {c.scene for c in worst.clicks} <= {*judged}:
        also = "; if all that is right, the camera's path may stray, which a build checks (Make all)"
    return Advice(worst.text + also, click.scene, click.frame, click.keypoint)


def _unchecked(annotation: Annotation, live: Live) -> Advice | None:
    """A keypoint that a wrong click would move unseen wants a second scene, or a second frame."""
    for statement in live.statements:
        if statement.kind == "unchecked":
            click = statement.clicks[0]
            scene = _another_scene(annotation, live, click.keypoint)
            return Advice(statement.text, scene or click.scene, None, click.keypoint)
    return None


def _weak_scene(annotation: Annotation, live: Live) -> Advice | None:
    """A scene that its clicks place badly wants one more of the keypoints that are open there."""
    for statement in weak_scenes(live):
        scene = statement.clicks[0].scene
        marked = {click.keypoint for click in annotation.clicks if click.scene == scene}
        for keypoint in range(len(annotation.keypoints)):
            if keypoint not in marked and (keypoint, scene) not in annotation.skipped:
                return Advice(statement.text, scene, None, keypoint)
    return None


def _another_scene(annotation: Annotation, live: Live, keypoint: int) -> str | None:
    """A placed scene in which the keypoint is neither marked nor skipped."""
    marked = {click.scene for click in annotation.clicks if click.keypoint == keypoint}
    return min(
        (s for s in live.placed if s not in marked and (keypoint, s) not in annotation.skipped), default=None
    )


def _open_scene(annotation: Annotation, live: Live, scenes: Sequence[str]) -> Advice | None:
    """The first scene in which a keypoint is wanted: to place the scene, or to know the keypoint."""
    seen_in: dict[int, set[str]] = {k: set() for k in range(len(annotation.keypoints))}
    for click in annotation.clicks:
        seen_in[click.keypoint].add(click.scene)
    known = {k for k, p in enumerate(annotation.known_points or ()) if p is not None}
    for scene in scenes:
        here = [k for k, seen in seen_in.items() if scene in seen]
        if not here and live.solution is not None and scene in live.solution.scene_from_object:
            continue  # `rpl register --auto` placed it without clicks
        open_ = [k for k in seen_in if k not in here and (k, scene) not in annotation.skipped]
        if known:
            wanted = [k for k in open_ if k in known] if len(here) < ENOUGH else []
        else:
            wanted = _wanted(scene, here, open_, seen_in, live)
        if wanted:
            return Advice(_asking(annotation, scene, here, wanted[0], live), scene, None, wanted[0])
        if scene in live.loose:
            return Advice(f"scene {scene}: {live.loose[scene]}", scene)
    return None


def _wanted(
    scene: str, here: Sequence[int], open_: Sequence[int], seen_in: dict[int, set[str]], live: Live
) -> list[int]:
    """Keypoints to mark in a scene: those that tie it to others first, then those seen in one scene only."""
    elsewhere = [k for k in open_ if seen_in[k]]
    placed = live.solution is not None and scene in live.solution.scene_from_object
    tied = placed and len(here) >= ENOUGH
    once = [k for k in open_ if len(seen_in[k]) < 2]
    return once if tied else (elsewhere or list(open_))


def _asking(annotation: Annotation, scene: str, here: Sequence[int], keypoint: int, live: Live) -> str:
    name, count = annotation.keypoints[keypoint], len(annotation.keypoints)
    title = keypoint_titles(annotation.keypoints)[keypoint]
    if not annotation.clicks:
        if not name.isdigit():
            return f"scene {scene}: click exactly on {name} of the {annotation.object}, keypoint {keypoint}"
        what = f"a corner or mark of the {annotation.object} that you will know again in every scene"
        return f"scene {scene}: click exactly on {what}; it becomes keypoint {name}"
    done = f"{len(here)} of {counted(count, 'keypoint')} clicked in this scene"
    if len(here) < FEWEST:
        done += f"; it needs at least {FEWEST}"
    elif scene in live.loose:
        done += f"; {live.loose[scene]}"
    absent = "" if here else ", or all where the object is not in this scene (Shift+S)"
    return f"scene {scene}: mark keypoint {title} ({done}). Not visible here? Skip it (S){absent}"


def _most_helpful(annotation: Annotation, live: Live) -> Advice | None:
    """The further click that lowers the expected error most, while it is worth the effort."""
    marked = Counter((click.keypoint, click.scene) for click in annotation.clicks)
    for best in live.solution.next_clicks if live.solution else ():
        if best.gain_mm < WORTH_MM:
            break
        if (best.keypoint, best.scene) in annotation.skipped or best.gain_mm < WORTH_SHARE * best.left_mm:
            continue
        if marked[best.keypoint, best.scene] >= OFTEN:
            continue
        name = keypoint_titles(annotation.keypoints)[best.keypoint]
        text = (
            f"scene {best.scene}, frame {best.frame}: mark keypoint {name} here; it should lower the error "
            f"by {best.gain_mm:.1f} mm on average, to {best.left_mm:.1f} mm in this scene; not visible? mark "
            "it in another frame, or skip it (S)"
        )
        return Advice(text, best.scene, best.frame, best.keypoint)
    return None


def _unsure(annotation: Annotation, live: Live) -> Advice | None:
    """The keypoint known worst, when another click would help much and there is a place for it."""
    if live.solution is None or annotation.known_points is not None:
        return None
    limit_m = max(UNSURE_M, 1e-3 * min(live.solution.expected_mm.values(), default=0.0))
    variances = np.trace(live.solution.covariance, axis1=1, axis2=2) / 3
    scenes = sorted(live.solution.scene_from_object)
    for k in np.argsort(-np.nan_to_num(variances)):
        keypoint, sigma_m = int(k), float(np.sqrt(np.nan_to_num(variances[k])))
        if sigma_m < limit_m:
            break
        clicked = [c.scene for c in annotation.clicks if c.keypoint == keypoint]
        visible = [scene for scene in scenes if (keypoint, scene) not in annotation.skipped]
        if not visible or len(clicked) >= OFTEN:
            continue
        title = keypoint_titles(annotation.keypoints)[keypoint]
        distance_mm = 1e3 * np.sqrt(3) * sigma_m  # as the page states it everywhere
        known = f"keypoint {title} is known to ±{distance_mm:.0f} mm only"
        text = f"{known}: mark it in one more frame, seen from another side"
        return Advice(text, min(visible, key=clicked.count), None, keypoint)
    return None
