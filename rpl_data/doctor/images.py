"""What single images tell: blur, depth that is not there, images that repeat."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from rpl_data.doctor.findings import Finding, option
from rpl_data.recordings.mend import Mend
from rpl_data.types import ColorImage, DepthImage

BLURRED = 0.3
"""A frame is called blurred when its sharpness is below this share of the sharp frames near it."""


def sharpness(color: ColorImage) -> float:
    """Variance of the Laplacian (Pech-Pacheco et al., ICPR 2000), at half the resolution."""
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var())


def blur(sharpnesses: Sequence[float], *, tolerated: float = 0.25) -> list[Finding]:
    """A finding when more than a quarter of the frames are blurred against the sharpest tenth."""
    values = np.array(sharpnesses)
    blurred = float((values < BLURRED * np.percentile(values, 90)).mean())
    if blurred <= tolerated:
        return []
    todo = "move more slowly, add light, or fix a shorter exposure; click in sharp frames"
    return [Finding("blur", f"{blurred:.0%} of the frames looked at are blurred", 1.0, todo)]


def missing_share(depth_m: DepthImage) -> float:
    """Share of the middle of the image (half its width and height, where objects are) without depth."""
    height, width = depth_m.shape
    middle = depth_m[height // 4 : height - height // 4, width // 4 : width - width // 4]
    return float((middle == 0).mean())


def missing_depth(shares: Sequence[float], *, tolerated: float = 0.4) -> list[Finding]:
    """A finding when the middle of the images mostly lacks depth."""
    share = float(np.median(shares))
    if share <= tolerated:
        return []
    what = f"{share:.0%} of the middle of the depth images holds no depth"
    todo = (
        "keep the sensor's least distance (0.3 m for a D435 at 640 x 480), add texture or matt spray to "
        "dark and shiny parts, and switch the infrared projector on"
    )
    return [Finding("missing depth", what, 1.0, todo)]


def repeats(images: Sequence[DepthImage], frames: Sequence[int]) -> list[int]:
    """Numbers of the depth images that equal the one before; `images` must be in a row."""
    pairs = zip(images[:-1], images[1:], strict=True)
    return [frame for frame, (one, two) in zip(frames[1:], pairs, strict=True) if np.array_equal(one, two)]


def repeated(frames: Sequence[int], looked_at: int) -> list[Finding]:
    """A finding when images repeat."""
    if not frames:
        return []
    listed = ", ".join(map(str, frames[:6])) + (", ..." if len(frames) > 6 else "")
    what = f"{len(frames)} of {looked_at} depth images looked at repeat the one before: frames {listed}"
    mend = Mend(no_repeats=True)
    todo = f"the camera delivered fewer images than were written; {option(mend)}"
    return [Finding("repeated frames", what, 1.0, todo, mend)]
