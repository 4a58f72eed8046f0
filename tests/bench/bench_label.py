"""Labelling on one core: frames/s with and without depth decoding, beside the point splat; memory.

    python tests/bench/bench_label.py [FRAMES]

640x480, 20,480 triangles, a mask of about 16,000 px, an occluder, sensor noise and missing depth.
Times are the processor's, so that a busy machine does not distort them. There are two baselines, both of the
original tool (RapidPoseLabels, `src/utils/annotations.py`), re-implemented. Its mask: every point of a 5 mm
voxel cloud drawn as a disc of radius 2 px, a 5x5 closing, the first contour filled; no depth, no occlusion.
Its whole path: the colour image decoded, that mask, the image encoded again, the mask as PNG, and four text
files. Peak memory is read after 100 frames and after FRAMES (default 10,000), labels written to disk.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from rows import record, shared

from rpl_data.geometry import from_rotvec, invert, project, transform
from rpl_data.images import depth_reader, read_depth_m
from rpl_data.label.alone import SceneObject
from rpl_data.label.label import label_frames
from rpl_data.raycast import RayScene, render_depth_m
from rpl_data.types import (
    Frame,
    FrameLabel,
    Intrinsics,
    KeypointModel,
    Mesh,
    ReadDepth,
    ReadDepthInto,
    Scene,
    Trajectory,
)
from rpl_data.workspace.depth_cache import cached_reader, cached_window_reader
from rpl_data.workspace.workspace import Workspace

CAMERA = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
FILES = 60
PASSES = 5
"""So often the images are labelled in a round: preparing the object counts as in 300 frames."""
ROUNDS = 5
ASKED = 300.0


def bumpy_ball() -> Mesh:
    """20,480 triangles around the origin, 0.2 m across."""
    ball = o3d.geometry.TriangleMesh.create_icosahedron().subdivide_loop(5)
    points = np.asarray(ball.vertices)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    radius = 0.095 + 0.01 * np.sin(7 * points[:, :1]) * np.cos(9 * points[:, 1:2])
    return Mesh(points * radius, np.asarray(ball.triangles).astype(np.int64))


def make_scene(folder: Path, mesh: Mesh, number: int) -> tuple[Scene, Trajectory]:
    """A camera going round the object; `FILES` depth images, used again and again."""
    rng = np.random.default_rng(0)
    rays = RayScene([mesh])
    poses = [
        from_rotvec(np.array([0, 2 * np.pi * i / FILES, 0]), np.zeros(3))
        @ from_rotvec(np.array([0.3, 0, 0]), np.zeros(3))
        @ from_rotvec(np.zeros(3), np.array([0.0, 0, -0.82]))
        for i in range(FILES)
    ]
    for i, pose in enumerate(poses):
        depth = render_depth_m(rays, CAMERA, invert(pose), left_px=0, top_px=0, width=640, height=480)
        depth[depth == 0] = 1.3 + 0.001 * np.arange(480)[np.nonzero(depth == 0)[0]]
        depth[260:330, 250:330] = 0.6  # the occluder
        depth += rng.normal(0, 0.0015, depth.shape).astype(np.float32)
        depth[rng.random(depth.shape) < 0.02] = 0
        cv2.imwrite(str(folder / f"{i:06d}.png"), (depth * 1000).astype(np.uint16))
    frames = tuple(
        Frame(i, i / 30, folder / "none.png", folder / f"{i % FILES:06d}.png") for i in range(number)
    )
    trajectory = Trajectory(np.arange(number), np.array([poses[i % FILES] for i in range(number)]))
    return Scene("bench", CAMERA, 0.001, frames), trajectory


def splat_mask(points_camera: np.ndarray) -> np.ndarray:
    """The original's mask: discs, closing, first contour."""
    mask = np.zeros((480, 640), np.uint8)
    for u, v in np.rint(project(CAMERA, points_camera)).astype(int):
        cv2.circle(mask, (int(u), int(v)), 2, 255, -1)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    contours, _ = cv2.findContours(mask, cv2.RETR_TREE, cv2.CHAIN_APPROX_SIMPLE)
    filled = np.zeros_like(mask)
    cv2.drawContours(filled, contours, 0, 255, -1)
    return filled


