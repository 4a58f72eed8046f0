"""What recordings of phones have in common: ARKit's poses, coarse depth, confidence, a lens that focuses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool

from rpl_data.files import read_json, write_bytes
from rpl_data.formats.recordings.camera_file import CameraFile, told_of
from rpl_data.formats.recordings.color_lens import COLOR_LENS, camera_numbers, stretched
from rpl_data.formats.recordings.depth_files import (
    STORED_UNIT_M,
    read_depth_file,
    stored_units,
    unit_of_decimals,
)
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    intrinsics_of,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.formats.recordings.matrices import median_camera, rigid_or_none
from rpl_data.formats.recordings.saved_images import write_depth
from rpl_data.formats.recordings.scene_folders import chosen_scenes
from rpl_data.geometry import OPENGL_AXES, Transform, resized
from rpl_data.types import DataError, Recording

DOUBTED = "depth of low confidence is left out"


@dataclass(frozen=True)
class PhoneFrame:
    """A frame as its app listed it; the images have not been read yet.

    Attributes:
        index: the later `Frame.index`.
        timestamp_s: its time.
        color: the colour image.
        depth: the depth image: 16-bit PNG, or anything that `read_depth_file` reads.
        confidence: an image that is 0 where depth is not to be trusted; None where there is none.
        camera: fx, fy, cx, cy of the colour image; empty where the app has one for all frames.
        pose: scene_from_camera in OpenCV's axes; None where there is none.
    """

    index: int
    timestamp_s: float
    color: Path
    depth: Path
    confidence: Path | None = None
    camera: Camera = ()
    pose: Transform | None = None


@dataclass(frozen=True)
class Phone:
    """A scene as its app stored it.

    Attributes:
        name: name of the scene.
        folder: its folder, for messages.
        format: name of the format.
        frames: its frames.
        camera: of all frames; empty where every frame has its own.
        camera_px: width and height of the images that the cameras are for; None = the images themselves.
        metres_per_unit: of the app's depth, where the app says it.
        rewritten_m: unit of the depth images where the reader has written them itself.
        notes, skipped: what was assumed and left out so far.
    """

    name: str
    folder: Path
    format: str
    frames: Sequence[PhoneFrame]
    camera: Camera = ()
    camera_px: tuple[int, int] | None = None
    metres_per_unit: float | None = None
    rewritten_m: float | None = None
    notes: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True)
class App:
    """How the recordings of an app are found and read.

    Attributes:
        is_scene: whether a folder is a recording of the app.
        lacks: what other folders lack, for the message.
        read: reads a scene, given its name and its folder.
    """

    is_scene: Callable[[Path], bool]
    lacks: str
    read: Callable[[str, Path], Phone]

    def recordings(
        self,
        path: Path,
        *,
        unpack: Callable[[str], Path],
        names: Sequence[str] | None,
        metres_per_unit: float | None,
        camera: Camera | None,
    ) -> list[Recording]:
        """Read one scene, or those in the folders of a folder; arguments and errors as `read_polycam`."""
        path = path.absolute()
        return [
            phone_recording(
                self.read(name, folder), partial(unpack, name), metres_per_unit=metres_per_unit, camera=camera
            )
            for name, folder in chosen_scenes(path, self.is_scene, names, lacks=self.lacks).items()
        ]


def phone_recording(
    phone: Phone, unpack: Callable[[], Path], *, metres_per_unit: float | None, camera: Camera | None
) -> Recording:
    """Make a recording of a scene: depth without what is doubtful, one camera, poses where there are any.

    Args:
        phone: the scene.
        unpack: returns the folder for depth images that are rewritten.
        metres_per_unit: unit of the depth images; that of the app or of a camera.txt, else 0.001, when None.
        camera: used instead of the app's.

    Raises:
        DataError: no frame is complete, there is no camera, a camera.txt says something else than the app,
            or the camera or the depth unit does not fit the images.
    """
    if not phone.frames:
        raise DataError(f"{phone.folder} holds no frame with a colour and a depth image; export it again")
    own, notes = ((), ()) if camera else _camera_of(phone)
    said = CameraFile(_for_images(phone, own), phone.metres_per_unit) if own else None
    told = told_of(
        phone.folder, camera=camera, metres_per_unit=metres_per_unit, own=said, own_source=phone.folder
    )
    if told.camera is None:
        raise DataError(f"{phone.folder} names no camera; give `camera: [fx, fy, cx, cy]`")
    unit_m = phone.rewritten_m or told.metres_per_unit or 0.001
    pairs, stored_m, doubted = _trusted(phone, unit_m, told.metres_per_unit, unpack)
    recording = examine(
        Listing(
            phone.name,
            phone.folder,
            phone.format,
            pairs,
            told.camera,
            told.source,
            stored_m,
            depth_camera=COLOR_LENS,
            notes=(*phone.notes, *notes, *doubted),
            skipped=phone.skipped,
        )
    )
    poses = {frame.index: frame.pose for frame in phone.frames if frame.pose is not None}
    if not poses:
        return without_poses(recording, "poses of the app")
    return with_poses(recording, poses, without="without a pose")


def _camera_of(phone: Phone) -> tuple[Camera, tuple[str, ...]]:
    """The camera of all frames, empty where there is none, and a note where they differ."""
    if phone.camera:
        return phone.camera, ()
    own = np.array([frame.camera[:4] for frame in phone.frames if len(frame.camera) >= 4], dtype=float)
    if not len(own) or not np.isfinite(own).all():
        return (), ()
    lens, notes = median_camera(own)
    return (*lens, *phone.frames[0].camera[4:]), notes


def _for_images(phone: Phone, camera: Camera) -> Camera:
    """The camera for the size that the images have, where its numbers are for another."""
    headers = (probe(frame.color) for frame in phone.frames)
    color = next((header for header in headers if header is not None), None)
    if phone.camera_px is None or color is None or phone.camera_px == (color.width, color.height):
        return camera
    own = intrinsics_of(camera, *phone.camera_px)
    if stretched(phone.camera_px, (color.width, color.height)):
        raise DataError(
            f"{phone.folder}: its camera is for images of {phone.camera_px[0]} x {phone.camera_px[1]} px, "
            f"but they have {color.width} x {color.height}; give `camera: [fx, fy, cx, cy]` for these"
        )
    return camera_numbers(resized(own, width=color.width, height=color.height))


def _trusted(
    phone: Phone, unit_m: float, given_m: float | None, unpack: Callable[[], Path]
) -> tuple[list[Pair], float, tuple[str, ...]]:
    """Rewrite depth images without doubtful pixels; also their unit, and what was done."""
    pairs = [Pair(frame.index, frame.timestamp_s, frame.color, frame.depth) for frame in phone.frames]
    marked = any(frame.confidence is not None for frame in phone.frames)
    if not marked and all(frame.depth.suffix == ".png" for frame in phone.frames):
        return pairs, unit_m, ()
    folder, decimal_m = unpack(), None
    for row, frame in enumerate(phone.frames):
        try:
            depth, confident = read_depth_file(frame.depth), read_confidence(frame.confidence)
        except DataError:  # an empty file in its place: the frame is then left out as unreadable
            pairs[row] = replace(pairs[row], depth=folder / f"depth/{frame.index:06d}.png")
            write_bytes(pairs[row].depth, b"")
            continue
        if depth.dtype.kind == "f" and decimal_m is None:
            decimal_m = unit_of_decimals(depth) if given_m is None else given_m
        units = stored_units(depth, decimal_m if depth.dtype.kind == "f" else None, confident)
        pairs[row] = replace(pairs[row], depth=write_depth(folder, frame.index, units))
    return pairs, STORED_UNIT_M if decimal_m else unit_m, (DOUBTED,) if marked else ()


def read_confidence(path: Path | None) -> Bool[np.ndarray, "height width"] | None:
    """Read which pixels of a depth image to trust: all but the lowest of the three levels, 0.

    Apps write the levels as 0, 1, 2 or as 0, 127, 255. None where there is no image.

    Raises:
        DataError: the image is damaged.
    """
    if path is None:
        return None
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if image is None or image.dtype.kind not in "ui":
        raise DataError(f"{path} is no confidence image, or damaged; copy it again")
    found: Bool[np.ndarray, "height width"] = (image if image.ndim == 2 else image[..., 0]) > 0
    return found


def has_confidence(folder: Path) -> bool:
    """Whether there are confidence images; a folder for them may be empty where they were not exported."""
    return (folder / "confidence").is_dir() and any((folder / "confidence").iterdir())


def arkit_pose(values: Sequence[float]) -> Transform | None:
    """scene_from_camera in OpenCV's axes of 12 or 16 numbers of ARKit's; None where they are none.

    ARKit's camera has y up and looks along -z (developer.apple.com, ARCamera.transform).
    """
    pose = rigid_or_none(values)
    return None if pose is None else pose @ OPENGL_AXES


def json_or_empty(path: Path) -> Mapping[str, Any]:
    """Content of a frame's own file; empty where it is damaged, so that the frame is left out."""
    try:
        found = read_json(path)
    except DataError:
        return {}
    return found if isinstance(found, dict) else {}
