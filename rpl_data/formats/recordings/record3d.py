"""Record3D's captures: `.r3d`, the folder that it unpacks to, and its export as EXR and JPG.

::

    <name>.r3d (a zip)  metadata, rgbd/0.jpg, rgbd/0.depth, rgbd/0.conf ...
    <name>/EXR_RGBD/    metadata.json, rgb/0.jpg, depth/0.exr ...

`metadata` is JSON: `K` (nine numbers, by columns) for images of `w` x `h`, `dw` x `dh` of the depth, `fps`,
`poses` (rows qx qy qz qw tx ty tz, scene_from_camera of a camera with y up that looks along -z), of newer
versions `perFrameIntrinsicCoeffs` (rows fx fy cx cy) and `frameTimestamps`. Depth is float32 metres,
confidence uint8 0 to 2, both LZFSE; a phone held upright gives `dh` = 256 rows of `dw` = 192.

Sources: nerfstudio's process_data/record3d_utils.py and instant-ngp's scripts/record3d2nerf.py, which agree
on K and the poses; the maker documents the live stream only (github.com/marek-simonik/record3d).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.files import decoding, write_bytes
from rpl_data.formats.containers.cut_zip import Members, members_of
from rpl_data.formats.containers.exr import MOST_PIXELS, decoded_exr
from rpl_data.formats.recordings.depth_files import STORED_UNIT_M, stored_units
from rpl_data.formats.recordings.frame_files import Camera, grouped
from rpl_data.formats.recordings.matrices import camera_of
from rpl_data.formats.recordings.phones import DOUBTED, Phone, PhoneFrame, phone_recording
from rpl_data.formats.recordings.saved_images import write_depth
from rpl_data.formats.recordings.scene_folders import chosen, folders_in
from rpl_data.geometry import OPENGL_AXES, Transform, from_quaternion_xyzw
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.child import in_child

_COLOR = re.compile(r"(?:rgbd|rgb)/(\d{1,9})\.(?:jpe?g|png)")


def read_record3d(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read a capture, or the captures of a folder, and unpack their images; scenes are named after them.

    Each is read in a process of its own, which a damaged file may end. Of a capture that was cut off, the
    frames that are whole are read. `Frame.index` is the number of the frame in its file name.

    Args:
        path: a .r3d file, an unpacked or exported capture, or a folder of any of them.
        unpack: returns the folder for the images of a scene, given its name.
        names: which captures to read, without suffix.
        metres_per_unit: unit of the depth; 1 by the format.
        camera: used instead of the file's.

    Raises:
        DataError: there is no capture, its metadata are lost, or no frame is complete.
    """
    path = path.absolute()
    places = sorted([*path.glob("*.r3d"), *filter(is_unpacked, (path, *folders_in(path)))])
    captures = {_name(place): place for place in places} if path.is_dir() else {path.stem: path}
    found = chosen(captures, names, path)
    if not found:
        raise DataError(f"{path} holds no .r3d file, and no metadata with rgbd/ or EXR_RGBD/")
    return [
        in_child(read_capture, name, place, unpack(name), metres_per_unit, camera, file=place)
        for name, place in found.items()
    ]


def is_record3d(path: Path) -> bool:
    """Whether there is a capture at the path, or in it."""
    if path.is_dir():
        return any(path.glob("*.r3d")) or any(map(is_unpacked, (path, *folders_in(path))))
    return path.suffix == ".r3d"


def is_unpacked(folder: Path) -> bool:
    """Whether the folder is an unpacked or exported capture, without that of its parent."""
    named = (folder / "metadata").is_file() and (folder / "rgbd").is_dir()
    images = (folder / "rgb").is_dir() and any((folder / "depth").glob("*.exr"))
    return named or (images and (folder / "metadata.json").is_file())


def _name(place: Path) -> str:
    """Name of a scene; an export lies in a folder EXR_RGBD of its own."""
    return place.parent.name if place.name == "EXR_RGBD" else place.stem if place.is_file() else place.name


@dataclass(frozen=True)
class _Said:
    """What the metadata say, checked."""

    camera: Camera
    color_px: tuple[int, int] | None
    depth_px: tuple[int, int] | None
    times_s: Sequence[float]
    fps: float
    poses: Sequence[Sequence[float]]
    cameras: Sequence[Sequence[float]]