def published_path(folder: Path, color: Path, number: int, points_camera: np.ndarray) -> None:
    """The original's work for a frame: labels beside a copy of the image, in the formats it writes.

    Its loop takes each point as a row of an array, and each of its coordinates as a number of NumPy's.
    """
    image = cv2.resize(cv2.imread(str(color)), (640, 480))
    none = np.zeros(3)
    seen, _ = cv2.projectPoints(points_camera, none, none, CAMERA.matrix, None)
    mask = np.zeros((480, 640), np.uint8)
    for point in seen[:, 0]:
        cv2.circle(mask, tuple(map(int, point)), 2, 255, -1)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(mask, contours, 0, 255, -1)
    cv2.imwrite(str(folder / f"{number}.jpg"), image)
    cv2.imwrite(str(folder / f"{number}_mask.png"), mask)
    rows, columns = np.nonzero(mask)
    box = (columns.min(), rows.min(), columns.max(), rows.max())
    keypoints = project(CAMERA, points_camera[:12])
    for name, values in (("bbox", box), ("centre", np.mean([box[:2], box[2:]], axis=0)),
                         ("keypoints", keypoints), ("label", (0, *box))):  # fmt: skip
        np.savetxt(folder / f"{number}_{name}.txt", np.atleast_2d(values))


def rate(frames: int, seconds: float) -> str:
    """Frames/s and ms."""
    return f"{frames / seconds:8.1f} frames/s  {seconds / frames * 1000:6.2f} ms"


def peak_mb() -> float:
    """The largest resident size of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def timed(work: Callable[[], object], frames: int) -> list[float]:
    """Frames/s of the processor's time, once per round, after one that warms up."""
    work()
    rates = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work()
        rates.append(frames / (time.process_time() - start))
    return rates


@dataclass(frozen=True)
class Recorded:
    """A made recording, and what is labelled in it."""

    folder: Path
    scene: Scene
    trajectory: Trajectory
    item: SceneObject

    def labels(self, read: ReadDepth, into: ReadDepthInto | None = None) -> list[FrameLabel]:
        """Labels of the frames with images of their own, several times over."""
        frames = self.scene.frames[:FILES] * PASSES
        return list(
            label_frames(self.scene, self.trajectory, [self.item], frames, read, read_depth_into=into)
        )

    def seen(self, points: np.ndarray) -> Iterator[np.ndarray]:
        """Points in the camera frame of each of those frames."""
        for pose in self.trajectory.scene_from_camera[:FILES]:
            yield transform(invert(pose), points)


def baselines(made: Recorded, points: np.ndarray) -> tuple[list[float], list[float]]:
    """Frames/s of the point splat and of the published code's whole path."""
    photo = np.random.default_rng(1).normal(120, 40, (120, 160, 3)).clip(0, 255).astype(np.uint8)
    color = made.folder / "color.jpg"
    cv2.imwrite(str(color), cv2.resize(photo, (640, 480), interpolation=cv2.INTER_CUBIC))

    def splat() -> None:
        for seen in made.seen(points):
            splat_mask(seen)

    numbers = count()  # files of their own for every frame, as the original has it

    def published() -> None:
        for seen in made.seen(points):
            published_path(made.folder, color, next(numbers), seen)

    return timed(splat, FILES), timed(published, FILES)


def said(name: str, rates: list[float], beside: list[float]) -> None:
    """Print a rate, and its ratio to another."""
    found = float(np.median(rates))
    print(f"{name:38}{rate(1, 1 / found)}  ratio {found / np.median(beside):.2f}", flush=True)


