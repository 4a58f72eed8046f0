"""Stage `cut`: cut recordings whose poses drift too far into scenes that their own clicks place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rpl_data.drift.drift import Drift, cut, drift_from_json
from rpl_data.files import read_json
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.types import Click, DataError, Span
from rpl_data.types.instances import places_in

VERSION = 1
"""Increase it when the stage writes something else for the same input: its steps then run again."""

FEWEST_KEYPOINTS = 4
"""Keypoints an object needs in every part, also clicked elsewhere: three tie the part, one is spare."""


def cut_steps(context: Context) -> list[Step]:
    """Plan the step that cuts recordings into scenes, where drift requires it and clicks allow it."""
    workspace, max_drift_mm = context.workspace, context.recipe.reconstruct.max_drift_mm
    videos = context.videos()

    def run(advance: Advance) -> Outcome:
        clicks = {
            name: [workspace.parts().click_in_video(c) for c in workspace.load_annotation(name).clicks]
            for name in context.object_names
        }
        messages: list[str] = []
        for video in videos:
            if video in workspace.parts().moving:
                continue  # depth at the object says nothing of the camera there
            drift = drift_from_json(read_json(workspace.drift_file(video)))
            chosen = choose_cut(video, drift, clicks, max_drift_m=max_drift_mm / 1000)
            workspace.cut_scene(video, chosen.spans)
            messages += chosen.messages
        return Outcome(messages=tuple(messages))

    return [
        step(
            "cut",
            "",
            run,
            version=VERSION,
            options={
                "max_drift_mm": context.recipe.reconstruct.max_drift_mm,
                "objects": context.object_names,
            },
            sources={k: v for name in context.object_names for k, v in context.clicks_source(name).items()},
            after=[f"drift/{video}" for video in videos],
        )
    ]


@dataclass(frozen=True)
class Cut:
    """Parts of a recording (a single one when it stays whole), and lines for the user."""

    spans: tuple[Span, ...]
    messages: tuple[str, ...] = ()


def choose_cut(video: str, drift: Drift, clicks: Mapping[str, Sequence[Click]], *, max_drift_m: float) -> Cut:
    """Choose the fewest parts within which poses drift no farther than allowed.

    Every part needs enough clicks to be placed by itself. If some parts lack them, the recording is cut as
    far as the clicks allow, if that helps at all, and a line says where to click.

    Args:
        clicks: clicks of all recordings, by object, with the names of videos.

    Raises:
        DataError: the poses drift too fast to be mended by cutting.
    """
    strayed = f"{video}: its poses drift by {1000 * drift.whole_m:.0f} mm"
    limit = f"max_drift_mm: {1000 * max_drift_m:.0f}"
    wanted = cut(drift, max_drift_m=max_drift_m)
    if wanted is None:
        raise DataError(
            f"scene {strayed}, and too fast for cutting to mend that ({limit}): labels would be off by as "
            "much. Record it again more slowly, leave it out by `names:`, or label it all the same with a "
            "larger `reconstruct: {max_drift_mm: ...}`; `rpl check` looks for wrongly stored poses"
        )
    if len(wanted) < 2:
        return Cut(tuple(wanted))

    def allowed(first: int, last: int) -> bool:
        return not _lacking(video, (first, last), clicks)

    found = cut(drift, max_drift_m=max_drift_m, allowed=allowed)
    if found is not None:
        return Cut(tuple(found), (f"scene {strayed} ({limit}), so it was cut into {_listed(found)}",))
    missing = [
        f"{name} in frames {span[0]} to {span[1]}"
        for span in wanted
        for name in _lacking(video, span, clicks)
    ]
    wish = (
        f"to have it cut into {_listed(wanted)}, click at least {FEWEST_KEYPOINTS} keypoints of "
        f"{', '.join(missing) or 'each object in each part'}"
    )
    found = _as_far_as_clicks_allow(drift, max_drift_m, len(wanted), allowed)
    if found is None:
        return Cut((), (f"scene {strayed} ({limit}) and its labels with them; {wish}",))
    return Cut(tuple(found), (f"scene {strayed} ({limit}), so it was cut into {_listed(found)}; {wish}",))


def _as_far_as_clicks_allow(
    drift: Drift, max_drift_m: float, most_parts: int, allowed: Callable[[int, int], bool]
) -> list[Span] | None:
    """Cut into parts that drift farther than allowed, but at most half as far as the whole."""
    limit_m = 1.25 * max_drift_m
    while limit_m < drift.whole_m / 2:
        found = cut(drift, max_drift_m=limit_m, most_parts=most_parts, allowed=allowed)
        if found is not None:
            return found
        limit_m *= 1.25
    return None


def _listed(spans: Sequence[Span]) -> str:
    """Write the number of parts and their frames."""
    return f"{len(spans)} (frames {', '.join(f'{first} to {last}' for first, last in spans)})"


def _lacking(video: str, span: Span, clicks: Mapping[str, Sequence[Click]]) -> list[str]:
    """Objects clicked in this video whose clicks in this part of it are too few to place an instance."""
    return [
        name
        for name, of_object in clicks.items()
        if any(
            _lacks(place, span, of_object) for place in places_in(video, {click.scene for click in of_object})
        )
    ]


def _lacks(place: str, span: Span, clicks: Sequence[Click]) -> bool:
    """Whether an instance has too few clicks in a part of its video."""
    here = {c.keypoint for c in clicks if c.scene == place and span[0] <= c.frame <= span[1]}
    elsewhere = {c.keypoint for c in clicks if c.scene != place or not span[0] <= c.frame <= span[1]}
    return len(here & elsewhere) < FEWEST_KEYPOINTS
