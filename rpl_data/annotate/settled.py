"""What can be said once no further click helps: whether the path explains contradictions, what is rough."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping

from rpl_data.annotate.live import Live
from rpl_data.clicks.log import Annotation
from rpl_data.types import HINTS, Click, Statement
from rpl_data.types.keypoint_names import keypoint_titles
from rpl_data.wording import counted

OFTEN = 4
"""Frames in which a keypoint was marked, after which one more frame lowers its error by a tenth at most
(1 - sqrt(4/5)), and its clicks were repeated often enough that a slip of the hand stands out."""


def contradictions(live: Live) -> list[Statement]:
    """What is said of clicks that may be wrong, the strongest first."""
    return [s for s in live.statements if s.kind not in HINTS]


def weak_scenes(live: Live) -> list[Statement]:
    """What is said of scenes that their clicks place badly."""
    return [s for s in live.statements if s.kind == "weak scene"]


def rarely_marked(annotation: Annotation, statement: Statement) -> list[Click]:
    """The clicks of a statement whose keypoint was not marked `OFTEN` in their scene."""
    frames = Counter((c.keypoint, c.scene) for c in annotation.clicks)
    return [c for c in statement.clicks if frames[c.keypoint, c.scene] < OFTEN]


def unsettled(annotation: Annotation, live: Live) -> list[Statement]:
    """Contradictions that stay although each of their keypoints was marked often: clicks do not settle them.

    The person has repeated these clicks as asked. Either one is a slip that was looked at and left, or the
    frames are where the camera's path does not say: the clicks cannot tell, the images can.
    """
    return [
        said
        for said in contradictions(live)
        if said.kind in ("disagree", "wrong place") and not rarely_marked(annotation, said)
    ]


def without_advice(statement: Statement) -> str:
    """What is wrong and where, without what to do about it, which comes last."""
    return statement.text.rpartition("; ")[0] or statement.text


def path_to_check(annotation: Annotation, live: Live, judged: Collection[str]) -> str:
    """That the camera's path may explain a contradiction, while no build has compared it with the images.

    Args:
        judged: scenes whose camera path was compared with their images.
    """
    for said in unsettled(annotation, live):
        if not {click.scene for click in said.clicks} <= {*judged}:
            return (
                f"{without_advice(said)}; if that is no slip, only the images can tell whether the camera's "
                "path strays there, not more clicks: make the dense model and the labels, which checks it"
            )
    return ""


def doubt(annotation: Annotation, live: Live, rough_px: Mapping[str, float]) -> str:
    """Why the labels will be rough although no further click helps; empty when nothing says so.

    Args:
        rough_px: expected error of the scenes whose labels will be rough.
    """
    found = [
        f"{without_advice(said)}, and labels may be off by as much"
        for said in unsettled(annotation, live)[:1]
    ]
    if rough_px:
        worst = max(rough_px, key=lambda scene: rough_px[scene])
        more = f", in {counted(len(rough_px) - 1, 'other scene')} less" if len(rough_px) > 1 else ""
        found.append(f"in scene {worst} they are expected to be {rough_px[worst]:.0f} px off{more}")
    return "; ".join(found)


def settled(live: Live, doubtful: str) -> str:
    """What can be said of the scenes and keypoints when nothing is left to do.

    Args:
        doubtful: see `doubt`.
    """
    if doubtful:
        return f"no further click helps much, but labels will be rough: {doubtful}; film again, or"
    if live.solution is not None and not live.solution.checked:
        return "every scene is placed; nothing checks the clicks against one another with this way to solve"
    weak = sorted({s.clicks[0].scene for s in weak_scenes(live)})
    placed = "every scene is placed" + (f", but scene {', '.join(weak)} not surely" if weak else "")
    for statement in live.statements:
        if statement.kind == "unjudged":
            return f"{placed}{', and' if weak else ', but'} {statement.text}; or, as it is"
    return f"{placed}{',' if weak else ''} and {_checked(live)}"


def _checked(live: Live) -> str:
    """Which keypoints are checked; not those without a position, nor distances seen from one side only."""
    if live.solution is None:
        return "every keypoint is checked"
    model = live.solution.model
    titles = keypoint_titles(model.keypoints)
    missing = [title for title, known in zip(titles, model.known, strict=True) if not known]
    unseen = f" but {', '.join(missing)}, which will have no label" if missing else ""
    far = ", ".join(titles[k] for k in live.solution.one_side)
    alone = f", the distance of {far} by the depth camera alone (marked from one side only)" if far else ""
    return f"every keypoint is checked{unseen}{alone}"
