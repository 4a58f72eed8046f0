"""Where a run of the segmentation figure stands, kept in progress.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rpl_data.files import read_json
from rpl_data.types import DataError

if TYPE_CHECKING:
    from ...masks.settings import MaskSettings


@dataclass(frozen=True)
class Progress:
    """How far an experiment has come.

    Attributes:
        settings: options of the training, without those that may change when it is resumed.
        epochs: how many epochs both sources have been trained for.
        seconds: wall-clock time of the finished rounds.
        cpu_seconds: processor time of the finished rounds, all threads and processes.
        history: mean IoU on val of [OURS, MANUAL] after each round: [epoch, ours, manual].
    """

    settings: dict[str, Any]
    epochs: int = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    history: list[list[float | None]] = field(default_factory=list)


def load_progress(out: Path, settings: MaskSettings) -> Progress:
    """Read the progress of the experiment in `out`; DataError when its settings were others."""
    from ...masks.settings import comparable

    path = out / "progress.json"
    if not path.exists():
        return Progress(settings=comparable(settings))
    progress = Progress(**read_json(path))
    if progress.settings != comparable(settings):
        raise DataError(f"{path} belongs to a run with other settings; choose another --out, or its --preset")
    return progress
