"""Files of phones and of folders of images, and what reads them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from exr_writer import exr_bytes
from phone_writers import Film, write_nerfstudio, write_polycam, write_r3d, write_stray

Parser = Callable[[Path], Any]


def recorder_seeds(folder: Path) -> Iterator[tuple[str, Path, Parser]]:
    """A good file of each kind, and what reads it."""
    from rpl_data.formats.containers.exr import read_exr
    from rpl_data.formats.containers.video import video_frames
    from rpl_data.formats.recordings import depth_files, matrices, stray

    depth_m = np.random.default_rng(0).uniform(0.5, 1, (24, 32)).astype(np.float32)
    colors = [np.random.default_rng(n).integers(0, 255, (48, 64, 3), np.uint8) for n in range(3)]
    film = Film(colors, [depth_m] * 3, np.tile(np.eye(4), (3, 1, 1)), (50.0, 50.0, 31.5, 23.5))
    (folder / "depth.exr").write_bytes(exr_bytes(depth_m))
    yield "EXR", folder / "depth.exr", read_exr
    np.save(folder / "depth.npy", depth_m)
    yield "npy depth", folder / "depth.npy", depth_files.read_depth_file
    write_r3d(folder / "capture.r3d", film)
    yield "Record3D", folder / "capture.r3d", partial(_read_r3d, folder / "out")
    write_stray(folder / "stray", film)
    yield "video", folder / "stray/rgb.mp4", lambda path: list(video_frames(path))
    shutil.copy(folder / "stray/odometry.csv", folder / "odometry.csv")
    yield "odometry", folder / "odometry.csv", stray.read_odometry
    (folder / "cam_K.txt").write_text("50 0 31.5\n0 50 23.5\n0 0 1\n")
    yield "camera matrix", folder / "cam_K.txt", matrices.read_matrix_camera
    open3d = {
        "width": 64,
        "height": 48,
        "intrinsic_matrix": [50, 0, 0, 0, 50, 0, 31.5, 23.5, 1],
        "scale": 1000,
    }
    (folder / "intrinsic.json").write_text(json.dumps(open3d))
    yield "camera JSON", folder / "intrinsic.json", matrices.read_matrix_camera
    write_nerfstudio(folder / "nerfstudio", film)
    shutil.copy(folder / "nerfstudio/transforms.json", folder / "transforms.json")
    yield (
        "transforms.json",
        folder / "transforms.json",
        partial(_read, folder / "nerfstudio", "transforms.json"),
    )
    write_polycam(folder / "polycam", film)
    name = "keyframes/corrected_cameras/99900000.json"
    shutil.copy(folder / "polycam" / name, folder / "polycam.json")
    yield "Polycam camera", folder / "polycam.json", partial(_read, folder / "polycam", name)


def _read_r3d(out: Path, path: Path) -> None:
    from rpl_data.files import decoding
    from rpl_data.formats.recordings.record3d import read_capture

    with decoding(path, "copy it again"):
        read_capture("a", path, out, None, None)


def _read(recording: Path, name: str, path: Path) -> None:
    """Read a recording with one of its files exchanged."""
    from rpl_data.recordings.open import likely_formats, open_scenes

    shutil.copy(path, recording / name)
    open_scenes(recording, likely_formats(recording)[0], unpack=(recording / "unpacked").joinpath)