def labelling(made: Recorded, splat: list[float], published: list[float]) -> None:
    """Label with depth at hand and from the cache."""
    decoded = {frame: read_depth_m(made.scene, frame) for frame in made.scene.frames[:FILES]}
    cache = made.folder / "cache"
    keep = cached_reader(cache, made.scene, keep=True)
    for frame in decoded:
        keep(frame)
    into = cached_window_reader(cache, made.scene)
    by_splat = ("point splat, mask only", float(np.median(splat)))
    by_published = ("the published code's whole path", float(np.median(published)))
    asked = (f"{ASKED} frames/s, asked", ASKED)
    runs: dict[str, Callable[[], object]] = {
        "depth at hand, occlusion": lambda: made.labels(decoded.__getitem__),
        "depth from the cache, occlusion": lambda: made.labels(keep, into),
    }
    for work, run in runs.items():
        rates = timed(run, FILES * PASSES)
        said(f"labels, {work}", rates, published)
        record("label", work, rates, "frames/s", baseline=by_splat, more_is_better=True)
        beside = {"baseline": by_published, "asked": 10.0, "more_is_better": True}
        record("label", f"{work}, beside the published path", rates, "frames/s", **beside)
        of_asked = {"baseline": asked, "asked": 1.0, "more_is_better": True}
        record("label", f"{work}, of the rate asked", rates, "frames/s", **of_asked)
    reading(made, keep, into)


def reading(made: Recorded, keep: ReadDepth, into: ReadDepthInto) -> None:
    """Read depth images: all of a PNG, all of a cached image, and a window of it."""
    frames, image = made.scene.frames[:FILES], np.zeros((CAMERA.height, CAMERA.width), np.float32)
    window = (slice(140, 340), slice(220, 420))
    png = timed(lambda: [read_depth_m(made.scene, frame) for frame in frames], FILES)
    baseline = ("a depth PNG decoded", float(np.median(png)))
    runs: dict[str, Callable[[], object]] = {
        "a cached depth image read": lambda: [keep(frame) for frame in frames],
        "200 x 200 px of a cached depth image read": lambda: [into(frame, window, image) for frame in frames],
    }
    said("reading a depth PNG", png, png)
    for work, run in runs.items():
        rates = timed(run, FILES)
        said(work, rates, png)
        record("label", work, rates, "images/s", baseline=baseline, more_is_better=True)


def to_disk(made: Recorded, most: int, published: list[float]) -> None:
    """Label from PNG to labels on disk, and say the peak of memory."""
    workspace = Workspace(made.folder / "workspace")
    baseline = ("the published code's whole path", float(np.median(published)))
    for frames in (100, most):
        start = time.process_time()
        found = label_frames(
            made.scene, made.trajectory, [made.item], made.scene.frames[:frames], depth_reader(made.scene)
        )
        workspace.save_labels("bench", found)
        found_rate = frames / (time.process_time() - start)
        work = f"{frames} frames, PNG to labels on disk"
        record("label", work, found_rate, "frames/s", baseline=baseline, more_is_better=True)
        said(work, [found_rate], published)
        print(f"peak {peak_mb():.1f} MB", flush=True)


def main(frames: int) -> None:
    """Print everything."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one core, whatever threads libraries start
    mesh = bumpy_ball()
    keypoints = mesh.vertices[:: len(mesh.vertices) // 12][:12]
    model = KeypointModel("ball", tuple(f"k{i}" for i in range(12)), keypoints)
    item = SceneObject(model, np.tile(np.eye(3) * 1e-6, (12, 1, 1)), mesh, np.eye(4))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mesh.vertices)).voxel_down_sample(0.005)
    points = np.asarray(cloud.points)
    with tempfile.TemporaryDirectory() as folder:
        made = Recorded(Path(folder), *make_scene(Path(folder), mesh, frames), item)
        found = made.labels(partial(read_depth_m, made.scene))[:FILES]
        area = sum(int(c) for c in _areas(found)) / len(found)
        print(
            f"{len(mesh.triangles)} triangles, cloud {len(points)} points, full mask {area:.0f} px, "
            f"visible {found[0].instances[0].visib_fract:.2f}, one core"
        )
        splat, published = baselines(made, points)
        said("point splat (mask only)", splat, published)
        said("published code's whole path", published, published)
        labelling(made, splat, published)
        to_disk(made, frames, published)


def _areas(found: list[FrameLabel]) -> Iterator[int]:
    from pycocotools import mask as coco

    for label in found:
        rle = label.instances[0].mask_full
        yield int(coco.area({"size": rle["size"], "counts": rle["counts"].encode()}))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else shared(10_000, least=1_000))
