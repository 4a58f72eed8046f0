"""Steps that all readers share: check the listed images, keep complete frames, and report the others."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.formats.recordings.color_lens import COLOR_LENS, behind_color_lens, size_notes
from rpl_data.formats.recordings.image_headers import ImageHeader, probe
from rpl_data.formats.recordings.plausibility import (
    MOST_DEPTH_M,
    SATURATED,
    median_depth_m,
    principal_point_notes,
)
from rpl_data.formats.recordings.pose_lines import nearest
from rpl_data.geometry import Transform
from rpl_data.types import DataError, DepthCamera, Frame, Intrinsics, Recording, Scene, Trajectory
from rpl_data.wording import counted

Headers = Mapping[Path, ImageHeader | None]

Camera = tuple[float, ...]
"""fx, fy, cx, cy in pixels, then OpenCV's lens distortion (4, 5 or 8 numbers) where there is any."""


Size = tuple[int, int]
"""Width and height of an image, in pixels."""


@dataclass(frozen=True)
class Pair:
    """A colour and a depth image that belong together; their files have not been read yet.

    Attributes:
        index: the later `Frame.index`.
        timestamp_s: time of the colour image.
    """

    index: int
    timestamp_s: float
    color: Path
    depth: Path


def grouped(indices: Sequence[int], reason: str, *, listed: int = 12) -> list[str]:
    """Write one line about frames left out for one reason; nothing for no frames."""
    if not indices:
        return []
    more = ", ..." if len(indices) > listed else ""
    return [f"{counted(len(indices), 'frame')} {reason}: {', '.join(map(str, indices[:listed]))}{more}"]


def whole_frames(
    pairs: Iterable[Pair], headers: Headers, *, color_px: Size, depth_px: Size
) -> tuple[list[Frame], list[str]]:
    """Keep frames with two good images and a new timestamp; also say why others were left out."""
    frames: list[Frame] = []
    left_out: dict[str, list[int]] = {}
    times: set[float] = set()
    for pair in pairs:
        defect = _defect("colour", pair.color, headers, color_px) or _defect(
            "depth", pair.depth, headers, depth_px
        )
        if defect is None and pair.timestamp_s in times:
            defect = "with the timestamp of an earlier frame"
        if defect is None:
            times.add(pair.timestamp_s)
            frames.append(Frame(pair.index, pair.timestamp_s, pair.color, pair.depth))
        else:
            left_out.setdefault(defect, []).append(pair.index)
    return frames, [line for reason, indices in left_out.items() for line in grouped(indices, reason)]


def _defect(kind: str, path: Path, headers: Headers, size: Size) -> str | None:
    if not path.is_file():
        return f"without {kind} (no such file)"
    header = headers[path]
    if header is None:
        return f"with an unreadable or truncated {kind} image"
    if header.is_depth != (kind == "depth"):
        return f"with a {kind} image of another type"
    if (header.width, header.height) != size:
        return f"with a {kind} image of another size"
    return None


def match_poses(
    pose_times_s: Float64[np.ndarray, " m"],
    poses: Float64[np.ndarray, "m 4 4"],
    indices: Sequence[int],
    stamps_s: Float64[np.ndarray, " n"],
    *,
    max_apart_s: float = 0.02,
    source: str,
) -> dict[int, Transform]:
    """Find the pose nearest in time to each frame, within half a frame interval, by `Frame.index`.

    Args:
        pose_times_s: times of the poses, sorted.
        poses: one pose per time.
        indices: `Frame.index` of the frames.
        stamps_s: one time per frame, on the clock of the poses.
        max_apart_s: a pose farther away in time than this is never used, however slow the recording.
        source: where the poses are from, for the message.

    Raises:
        DataError: no pose is close in time to any frame.
    """
    rows, apart_s = nearest(pose_times_s, stamps_s)
    steps_s = np.diff(np.unique(stamps_s))
    interval_s = float(np.median(steps_s)) if len(steps_s) else math.inf
    matched = np.flatnonzero(apart_s <= min(max_apart_s, interval_s / 2)).tolist()
    if len(indices) and not matched:
        raise DataError(
            f"no pose in {source} ({pose_times_s[0]:.6f} to {pose_times_s[-1]:.6f} s) is at the time of a "
            f"frame ({stamps_s.min():.6f} to {stamps_s.max():.6f} s); both must use one clock, in seconds"
        )
    return {indices[i]: poses[rows[i]] for i in matched}


# Scenes -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Listing:
    """A scene as its reader found it listed; the images have not been read yet.

    Attributes:
        name: name of the scene.
        folder: its folder, for messages.
        format: name of the format, for the report.
        pairs: the images.
        camera: camera of the colour images.
        camera_source: file that the camera is from, for messages.
        metres_per_unit: unit of the depth images.
        assumed_unit: whether `metres_per_unit` was assumed, which a note then says.
        registered: whether depth pixels coincide with colour pixels.
        depth_camera: camera of depth images of another size, or `COLOR_LENS`; None where a recording of this
            format must have depth at the pixels of the colour images.
        color_from_depth: where that camera stands; None where both images come through one lens.
        notes: what was assumed so far.
        skipped: what was left out so far.
    """

    name: str
    folder: Path
    format: str
    pairs: Sequence[Pair]
    camera: Camera
    camera_source: Path
    metres_per_unit: float
    assumed_unit: bool = False
    registered: bool = True
    depth_camera: Camera | None = None
    color_from_depth: Transform | None = None
    notes: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


