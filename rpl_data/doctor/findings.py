"""What the doctor says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rpl_data.recordings.mend import Mend, in_recipe

Kind = Literal[
    "unreadable", "left out", "dropped frames", "repeated frames", "depth lag", "registration",
    "pose convention", "pose lag", "pose jump", "depth scale", "intrinsics", "drift", "blur",
    "missing depth",
]  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        what: what is wrong, with the figures.
        sure: how sure, 0 to 1: the share of resamples of the evidence that say the same; 1 where it
            was counted, not inferred.
        todo: what to do about it, and the option of the recipe that mends it where there is one.
        mend: that option.
    """

    kind: Kind
    what: str
    sure: float
    todo: str
    mend: Mend | None = None


@dataclass(frozen=True)
class Diagnosis:
    """What was found in a scene.

    Attributes:
        facts: what the scene is: frames, rate, depths, motion; and what could not be judged, and why.
        findings: what is wrong with it; empty when all is well.
    """

    scene: str
    facts: tuple[str, ...]
    findings: tuple[Finding, ...]


def option(mend: Mend) -> str:
    """The line of a recipe that mends it."""
    return f"in the recipe, give these scenes `{in_recipe(mend)}`"
