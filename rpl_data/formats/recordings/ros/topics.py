"""Which topics of a bag are colour, depth and their cameras: found by type, encoding and name, or asked for.

Names are those of realsense-ros (/camera/color/image_raw, /camera/aligned_depth_to_color/image_raw; since its
version 4.51 below /camera/camera), the drivers of Azure Kinect (/rgb/image_raw, /depth_to_rgb/image_raw),
Orbbec, OpenNI and freenect (/camera/rgb, /camera/depth_registered), ZED (/zed/zed_node/rgb, .../depth) and
depthai-ros (/oak/rgb, /oak/stereo), as their README files list them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rpl_data.formats.recordings.ros.decode import (
    GREY,
    base_encoding,
    is_color_encoding,
    is_depth_encoding,
)
from rpl_data.types import DataError
from rpl_data.wording import counted


@dataclass
class ImageTopic:
    """What was seen of a topic of images.

    Attributes:
        first: its first message, decoded.
        encoding: encoding of its images, or the format of compressed ones.
        frame: the coordinate frame they name.
        stamps_ns: time in the header of each message.
        bag_ns: when each was recorded.
    """

    name: str
    first: Any
    encoding: str
    frame: str
    stamps_ns: list[int]
    bag_ns: list[int]

    @property
    def base(self) -> str:
        """The name of the topic before a transport's suffix."""
        return re.sub(r"/(compressed|compressedDepth|ffmpeg|foxglove)$", "", self.name)

    @property
    def folder(self) -> str:
        """The namespace of the topic, which holds its camera_info too."""
        return self.base.rpartition("/")[0]

    @property
    def is_depth(self) -> bool:
        """Whether its images are depth: by encoding and, where 16 bits may be infrared, by name."""
        if not is_depth_encoding(self.encoding) or _words(self.base) & _NO_DEPTH:
            return False
        return base_encoding(self.encoding) != "mono16" or "depth" in self.base

    @property
    def is_color(self) -> bool:
        """Whether its images are colour, or grey where nothing says infrared."""
        return is_color_encoding(self.encoding) and not self.is_depth and not _words(self.base) & _NO_COLOR


_NO_COLOR = {
    "infra",
    "infra1",
    "infra2",
    "ir",
    "fisheye",
    "fisheye1",
    "fisheye2",
    "depth",
    "confidence",
    "mask",
}
_NO_DEPTH = {"infra", "infra1", "infra2", "ir", "confidence", "disparity", "cost"}
_COLOR_WORDS = {"color", "colour", "rgb"}
_ALIGNED = re.compile(r"(?<![a-z])(depth_to_rgb|depth_to_color|registered)(?![a-z])")


def _words(name: str) -> set[str]:
    return set(re.split(r"[/_]", name.lower()))


def is_aligned_by_name(topic: str) -> bool:
    """Whether the name of a depth topic says that its driver moved it onto the colour image."""
    return _ALIGNED.search(topic) is not None


def choose_color(images: Mapping[str, ImageTopic], wanted: str | None) -> ImageTopic:
    """The topic of the colour images.

    Raises:
        DataError: there is none, or several that are equally good, which are listed.
    """
    if wanted is not None:
        return _named(images, wanted, "color")
    found = [one for one in images.values() if one.is_color]
    return _best(found, [(_color_rank(one),) for one in found], "colour", "color", images)


def choose_depth(images: Mapping[str, ImageTopic], color: ImageTopic, wanted: str | None) -> ImageTopic:
    """The topic of the depth images that belong to the colour images.

    Raises:
        DataError: there is none, or several that are equally good, which are listed.
    """
    if wanted is not None:
        return _named(images, wanted, "depth")
    found = [one for one in images.values() if one.is_depth]
    ranks = [(_shared(one.name, color.name), _depth_rank(one)) for one in found]
    return _best(found, ranks, "depth", "depth", images)


def _named(images: Mapping[str, ImageTopic], wanted: str, field: str) -> ImageTopic:
    name = "/" + wanted.lstrip("/")
    if name not in images:
        raise DataError(f"`topics: {{{field}: {wanted}}}`: the bag holds no images there; {_listed(images)}")
    return images[name]


def _listed(images: Mapping[str, ImageTopic]) -> str:
    if not images:
        return "it holds no image topics at all"
    return "its image topics are " + ", ".join(f"{one.name} ({one.encoding})" for one in images.values())


def _best(
    found: Sequence[ImageTopic],
    ranks: Sequence[tuple[int, ...]],
    kind: str,
    field: str,
    images: Mapping[str, ImageTopic],
) -> ImageTopic:
    if not found:
        raise DataError(
            f"the bag holds no {kind} images: {_listed(images)}; record colour and depth"
            + (f", or name the topic: `topics: {{{field}: ...}}`" if images else "")
        )
    top = max(ranks)
    best = sorted(
        (one for one, rank in zip(found, ranks, strict=True) if rank == top),
        key=lambda one: (
            one.name != one.base,
            base_encoding(one.encoding) != "16uc1",
            len(one.name),
            one.name,
        ),
    )
    if len({one.folder for one in best}) > 1:
        names = ", ".join(one.name for one in best)
        raise DataError(
            f"the bag holds {counted(len(best), 'topic')} of {kind} images that are equally likely: {names}; "
            f"name one: `topics: {{{field}: {best[0].name}}}`"
        )
    return best[0]


def _color_rank(topic: ImageTopic) -> int:
    """How likely a topic holds the colour images that people mean."""
    folder, last = topic.base.rpartition("/")[::2]
    return (
        4 * bool(_words(folder) & _COLOR_WORDS)
        + 2 * bool(_words(last) & _COLOR_WORDS)
        + ("rect" in _words(last))
        - 4 * (base_encoding(topic.encoding) in GREY)
        - 4 * bool(re.search(r"(rgb|color)_to_depth", topic.base))
    )


def _depth_rank(topic: ImageTopic) -> int:
    """How likely a topic holds the depth that people mean: aligned to colour before its own camera's."""
    return (
        8 * is_aligned_by_name(topic.base)
        + 4 * bool(_words(topic.base) & {"depth", "stereo"})
        + ("rect" in _words(topic.base.rpartition("/")[2]))
    )


def _shared(one: str, other: str) -> int:
    """How many namespaces two topics share, from the root on."""
    parts = zip(one.split("/")[1:-1], other.split("/")[1:-1], strict=False)
    return next(
        (number for number, (a, b) in enumerate(parts) if a != b), min(one.count("/"), other.count("/")) - 1
    )
