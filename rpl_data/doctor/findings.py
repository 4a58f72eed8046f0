"""Results of an examination: findings, facts and the diagnosis that holds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rpl_data.recordings.mend import Mend, in_recipe

Kind = Literal[
    "unreadable", "left out", "dropped frames", "repeated frames", "depth lag", "registration",
    "pose convention", "pose lag", "pose jump", "depth scale", "intrinsics", "drift", "blur",
    "missing depth", "ray length", "turned bits", "orientation", "times",
]  # fmt: skip


COUNTED: frozenset[Kind] = frozenset(
    ["unreadable", "left out", "dropped frames", "repeated frames", "pose jump", "blur", "missing depth",
     "orientation", "times"]
)  # fmt: skip
"""Kinds of faults that are counted in the files; all others are inferred, and never certain."""


@dataclass(frozen=True)
class Finding:
    """One fault of a recording.

    Attributes:
        what: description of the fault, with its figures.
        sure: how sure it is, 0 to 1: the share of resamples of the evidence that agree, which may be all of
            them; 1 where it was counted, not inferred.
        todo: what to do about it, with the recipe option that mends it where there is one.
        mend: that recipe option.
    """

    kind: Kind
    what: str
    sure: float
    todo: str
    mend: Mend | None = None

    @property
    def sureness(self) -> str:
        """How sure it is, in words."""
        if self.kind in COUNTED:
            return "counted"
        return f"sure {self.sure:.0%}" if self.sure <= 0.99 else "sure, over 99%"


@dataclass(frozen=True)
class Diagnosis:
    """Everything that was found in a scene.

    Attributes:
        facts: properties of the scene (frames, rate, depths, motion), and what could not be judged, and why.
        findings: its faults; empty when all is well.
        unjudged: what could not be judged, each with its reason in brackets.
    """

    scene: str
    facts: tuple[str, ...]
    findings: tuple[Finding, ...]
    unjudged: tuple[str, ...] = ()


def option(mend: Mend) -> str:
    """Advice to put a mending option into the recipe."""
    return f"in the recipe, give these scenes `{in_recipe(mend)}`"
