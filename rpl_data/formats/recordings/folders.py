"""A folder of colour images beside one of depth images, and a file with K: the commonest layout of all.

::

    <scene>/rgb/ or color/, colour/, images/, image/    0001.png ...; or .jpg
            depth/ or depths/                           0001.png 16 bit; or .npy, .exr, .tiff
            cam_K.txt, K.txt, intrinsics.txt, intrinsic.json, camera.json ...     may lie in the folder above
            pose/ or poses/0001.txt, or poses.txt       4x4, scene_from_camera; where there are any

So write FoundationPose and BundleSDF (`rgb`, `depth` in mm, `cam_K.txt`; their readme.md, "Run on your custom
data"), ScanNet's exporter (`color`, `depth` of another size, `pose` with -inf where it was lost,
`intrinsic/intrinsic_{color,depth}.txt` 4x4; SensReader/python/README.md), Open3D's recorders and their
`intrinsic.json` by columns (examples/python/reconstruction_system/sensors), Replica as NICE-SLAM has it
(`cam_params.json`, `traj.txt`), and HO3D, whose depth is packed into two channels of an 8-bit image.

Images are matched by their names, or by the numbers in them, and sorted as numbers. Names may be times; else
30 frames per second are assumed. Depth of another size is taken to come through the lens of the colour image,
unless `intrinsic_depth.txt` says otherwise. Files that tell of the same camera must agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rpl_data.files import read_text
from rpl_data.formats.recordings.camera_file import CameraFile, Told, refuse_other_camera, told_of
from rpl_data.formats.recordings.color_lens import COLOR_LENS
from rpl_data.formats.recordings.depth_files import (
    PACKED_UNIT_M,
    STORED_UNIT_M,
    is_packed,
    read_depth_file,
    stored_units,
    unit_of_decimals,
)
from rpl_data.formats.recordings.folder_images import (
    COLOR_SUFFIXES,
    images_by_key,
    numbers_of,
    paired_images,
)
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.image_headers import probe
from rpl_data.formats.recordings.matrices import (
    CameraSaid,
    numbers_in,
    read_matrix_camera,
    read_matrix_pose,
    rigid_or_none,
)
from rpl_data.formats.recordings.saved_images import write_depth
from rpl_data.formats.recordings.scene_folders import chosen_scenes, folders_in
from rpl_data.geometry import Transform
from rpl_data.types import DataError, Recording

COLOR_FOLDERS = (
    "rgb", "color", "colour", "images", "image", "imgs", "img", "color_images", "rgb_images", "color_image",
)  # fmt: skip
DEPTH_FOLDERS = ("depth", "depths", "depth_images", "depth_maps", "depth_image", "depth_png", "depth_raw")
COLOR_WORDS = ("rgb", "color", "colour", "image", "img", "frame", "left")
NO_COLOR_WORDS = ("depth", "mask", "seg", "conf", "normal")
NO_DEPTH_WORDS = ("conf", "mask", "vis", "preview", "depth_col", "colormap")
"""In names of folders that are none of the usual ones."""

CAMERA_FILES = (
    "cam_K.txt", "K.txt", "intrinsics.txt", "intrinsic.txt", "intrinsic/intrinsic_color.txt",
    "intrinsic_color.txt", "camera_intrinsics.txt", "camera-intrinsics.txt",
    "camera_intrinsics.json", "camera_intrinsic.json", "intrinsic.json", "intrinsics.json",
    "camera.json", "cam_params.json", "camera_matrix.csv", "K.json", "cam_K.json", "calib.txt",
    "calibration.txt", "calibration.json", "camera_info.yaml", "intrinsics.yaml", "camera.yaml", "K.npy",
    "cam_K.npy", "intrinsics.npy",
)  # fmt: skip
DEPTH_CAMERA_FILES = ("intrinsic/intrinsic_depth.txt", "intrinsic_depth.txt")
POSE_FOLDERS = ("pose", "poses", "cam_pose")
POSE_FILES = ("poses.txt", "pose.txt", "traj.txt", "trajectory.txt")


def read_folders(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
) -> list[Recording]:
    """Read one scene, or the scenes in the folders of a folder, sorted by name.

    `Frame.index` is the number in the file's name. Images stay where they are, except depth that is no 16-bit
    PNG, which is rewritten as one. Images without a partner, damaged ones, and frames without a valid pose
    where others have one, are left out and named in `Recording.skipped`.

    Args:
        path: a folder with colour and depth folders, or with such folders.
        unpack: returns the folder for depth images that must be rewritten, given the scene's name.
        names: which scenes to read, by folder name.
        metres_per_unit: unit of the depth images; 0.001 when neither given nor in the camera's file, 1 for
            decimal numbers, which `Recording.notes` says.
        camera: used instead of the camera's file.

    Raises:
        DataError: there is no such folder, no camera, no complete frame, or the depth unit is wrong.
    """
    path = path.absolute()
    scenes = chosen_scenes(path, is_folder_scene, names, lacks="rgb/ (color/, images/) with depth/")
    return [_read_scene(name, folder, unpack, metres_per_unit, camera) for name, folder in scenes.items()]


def is_folder_scene(folder: Path) -> bool:
    """Whether the folder has one of colour images beside one of depth images."""
    color, depth = _color_folder(folder), _depth_folder(folder)
    return color is not None and depth is not None and any(color.iterdir()) and any(depth.iterdir())


def _color_folder(folder: Path) -> Path | None:
    return _first(folder, COLOR_FOLDERS) or _only(folder, COLOR_WORDS, NO_COLOR_WORDS)


def _depth_folder(folder: Path) -> Path | None:
    return _first(folder, DEPTH_FOLDERS) or _only(folder, ("depth",), NO_DEPTH_WORDS)


def _only(folder: Path, words: Sequence[str], without: Sequence[str]) -> Path | None:
    """The folder of files in it with one of these words in its name; None where several have one."""
    names = {path: path.name.lower() for path in folders_in(folder)}
    found = [
        path
        for path, name in names.items()
        if any(word in name for word in words)
        and not any(word in name for word in without)
        and any(entry.is_file() for entry in path.iterdir())
    ]
    return found[0] if len(found) == 1 else None


def _first(folder: Path, names: Sequence[str]) -> Path | None:
    """The first of these that the folder has, in capitals or not."""
    if not folder.is_dir():
        return None
    found = {path.name.lower(): path for path in folder.iterdir()}
    return next((found[name] for name in names if name in found), None)


def _read_scene(
    name: str, folder: Path, unpack: Callable[[str], Path], unit_m: float | None, camera: Camera | None
) -> Recording:
    color_folder, depth_folder = _color_folder(folder), _depth_folder(folder)
    assert color_folder is not None and depth_folder is not None  # is_folder_scene
    found = paired_images(color_folder, depth_folder)
    pairs = found.pairs
    told = _told_of(folder, pairs, camera, unit_m)
    usual_m = told.metres_per_unit
    pairs, found_m, notes = _as_png(pairs, usual_m, lambda: unpack(name))
    listing = Listing(
        name,
        folder,
        "folders",
        pairs,
        told.camera or (),
        told.source,
        found_m or usual_m or 0.001,
        assumed_unit=found_m is None and usual_m is None,
        depth_camera=_depth_camera(folder),
        notes=(found.clock, *notes),
        skipped=found.alone,
    )
    recording = examine(listing)
    poses = _poses(folder, color_folder, pairs)
    if not poses:
        return without_poses(recording, "pose/ or poses.txt")
    valid = {index: pose for index, pose in poses.items() if pose is not None}
    return with_poses(recording, valid, without="without a valid pose (the tracker was lost there)")


# Images -------------------------------------------------------------------------------------------


def _as_png(
    pairs: list[Pair], unit_m: float | None, unpack: Callable[[], Path]
) -> tuple[list[Pair], float | None, tuple[str, ...]]:
    """Rewrite depth that is no 16-bit PNG; also its unit where the files tell, and what was assumed."""
    first = next((pair.depth for pair in pairs if pair.depth.stat().st_size), pairs[0].depth)
    header = probe(first) if first.suffix == ".png" else None
    if first.suffix == ".png" and (header is None or header.is_depth):
        return pairs, None, ()
    if first.suffix == ".png" and not is_packed(first):
        raise DataError(
            f"{first} holds 8 bits per channel: a picture of depth, not depth; export depth as 16-bit PNG"
        )
    folder, decimal_m = unpack(), None
    notes: tuple[str, ...] = ()
    rewritten: list[Pair] = []
    for pair in pairs:
        try:
            depth = read_depth_file(pair.depth)
        except DataError:  # reported as unreadable, like every damaged image
            rewritten.append(pair)
            continue
        if depth.dtype.kind == "f" and decimal_m is None:
            decimal_m = unit_of_decimals(depth) if unit_m is None else unit_m
            notes = (f"depth in decimal numbers: {decimal_m:g} m per unit",)
        units = stored_units(depth, decimal_m if depth.dtype.kind == "f" else None)
        path = write_depth(folder, pair.index, units)
        rewritten.append(Pair(pair.index, pair.timestamp_s, pair.color, path))
    packed_m = PACKED_UNIT_M if first.suffix == ".png" and unit_m is None else None
    return rewritten, STORED_UNIT_M if decimal_m else packed_m, notes


# Camera and poses ---------------------------------------------------------------------------------


def _told_of(folder: Path, pairs: Sequence[Pair], camera: Camera | None, unit_m: float | None) -> Told:
    """Camera and depth unit by `CAMERA_FILES`, which must agree, and camera.txt; DataError without any."""
    places = ([place / name for name in CAMERA_FILES] for place in (folder, folder.parent))
    files = next((some for place in places if (some := [path for path in place if path.is_file()])), [])
    own = None
    if files and camera is None:
        said = read_matrix_camera(files[0])
        _refuse_other_size(pairs, said, files[0])
        own = CameraFile(said.camera, said.metres_per_unit)
        for path in files[1:]:
            other = read_matrix_camera(path)
            if other.size is None or said.size is None or other.size == said.size:
                refuse_other_camera(said.camera, files[0], other.camera, path)
    source = files[0] if files else None
    told = told_of(folder, camera=camera, metres_per_unit=unit_m, own=own, own_source=source)
    if told.camera is None:
        raise DataError(
            f"{folder} has no file with its camera; write fx fy cx cy, or the matrix K, into cam_K.txt, or "
            "give `camera: [fx, fy, cx, cy]`"
        )
    return told


def _depth_camera(folder: Path) -> Camera:
    """Camera of the depth images, where the folder has a file for it."""
    files = [place / name for place in (folder, folder.parent) for name in DEPTH_CAMERA_FILES]
    found = next((path for path in files if path.is_file()), None)
    return COLOR_LENS if found is None else read_matrix_camera(found).camera


def _refuse_other_size(pairs: Sequence[Pair], said: CameraSaid, source: Path) -> None:
    """Raise a DataError when the camera's file is about images of another size."""
    headers = (probe(pair.color) for pair in pairs)
    color = next((header for header in headers if header is not None), None)
    if said.size is not None and color is not None and said.size != (color.width, color.height):
        raise DataError(
            f"{source} is for images of {said.size[0]} x {said.size[1]} px, but they have {color.width} x "
            f"{color.height}; give `camera: [fx, fy, cx, cy]` for these"
        )