def examine(listing: Listing) -> Recording:
    """Make a recording without poses from a listing: frames with two complete images, the rest counted.

    Raises:
        DataError: no pair is complete, depth and colour differ in size, the camera does not fit the images,
            or depths are outside 0.1-10 m, so the depth unit must be wrong.
    """
    check_unit(listing.metres_per_unit)
    images = [path for pair in listing.pairs for path in (pair.color, pair.depth)]
    headers = {path: probe(path) if path.is_file() else None for path in images}
    color_px, depth_px = _image_sizes(listing, headers)
    frames, skipped = whole_frames(listing.pairs, headers, color_px=color_px, depth_px=depth_px)
    intrinsics = intrinsics_of(listing.camera, *color_px)
    depth = _depth_camera(listing, intrinsics, depth_px)
    notes = [*listing.notes, *principal_point_notes(listing.camera_source, intrinsics)]
    notes += size_notes(intrinsics, depth)
    scene = Scene(
        listing.name,
        intrinsics,
        listing.metres_per_unit,
        tuple(frames),
        registered=listing.registered,
        no_depth_units=(SATURATED,),
        source=f"{listing.format}: {listing.folder}",
        depth_camera=depth,
    )
    median_m = median_depth_m(scene)
    if median_m > MOST_DEPTH_M:
        notes.append(
            f"WARNING: the median depth is {median_m:.1f} m and stored depths are multiples of 8: their bits "
            "are turned; `mend: {depth_bits_turned: true}` turns them back"
        )
    if listing.assumed_unit:
        notes.append(
            f"metres_per_unit not given, assumed {listing.metres_per_unit:g}: "
            f"the median depth is then {median_m:.2f} m"
        )
    return Recording(scene, None, (*listing.skipped, *skipped), tuple(notes))


def unlisted(list_file: Path, colors: Sequence[Path]) -> tuple[str, ...]:
    """Note that the folder holds more colour images than are listed: the list may have been cut off."""
    images = {p for p in colors[0].parent.glob("*") if p.suffix in (".png", ".jpg", ".jpeg")}
    more = len(images - set(colors))
    if not more:
        return ()
    unknown = f"{counted(more, 'image')} of {colors[0].parent.name}/ not in {list_file.name}"
    return (f"{unknown}: was the list cut off?",)


def with_poses(recording: Recording, poses: Mapping[int, Transform], *, without: str) -> Recording:
    """Add `scene_from_camera` poses by `Frame.index`; frames that have none are left out.

    Args:
        recording: a recording without poses.
        poses: rigid transforms.
        without: the reason to give, such as "without a pose in groundtruth.txt at their time".
    """
    scene = recording.scene
    posed = tuple(frame for frame in scene.frames if frame.index in poses)
    unposed = [frame.index for frame in scene.frames if frame.index not in poses]
    if not posed:
        raise DataError(f"scene {scene.name} ({scene.source}): all {len(unposed)} frames are {without}")
    indices: Int64[np.ndarray, " n"] = np.array([frame.index for frame in posed], dtype=np.int64)
    return Recording(
        replace(scene, frames=posed),
        Trajectory(indices, np.array([poses[frame.index] for frame in posed])),
        (*recording.skipped, *grouped(unposed, without)),
        recording.notes,
        tuple(unposed),
    )


def without_poses(recording: Recording, missing: str) -> Recording:
    """Return the recording as it is, with a note that names the missing poses."""
    note = f"no {missing}: the camera must be tracked"
    return Recording(recording.scene, None, recording.skipped, (note, *recording.notes))


def _image_sizes(listing: Listing, headers: Headers) -> tuple[Size, Size]:
    """Width and height of the colour and the depth image of the first pair that is complete."""
    for pair in listing.pairs:
        color, depth = headers[pair.color], headers[pair.depth]
        if color is None or depth is None or color.is_depth or not depth.is_depth:
            continue
        color_px, depth_px = (color.width, color.height), (depth.width, depth.height)
        if color_px != depth_px and listing.depth_camera is None:
            raise DataError(
                f"{listing.folder}: depth and colour images differ in size ({depth.width}x{depth.height} and "
                f"{color.width}x{color.height}): depth must be registered to colour when recording"
            )
        return color_px, depth_px
    first = listing.pairs[0]
    raise DataError(
        f"{listing.folder}: none of {len(listing.pairs)} frames has a readable colour image and a readable "
        f"16-bit depth image; the first names {first.color} and {first.depth}; copy the images again"
    )


def _depth_camera(listing: Listing, color: Intrinsics, depth_px: Size) -> DepthCamera | None:
    """The camera of the depth images; None where they have the pixels of the colour images."""
    if listing.depth_camera is None:
        return None
    if listing.depth_camera == COLOR_LENS:
        return behind_color_lens(listing.folder, color, *depth_px)
    place = None if listing.color_from_depth is None else tuple(listing.color_from_depth.ravel().tolist())
    return DepthCamera(intrinsics_of(listing.depth_camera, *depth_px), place)


def check_unit(metres_per_unit: float) -> None:
    """Raise a DataError unless the unit is positive and finite."""
    if not 0 < metres_per_unit < math.inf:
        raise DataError(f"metres_per_unit must be positive, got {metres_per_unit}; 0.001 means millimetres")


def intrinsics_of(camera: Camera, width: int, height: int) -> Intrinsics:
    """Intrinsics for images of this size; DataError when the camera's numbers are invalid."""
    if len(camera) not in (4, 8, 9, 12) or not all(map(math.isfinite, camera)) or min(camera[:2]) <= 0:
        raise DataError(
            "a camera is fx fy cx cy in pixels, fx and fy positive, then 0, 4, 5 or 8 numbers of lens "
            f"distortion; found {' '.join(f'{value:g}' for value in camera)}"
        )
    fx, fy, cx, cy, *distortion = camera
    return Intrinsics(fx, fy, cx, cy, width, height, tuple(distortion))
