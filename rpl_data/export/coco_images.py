"""The images of a COCO folder: colour without tags that would turn it, depth as the labels believe it."""

from __future__ import annotations

from pathlib import Path

from rpl_data.export.folder import Filling
from rpl_data.files import read_bytes
from rpl_data.formats.recordings.saved_images import encoded
from rpl_data.images import marks_no_depth, registered_units
from rpl_data.orientation import orientation_of, without_orientation
from rpl_data.types import DepthCoding, Frame, Scene


def put_color(frame: Frame, target: Path, files: Filling) -> None:
    """Put the colour image there, without a tag that would turn it in other readers."""
    if orientation_of(frame.color) == 1:
        return files.put(frame.color, target)
    files.write(target, without_orientation(read_bytes(frame.color)))


def put_depth(scene: Scene, frame: Frame, target: Path, files: Filling) -> None:
    """Put the depth image there, changed as it is changed while it is read."""
    assert frame.depth is not None
    if is_as_stored(scene) and not marks_no_depth(scene, frame):
        return files.put(frame.depth, target)
    files.write(target, encoded(registered_units(scene, frame), "png"))


def is_as_stored(scene: Scene) -> bool:
    """Whether the numbers in the depth files are depth at the colour image's pixels, in the scene's unit."""
    moved = scene.depth_warp is not None or scene.depth_camera is not None
    return not moved and scene.depth_coding == DepthCoding()
