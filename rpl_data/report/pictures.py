"""The contact sheet: a few frames of a scene with their labels, as pictures inside the page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from rpl_data.images import read_color
from rpl_data.overlay import draw_overlay, keypoint_color, view_of
from rpl_data.report.counts import FrameSummary
from rpl_data.report.html import chip, folded, number, text
from rpl_data.types import ColorImage, FrameLabel, KeypointModel, Scene
from rpl_data.workspace.workspace import Workspace

THUMBNAIL_WIDTH_PX = 420
JPEG_QUALITY = 82
POOR = 0.5
"""A quality below this stands for labels that are more than 5 px off; only that is red."""


def frames_per_scene(scenes: int) -> int:
    """Number of pictures per scene; fewer with many scenes, so that the page stays quick to open."""
    return 8 if scenes <= 12 else 6 if scenes <= 30 else 3


def choose_frames(frames: Sequence[FrameSummary], *, count: int, worst: int) -> tuple[list[int], set[int]]:
    """Choose `count` frames to show, in order, and say which of them are shown for their low quality.

    The `worst` frames of lowest quality are chosen; the others are spread evenly over those with an object.
    """
    with_object = [frame for frame in frames if frame.quality is not None] or list(frames)
    by_quality = sorted(with_object, key=lambda frame: 1.0 if frame.quality is None else frame.quality)
    lowest = {frame.frame for frame in by_quality[:worst] if frame.quality is not None}
    others = [frame.frame for frame in with_object if frame.frame not in lowest]
    rows = np.linspace(0, len(others) - 1, min(count - len(lowest), len(others))).round().astype(int)
    return sorted({others[row] for row in rows} | lowest), lowest


def jpeg_uri(picture: ColorImage) -> str:
    """Encode the picture as a data URI."""
    settings = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), settings)
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def contact_sheet(
    workspace: Workspace,
    scene: Scene,
    frames: Sequence[FrameSummary],
    models: Mapping[str, KeypointModel],
    *,
    count: int,
    worst: int = 2,
) -> str:
    """Make the pictures of one scene; its labels are read again, one at a time, for the chosen frames."""
    chosen, lowest = choose_frames(frames, count=count, worst=worst)
    figures = []
    for label in workspace.load_labels(scene.name):
        if label.frame in chosen:
            color = read_color(scene.frame(label.frame))
            view = view_of(label, scene.intrinsics)
            picture = draw_overlay(color, label, models, view=view, width_px=THUMBNAIL_WIDTH_PX)
            figures.append(_figure(label, jpeg_uri(picture), worst=label.frame in lowest))
    return f'<div class="sheet">{"".join(figures)}</div>'


def _figure(label: FrameLabel, uri: str, *, worst: bool) -> str:
    visible = [f"{instance.object} {100 * instance.visib_fract:.0f}\u00a0%" for instance in label.instances]
    words = ", ".join(visible) or "no object"
    cut = " · cut off" if any(instance.truncated for instance in label.instances) else ""
    quality = min((instance.quality for instance in label.instances), default=None)
    caption = f"<span>frame {label.frame} · {text(words)}{cut}</span><b>{number(quality)}</b>"
    badge = "<em>lowest quality</em>" if worst else ""
    image = f'<img src="{uri}" alt="{text(f"scene {label.scene}, frame {label.frame}: {words}")}">'
    kind = ' class="worst"' if worst and quality is not None and quality < POOR else ""
    return f"<figure{kind}>{image}{badge}<figcaption>{caption}</figcaption></figure>"


def legend(model: KeypointModel) -> str:
    """Colour, number and name of every keypoint; keypoints without a position are faded."""
    count = len(model.keypoints)
    chips = [
        chip(keypoint_color(k, count), str(k) if name == str(k) else f"{k} {name}", faded=not model.known[k])
        for k, name in enumerate(model.keypoints)
    ]
    return f'<div class="chips"><b>{text(model.name)}</b>{"".join(chips)}</div>'


def legends(models: Mapping[str, KeypointModel]) -> str:
    """The legends of all objects; folded when there are many, so that the pictures stay near the top."""
    lines = "".join(legend(model) for model in models.values())
    return lines if len(models) <= 3 else folded("keypoint names and colours", lines)