def read_capture(
    name: str, path: Path, out: Path, metres_per_unit: float | None, camera: Camera | None
) -> Recording:
    """Read a capture in this process; arguments as `read_record3d`, errors too."""
    members = members_of(path)
    said = _metadata(path, members)
    numbered = {int(found[1]): member for member in members.read if (found := _COLOR.fullmatch(member))}
    frames: list[PhoneFrame] = []
    broken: list[int] = []
    marked = any(member.endswith(".conf") for member in members.read)
    for number, member in sorted(numbered.items()):
        try:
            depth, confident = _depth(path, members, member, said)
            content = members.read[member]()
        except DataError:
            broken.append(number)
            continue
        color = out / "rgb" / f"{number:06d}{Path(member).suffix}"
        write_bytes(color, content)
        units = stored_units(depth, metres_per_unit or 1.0, confident)
        own = tuple(said.cameras[number]) if number < len(said.cameras) else said.camera
        frames.append(
            PhoneFrame(number, _time_s(said, number), color, write_depth(out, number, units), None, own,
                       _pose(said, number))
        )  # fmt: skip
    skipped = (*members.lost, *grouped(broken, "with a damaged colour, depth or confidence image"))
    phone = Phone(name, path, "record3d", frames, (), said.color_px, 1.0, STORED_UNIT_M,
                  (DOUBTED,) if marked else (), skipped)  # fmt: skip
    return phone_recording(phone, lambda: out, metres_per_unit=metres_per_unit, camera=camera)


def _metadata(path: Path, members: Members) -> _Said:
    named = next((name for name in ("metadata", "metadata.json") if name in members.read), None)
    if named is None:
        raise DataError(f"{path} has no metadata: they were lost with its end; copy it again")
    with decoding(f"{path}: {named}", "copy the capture again"):
        data = json.loads(members.read[named]())
        return _Said(
            camera_of([float(value) for value in data["K"]], path),
            _size(data, "w", "h"),
            _size(data, "dw", "dh"),
            [float(time) for time in data.get("frameTimestamps") or []],
            float(data.get("fps") or 60),
            _rows(data.get("poses"), 7),
            _rows(data.get("perFrameIntrinsicCoeffs"), 4),
        )


def _size(data: Mapping[str, Any], width: str, height: str) -> tuple[int, int] | None:
    if width not in data or height not in data:
        return None
    found = int(data[width]), int(data[height])
    if min(found) < 1 or found[0] * found[1] > MOST_PIXELS:
        raise ValueError(f"images of {found[0]} x {found[1]} px")
    return found


def _rows(value: Any, width: int) -> list[list[float]]:
    rows = [[float(x) for x in row[:width]] for row in value or []]
    if any(len(row) != width for row in rows):
        raise ValueError(f"rows that do not have {width} numbers")
    return rows


def _time_s(said: _Said, number: int) -> float:
    return said.times_s[number] if number < len(said.times_s) else number / said.fps


def _pose(said: _Said, number: int) -> Transform | None:
    """scene_from_camera in OpenCV's axes; None where the frame has none."""
    row = np.array(said.poses[number]) if number < len(said.poses) else np.zeros(7)
    if not np.isfinite(row).all() or not 0.9 < np.linalg.norm(row[:4]) < 1.1:
        return None
    return from_quaternion_xyzw(row[:4], row[4:]) @ OPENGL_AXES


def _depth(path: Path, members: Members, color: str, said: _Said) -> tuple[np.ndarray, np.ndarray | None]:
    """Depth in metres, and which of it to trust; DataError where they are damaged."""
    stem = color.rpartition(".")[0]
    exr = f"depth/{Path(color).stem}.exr"
    if exr in members.read:
        return decoded_exr(members.read[exr](), path / exr), None
    width, height = said.depth_px or (192, 256)
    packed = members.read.get(f"{stem}.depth")
    if packed is None:
        raise DataError(f"{path}: {stem}.depth is missing")
    depth = np.frombuffer(_unpacked(path, packed(), 4 * width * height), "<f4").reshape(height, width)
    marks = members.read.get(f"{stem}.conf")
    if marks is None:
        return depth, None
    levels = np.frombuffer(_unpacked(path, marks(), width * height), np.uint8)
    return depth, levels.reshape(height, width) > 0


def _unpacked(path: Path, packed: bytes, size: int) -> bytes:
    """Undo LZFSE; DataError where the result would not have this size. No more memory is taken than that."""
    import imagecodecs

    try:
        content = bytes(imagecodecs.lzfse_decode(packed, out=size + 1))
    except (imagecodecs.LzfseError, ValueError, TypeError) as error:
        raise DataError(f"{path}: a depth image is damaged: {error}") from error
    if len(content) != size:
        raise DataError(f"{path}: a depth image has {len(content)} bytes instead of {size}")
    return content
