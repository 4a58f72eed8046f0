"""Read ROS bags: colour, depth on the pixels of colour, the camera and, where asked for, its poses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from rpl_data.formats.recordings.color_lens import camera_numbers
from rpl_data.formats.recordings.depth_files import STORED_UNIT_M, stored_units, unit_of_decimals
from rpl_data.formats.recordings.frame_files import (
    Camera,
    Listing,
    Pair,
    examine,
    grouped,
    with_poses,
    without_poses,
)
from rpl_data.formats.recordings.partners import partners
from rpl_data.formats.recordings.ros.bags import SUFFIXES, Bag, bags_at
from rpl_data.formats.recordings.ros.decode import color_of, decoded, depth_of
from rpl_data.formats.recordings.ros.poses import POSE_TYPES, TF_TYPES, poses_from_messages, poses_from_tree
from rpl_data.formats.recordings.ros.streams import Streams, streams_of
from rpl_data.formats.recordings.ros.survey import Survey, survey_of, times_ns
from rpl_data.formats.recordings.ros.topics import ImageTopic
from rpl_data.formats.recordings.ros.video import VideoDecoder, VideoPacket
from rpl_data.formats.recordings.ros.wanted import Topics
from rpl_data.formats.recordings.saved_images import write_color, write_depth
from rpl_data.formats.recordings.scene_folders import chosen
from rpl_data.types import DataError, Recording
from rpl_data.untrusted.child import in_child
from rpl_data.wording import counted

MEMORY_BYTES = 6 * 2**30
"""Largest address space of the process that reads a bag; its images take a few megabytes at a time."""


def read_ros(
    path: Path,
    *,
    unpack: Callable[[str], Path],
    names: Sequence[str] | None = None,
    metres_per_unit: float | None = None,
    camera: Camera | None = None,
    topics: Topics | None = None,
) -> list[Recording]:
    """Read the ROS bags of a folder, or one, and unpack their images; scenes are named after bags.

    Each bag is read in a process of its own. Times are those of the headers. Depth that a driver has not
    moved onto the colour image keeps its own camera (camera_info and /tf_static or extrinsics). Of a bag that
    was cut off or never closed, what is complete is read, and the loss is named in `Recording.skipped`.

    Args:
        path: a .bag, .db3 or .mcap file, the folder of a ROS 2 bag, or a folder of these.
        unpack: returns the folder for the images of a scene, given its name.
        names: which bags to read.
        metres_per_unit: of the stored depth: 0.001 for 16UC1 and 1 for 32FC1 when left out.
        camera: used instead of the colour images' camera_info.
        topics: which topics to use; found by their names when left out.

    Raises:
        DataError: there is no bag, it lacks colour, depth or their camera, or topics must be chosen.
    """
    path = path.absolute()
    found = bags_at(path)
    if not found:
        raise DataError(f"{path} holds no ROS bag ({', '.join(SUFFIXES)})")
    recordings = []
    for name in chosen({name: files[0] for name, files in found.items()}, names, path):
        files, folder = found[name], unpack(name)
        arguments = (name, files, folder, metres_per_unit, camera, topics or Topics())
        recordings.append(in_child(read_bag, *arguments, file=files[0], memory_bytes=MEMORY_BYTES))
    return recordings


def has_bags(path: Path) -> bool:
    """Whether the path is, or holds, a ROS bag that is not librealsense's own recording."""
    return bool(bags_at(path))


def read_bag(
    name: str,
    files: tuple[Path, ...],
    folder: Path,
    unit_m: float | None,
    camera: Camera | None,
    topics: Topics,
) -> Recording:
    """Read one bag, as `read_ros` does in a process of its own.

    Args:
        name: name of the scene.
        files: the files of the bag, in order.
        folder: where to unpack its images.
        unit_m: metres per unit of the stored depth.
        camera: camera of the colour images.
        topics: topics to use.
    """
    bag = Bag(files, folder)
    try:
        survey = bag.mended(partial(survey_of, poses=topics.poses))
        streams = streams_of(survey, topics, camera, files[0])
        is_float, decimal_m, notes = _decimals(streams, unit_m)
        pairs, skipped = _unpack(bag, streams, folder, decimal_m if is_float else None)
    finally:
        bag.close()
    stored_m = 0.001 if unit_m is None else unit_m
    listing = Listing(
        name,
        files[0] if len(files) == 1 else files[0].parent,
        "ros",
        pairs,
        camera_numbers(streams.camera),
        Path(streams.camera_source),
        STORED_UNIT_M if is_float else stored_m,
        registered=streams.registered,
        depth_camera=None if streams.depth_camera is None else camera_numbers(streams.depth_camera),
        color_from_depth=streams.color_from_depth,
        notes=(*streams.notes, *notes, *_parts(files)),
        skipped=(*bag.lost, *skipped),
    )
    return _posed(examine(listing), survey, streams.color, topics)


def _parts(files: Sequence[Path]) -> list[str]:
    """A note that several files are taken for one recording."""
    return [f"{', '.join(file.name for file in files)} are read as one recording"] if len(files) > 1 else []