def _poses(folder: Path, color_folder: Path, pairs: Sequence[Pair]) -> Mapping[int, Transform | None]:
    """Poses by `Frame.index`; None for a lost one, empty where the scene has none."""
    place = _first(folder, POSE_FOLDERS)
    if place is not None and place.is_dir():
        files = images_by_key(place, (".txt", ".npy"))
        own = {pair.index: files.get(numbers_of(pair.color)) for pair in pairs}
        return {index: read_matrix_pose(path) for index, path in own.items() if path is not None}
    file = _first(folder, POSE_FILES)
    if file is None:
        return {}
    rows = _pose_rows(file)
    order = sorted(images_by_key(color_folder, COLOR_SUFFIXES))
    numbered = len(rows) != len(order) and max(pair.index for pair in pairs) < len(rows)
    row_of = {pair.index: pair.index if numbered else order.index(numbers_of(pair.color)) for pair in pairs}
    return {index: rows[row] for index, row in row_of.items() if row < len(rows)}


def _pose_rows(file: Path) -> list[Transform | None]:
    """Poses of a file with 12 or 16 numbers per line, or 4 lines of 4 per pose."""
    lines = [numbers_in(line) for line in read_text(file, errors="replace").splitlines()]
    rows = [line for line in lines if line]
    if rows and all(len(row) == 4 for row in rows[:4]):
        rows = [sum(rows[at : at + 4], []) for at in range(0, len(rows) - 3, 4)]
    if not rows or len(rows[0]) not in (12, 16):
        raise DataError(
            f"{file}: expected 12 or 16 numbers per line, scene_from_camera, found "
            f"{len(rows[0]) if rows else 0}; correct it, or take it out to have the camera tracked"
        )
    return [rigid_or_none(row) for row in rows]
