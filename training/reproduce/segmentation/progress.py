"""Where a run of the segmentation figure stands, kept in progress.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rpl_data.files import read_json
from rpl_data.types import DataError

if TYPE_CHECKING:
    from training.masks.settings import MaskSettings


@dataclass(frozen=True)
class Progress:
    """Where a run stands.

    Attributes:
        settings: of the training, without what may change when it is resumed.
        epochs: that both sources have been trained.
        seconds: on the clock, for finished rounds. cpu_seconds: of the processor, all threads and processes.
        history: mean IoU on val of [OURS, MANUAL] after each round: [epoch, ours, manual].
    """

    settings: dict[str, Any]
    epochs: int = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    history: list[list[float | None]] = field(default_factory=list)


def load_progress(out: Path, settings: MaskSettings) -> Progress:
    """Of the run in `out`, nothing when there is none; DataError when its settings were others."""
    from training.masks.settings import comparable

    path = out / "progress.json"
    if not path.exists():
        return Progress(settings=comparable(settings))
    progress = Progress(**read_json(path))
    if progress.settings != comparable(settings):
        raise DataError(f"{path} belongs to a run with other settings; choose another --out, or its --preset")
    return progress
