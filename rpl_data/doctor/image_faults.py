"""Faults that single images show: blur, missing depth, repeated images."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from rpl_data.doctor.findings import Finding, option
from rpl_data.recordings.mend import Mend
from rpl_data.types import ColorImage, DepthImage

BLURRED = 0.3
"""A frame is blurred when its sharpness is below this share of the sharpest tenth of the frames."""


def sharpness(color: ColorImage) -> float:
    """Variance of the Laplacian (Pech-Pacheco et al., ICPR 2000), at half the resolution."""
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var())


def blur(sharpnesses: Sequence[float], *, tolerated: float = 0.25) -> list[Finding]:
    """Return a finding when many frames are blurred relative to the sharpest tenth of them."""
    values = np.array(sharpnesses)
    blurred = float((values < BLURRED * np.percentile(values, 90)).mean())
    if blurred <= tolerated:
        return []
    todo = "move more slowly, add light, or fix a shorter exposure; click in sharp frames"
    return [Finding("blur", f"{blurred:.0%} of the frames examined are blurred", 1.0, todo)]


def missing_share(depth_m: DepthImage) -> float:
    """Share of pixels without depth in the middle of the image (half its width and height)."""
    height, width = depth_m.shape
    middle = depth_m[height // 4 : height - height // 4, width // 4 : width - width // 4]
    return float((middle == 0).mean())


def missing_depth(shares: Sequence[float], *, tolerated: float = 0.4) -> list[Finding]:
    """Return a finding when much of the middle of the images has no depth."""
    share = float(np.median(shares))
    if share <= tolerated:
        return []
    what = f"{share:.0%} of the pixels in the middle of the depth images have no depth"
    todo = (
        "keep the sensor's minimum distance (0.3 m for a D435 at 640 x 480), add texture or matt spray to "
        "dark and shiny parts, and switch the infrared projector on"
    )
    return [Finding("missing depth", what, 1.0, todo)]


def repeats(images: Sequence[DepthImage], frames: Sequence[int]) -> list[int]:
    """Frame numbers of depth images that equal the one before; `images` must be consecutive."""
    pairs = zip(images[:-1], images[1:], strict=True)
    return [frame for frame, (one, two) in zip(frames[1:], pairs, strict=True) if np.array_equal(one, two)]


def repeated(frames: Sequence[int], looked_at: int) -> list[Finding]:
    """Return a finding when images repeat."""
    if not frames:
        return []
    listed = ", ".join(map(str, frames[:6])) + (", ..." if len(frames) > 6 else "")
    what = f"{len(frames)} of {looked_at} depth images examined repeat the one before: frames {listed}"
    mend = Mend(no_repeats=True)
    todo = f"the camera delivered fewer images than the recorder wrote; {option(mend)}"
    return [Finding("repeated frames", what, 1.0, todo, mend)]