def _decimals(streams: Streams, unit_m: float | None) -> tuple[bool, float, tuple[str, ...]]:
    """Whether depth is in decimal numbers, and their unit: metres by the rules, but some drivers write mm."""
    first = depth_of(streams.depth.first)
    if first is None or first[1]:
        return False, 1.0, ()
    found_m = unit_of_decimals(first[0]) if unit_m is None else unit_m
    return True, found_m, (f"depth in decimal numbers: {found_m:g} m per unit",) if found_m != 1 else ()


def _unpack(
    bag: Bag, streams: Streams, folder: Path, decimal_m: float | None
) -> tuple[list[Pair], list[str]]:
    """Write the images that have a partner, with the unit of decimal depth; also what was left out."""
    color_ns, depth_ns = times_ns(streams.color)[0], times_ns(streams.depth)[0]
    paired = partners(color_ns, depth_ns)
    number_of = {color: index for index, color in enumerate(np.argsort(color_ns, kind="stable").tolist())}
    colors, depths = _saved(
        bag,
        streams,
        {color: number_of[color] for color in paired},
        {depth: number_of[color] for color, depth in paired.items()},
        partial(_save_color, folder),
        partial(_save_depth, folder, decimal_m),
    )
    whole = colors.keys() & depths.keys()
    both = [color for color in np.argsort(color_ns, kind="stable").tolist() if number_of[color] in whole]
    if not both:
        raise DataError(
            f"no colour image of {streams.color.name} has a depth image of {streams.depth.name} at its time; "
            "record both at the same rate"
        )
    times_s = color_ns // 10**9 + color_ns % 10**9 * 1e-9
    numbers = [number_of[color] for color in both]
    pairs = [
        Pair(number, float(times_s[color]), colors[number], depths[number])
        for color, number in zip(both, numbers, strict=True)
    ]
    alone = len(color_ns) - len(paired)
    lines = [f"{counted(alone, 'colour image')} without depth at the same time"] if alone else []
    broken = sorted({number_of[color] for color in paired} - set(numbers))
    return pairs, [*lines, *grouped(broken, "with a damaged image in the bag")]


def _saved(
    bag: Bag,
    streams: Streams,
    color_index: Mapping[int, int],
    depth_index: Mapping[int, int],
    save_color: Callable[[int, Any], Path | None],
    save_depth: Callable[[int, Any], Path | None],
) -> tuple[dict[int, Path], dict[int, Path]]:
    """Save the images whose place in their topic has an index; the files of colour and of depth by index."""
    jobs = {
        streams.color.name: (count(), color_index, save_color, dict[int, Path]()),
        streams.depth.name: (count(), depth_index, save_depth, dict[int, Path]()),
    }
    first = streams.color.first
    video = VideoDecoder(first.format) if isinstance(first, VideoPacket) else None
    for message in bag.messages(list(jobs)):
        place, index_of, save, files = jobs[message.topic]
        number = next(place)
        if video is not None and message.topic == streams.color.name:
            packet = decoded(message)
            if packet is not None:
                _save_pictures(video.push(number, packet.packet), index_of, save, files)
            continue
        index = index_of.get(number)
        image = None if index is None else decoded(message)
        path = None if image is None or index is None else save(index, image)
        if path is not None and index is not None:
            files[index] = path
    if video is not None:
        _save_pictures(video.flush(), color_index, save_color, jobs[streams.color.name][3])
    return jobs[streams.color.name][3], jobs[streams.depth.name][3]


def _save_pictures(
    pictures: Iterable[tuple[int, np.ndarray]],
    index_of: Mapping[int, int],
    save: Callable[[int, Any], Path | None],
    files: dict[int, Path],
) -> None:
    """Save the pictures of a video whose place in their topic has an index."""
    for number, pixels in pictures:
        path = save(index_of[number], pixels) if number in index_of else None
        if path is not None:
            files[index_of[number]] = path


def _save_color(folder: Path, index: int, image: Any) -> Path | None:
    pixels = image if isinstance(image, np.ndarray) else color_of(image)
    return None if pixels is None else write_color(folder, index, pixels)


def _save_depth(folder: Path, decimal_m: float | None, index: int, image: Any) -> Path | None:
    """Save a depth image in whole numbers; None for a damaged one, or one of another kind than the first."""
    found = depth_of(image)
    if found is None or found[1] == (decimal_m is not None):
        return None
    return write_depth(folder, index, stored_units(found[0], decimal_m))


def _posed(recording: Recording, survey: Survey, color: ImageTopic, topics: Topics) -> Recording:
    """Add the poses that were asked for."""
    if topics.poses is None:
        able = [name for name, kind in survey.types.items() if kind in (*POSE_TYPES, *TF_TYPES)]
        there = f"; the bag has {', '.join(able)}" if able else ""
        return without_poses(recording, f"topic of poses named (`topics: {{poses: ...}}`{there})")
    frames = recording.scene.frames
    times_s = np.array([frame.timestamp_s for frame in frames])
    if topics.poses.lstrip("/") == "tf":
        poses, note = poses_from_tree(survey.tree, color.frame, topics.frame, times_s)
    else:
        poses, note = poses_from_messages(survey.poses, topics.poses, survey.tree, color.frame, times_s)
    found = {frame.index: pose for frame, pose in zip(frames, poses, strict=True) if pose is not None}
    posed = with_poses(recording, found, without=f"without a pose in {topics.poses} at their time")
    return Recording(posed.scene, posed.trajectory, posed.skipped, (*posed.notes, note))
