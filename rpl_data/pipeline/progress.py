"""What the caller of a build is told while it goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from rpl_data.pipeline.ledger import Outcome


@dataclass(frozen=True)
class Progress:
    """Progress of a build, as its caller receives it; several steps may be at work at once.

    Attributes:
        state: `runs` (with `done` of `total` frames; total 0 = unknown), `ran`, `kept`: nothing that it
            depends on has changed, so it was not run, or `failed`, where the build goes on without it.
        seconds: time it took, now or when it last ran.
        outcome: of a step that ran or was kept; of one that failed, why.
    """

    stage: str
    item: str
    state: Literal["runs", "ran", "kept", "failed"]
    done: int = 0
    total: int = 0
    seconds: float = 0.0
    outcome: Outcome = Outcome()

    def __str__(self) -> str:
        """One line for a person, as `tell=print` shows it."""
        step = f"{self.stage} {self.item}".strip()
        if self.state == "kept":
            return f"{step}: up to date"
        if self.state == "failed":
            return f"{step}: failed: {' '.join(self.outcome.messages)}"
        if self.state == "ran":
            return f"{step}: done in {self.seconds:.1f} s"
        return f"{step}: {self.done} of {self.total}" if self.total else f"{step}: {self.done} done"


Tell = Callable[[Progress], None]
