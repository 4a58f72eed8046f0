"""What the ledger says about a build: times, errors and splits, for the report and the terminal."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from rpl_data.pipeline.ledger import Entry, Ledger
from rpl_data.pipeline.stages import ORDER
from rpl_data.types import QualityRow
from rpl_data.wording import counted


def quality_rows(ledger: Ledger) -> list[QualityRow]:
    """Rows of the last comparison that this stage made; empty when there was none."""
    entry = ledger.entries.get("quality")
    rows: Any = [] if entry is None else entry.outcome.details["rows"]
    filled: list[dict[str, Any]] = [{k: math.nan if v is None else v for k, v in row.items()} for row in rows]
    return [QualityRow(**row) for row in filled]


def timings(ledger: Ledger) -> dict[str, dict[str, float | int]]:
    """Seconds and number of frames of every stage that ran, in order."""
    found: dict[str, dict[str, float | int]] = {}
    for stage in ORDER:
        outcomes = ledger.of_stage(stage).values()
        if outcomes:
            seconds = sum(entry.seconds for entry in outcomes)
            found[stage] = {"seconds": seconds, "frames": sum(entry.outcome.frames for entry in outcomes)}
    return found


def worth_knowing(ledger: Ledger, fresh: Collection[str] | None = None) -> list[str]:
    """What the stages after the reading of recordings had to say about the result, each line once.

    Args:
        fresh: names of the steps that are up to date; only these are heard. All of them when None.
    """
    stages = ("cut", "solve", "refine", "segment", "label", "export")
    heard = [
        (stage, entry)
        for stage in stages
        for item, entry in ledger.of_stage(stage).items()
        if fresh is None or (f"{stage}/{item}" if item else stage) in fresh
    ]
    said = [line for _, entry in heard for line in entry.outcome.messages]
    sparse = sparse_labels([entry for stage, entry in heard if stage == "label"])
    return list(dict.fromkeys([*said, *sparse]))


def sparse_labels(entries: Collection[Entry]) -> list[str]:
    """A line when not all frames are labelled: how many are, by which rate, and how to get all."""
    rates = {entry.options.get("rate_hz") for entry in entries}
    labelled = sum(entry.outcome.frames for entry in entries)
    posed = sum(entry.outcome.details.get("posed", entry.outcome.frames) for entry in entries)
    if labelled >= posed:
        return []
    by = " or ".join(f"{rate:g}" for rate in sorted(rate for rate in rates if rate is not None))
    return [
        f"{labelled} of the {posed} frames with a camera pose are labelled, {by} per second of recording; "
        "`label: {rate: all}` in the recipe labels all of them"
    ]


def split_summary(ledger: Ledger) -> str:
    """Write one line per split: its images, scenes, and how near its views are to those of training."""
    entry = ledger.entries.get("export/coco")
    if entry is None:
        return ""
    lines = []
    for name, images in entry.outcome.details["images"].items():
        scenes = ", ".join(entry.outcome.details["scenes"].get(name, []))
        line = f"{name}: {counted(images, 'image')} of {scenes or 'no scene'}"
        near = entry.outcome.details["views"].get(name)
        if near is not None and near["angle_median_deg"] is not None:
            line += (
                f"; views {near['angle_median_deg']:.1f} deg (median), {near['angle_p90_deg']:.1f} deg (p90) "
                "from the nearest of training"
            )
        if near is not None and near["time_median_s"] is not None:
            line += f", {near['time_median_s']:.2f} s (median) from it in time"
        lines.append(line)
    return "\n".join(lines)
