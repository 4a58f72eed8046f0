"""Count what the report shows of a scene, in one pass over its labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rpl_data.geometry import invert
from rpl_data.types import FrameLabel, Recording
from rpl_data.workspace.workspace import Workspace


@dataclass(frozen=True)
class FrameSummary:
    """A labelled frame, as the choice of pictures needs it.

    Attributes:
        frame: `Frame.index`.
        quality: lowest quality of its instances; None without instances.
    """

    frame: int
    quality: float | None


@dataclass
class Tally:
    """Sums over the labels of one object in one scene.

    Attributes:
        directions: from the object to the camera, unit vectors in the object frame, one per label.
        off_px: how far off the keypoints of each label should be in the image: root mean square distance,
            which is the square root of 2 times `sigma_px`, that of one axis; median over the keypoints.
    """

    instances: int = 0
    seen: int = 0
    hidden: int = 0
    unlabelled: int = 0
    truncated: int = 0
    visib_fract: float = 0.0
    quality: float = 0.0
    low_quality: int = 0
    directions: list[np.ndarray] = field(default_factory=list)
    off_px: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class SceneReport:
    """The counts of one scene; `tallies` by object name."""

    recording: Recording
    frames: tuple[FrameSummary, ...]
    tallies: Mapping[str, Tally]


def summarise_scene(workspace: Workspace, name: str, *, min_quality: float = 0.0) -> SceneReport:
    """Count the labels of a scene; all counts are empty when it is not labelled yet.

    Args:
        min_quality: labels of a lower quality are counted as such.
    """
    labels = workspace.load_labels(name) if workspace.labels_file(name).exists() else iter(())
    frames: list[FrameSummary] = []
    tallies: dict[str, Tally] = {}
    for label in labels:
        frames.append(FrameSummary(label.frame, min((i.quality for i in label.instances), default=None)))
        _add(tallies, label, min_quality)
    return SceneReport(workspace.load_recording(name), tuple(frames), tallies)


def _add(tallies: dict[str, Tally], label: FrameLabel, min_quality: float) -> None:
    for instance in label.instances:
        tally = tallies.setdefault(instance.object, Tally())
        tally.instances += 1
        tally.seen += int((instance.visibility == 2).sum())
        tally.hidden += int((instance.visibility == 1).sum())
        tally.unlabelled += int((instance.visibility == 0).sum())
        tally.truncated += instance.truncated
        tally.visib_fract += instance.visib_fract
        tally.quality += instance.quality
        towards = invert(instance.camera_from_object)[:3, 3]
        tally.directions.append(towards / max(float(np.linalg.norm(towards)), 1e-9))
        known = instance.sigma_px[np.isfinite(instance.sigma_px)]
        tally.off_px += [float(np.sqrt(2) * np.median(known))] if len(known) else []
        tally.low_quality += instance.box is not None and instance.quality < min_quality
