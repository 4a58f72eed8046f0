"""What is installed: the lines of `rpl doctor`."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from rpl_data.version import installed_version


@dataclass(frozen=True)
class Part:
    """A package, and what does not work without it.

    Attributes:
        package: its name on the package index.
        module: what is imported.
        purpose: what it is needed for.
        remedy: how to get it.
        optional: whether few will need it, so that it is not missed where it is not installed.
    """

    package: str
    module: str
    purpose: str
    remedy: str = "pip install rpl-data"
    optional: bool = False


PARTS = (
    Part("numpy", "numpy", "everything"),
    Part("scipy", "scipy", "solving"),
    Part("opencv-python-headless", "cv2", "images"),
    Part("open3d", "open3d", "surfaces, masks"),
    Part("small_gicp", "small_gicp", "tracking, surfaces"),
    Part("pycocotools", "pycocotools", "masks, exports"),
    Part("fastapi", "fastapi", "the annotation page"),
    Part("torch", "torch", "Datasets, training"),
    Part("torchvision", "torchvision", "Datasets, training"),
    Part(
        "pyrealsense2",
        "pyrealsense2",
        "RealSense cameras, .bag and .db3 files of theirs",
        "pip install pyrealsense2; no wheels for macOS and ARM: build librealsense for Python there",
    ),
    Part("rosbags", "rosbags", "ROS bags"),
    Part("av", "av", "videos of phones, Azure Kinect"),
    Part("imagecodecs", "imagecodecs", "depth of Record3D"),
    Part(
        "pytorch-lightning", "pytorch_lightning", "the training programs", "pip install 'rpl-data[training]'"
    ),
    Part("tensorboard", "tensorboard", "curves of a training", "pip install 'rpl-data[training]'"),
    Part(
        "distributed",
        "distributed",
        "builds on a Dask cluster",
        "pip install 'rpl-data[dask]'",
        optional=True,
    ),
    Part("s3fs", "s3fs", "recordings and exports in S3", "pip install 'rpl-data[s3]'", optional=True),
    Part("depthai", "depthai", "capture with OAK cameras", "pip install 'rpl-data[oak]'", optional=True),
    Part(
        "pyorbbecsdk2",
        "pyorbbecsdk",
        "capture with Orbbec cameras",
        "pip install --no-deps pyorbbecsdk2",
        optional=True,
    ),
    Part(
        "pyk4a",
        "pyk4a",
        "capture with an Azure Kinect",
        "Microsoft's Azure Kinect Sensor SDK, then pip install 'rpl-data[k4a]'",
        optional=True,
    ),
    Part("record3d", "record3d", "capture with phones", "pip install 'rpl-data[phone]'", optional=True),
)


def machine_lines() -> list[str]:
    """Versions, cores, memory, free disk, and whether there is a GPU."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    lines = [
        f"rpl-data {installed_version()}, Python {platform.python_version()} at {sys.prefix}",
        f"{platform.system()} {platform.machine()}, {cores} cores{_memory()}",
        f"{_free_gib():.0f} GiB free on the disk of this folder",
    ]
    return [*lines, _gpu()]


def package_lines() -> list[str]:
    """A line per package; what is missing says what does not work, and what to run."""
    return [_line(part) for part in PARTS]


def _line(part: Part) -> str:
    if importlib.util.find_spec(part.module) is None:
        if part.optional:
            return f"  optional {part.package}: {part.purpose}, not installed; {part.remedy}"
        return f"  missing  {_without(part)}"
    try:
        version = importlib.metadata.version(part.package)
    except importlib.metadata.PackageNotFoundError:  # installed by other means than a package
        version = "installed"
    return f"  ok       {part.package} {version}: {part.purpose}"


def missing_package(error: ModuleNotFoundError) -> str | None:
    """What to say where a package of ours is not installed; None for a fault of another kind."""
    module = (error.name or "").partition(".")[0]
    return next((f"missing {_without(part)}" for part in PARTS if part.module == module), None)


def _without(part: Part) -> str:
    return f"{part.package}: {part.purpose} will not work; {part.remedy}"


def _memory() -> str:
    """Memory in GiB, where the system says it the way Linux does."""
    try:
        size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return ""
    return f", {size / 2**30:.0f} GiB of memory"


def _free_gib() -> float:
    return shutil.disk_usage(Path.cwd()).free / 2**30


def _gpu() -> str:
    if importlib.util.find_spec("torch") is None:
        return "no PyTorch, so no GPU was looked for"
    from rpl_data.torch.device import accelerator

    found = accelerator()
    return f"GPU for training: {found}" if found else "no GPU: labelling needs none, training takes the CPU"
