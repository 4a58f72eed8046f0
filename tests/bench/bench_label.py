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
from collections.abc import Iterator, Sequence
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
from rpl_data.types import Frame, FrameLabel, Intrinsics, KeypointModel, Mesh, Scene, Trajectory
from rpl_data.workspace.depth_cache import cached_reader
from rpl_data.workspace.workspace import Workspace

CAMERA = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
FILES = 60


def bumpy_ball() -> Mesh:
    """20,480 triangles around the origin, 0.2 m across."""
    ball = o3d.geometry.TriangleMesh.create_icosahedron().subdivide_loop(5)
    points = np.asarray(ball.vertices)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    radius = 0.095 + 0.01 * np.sin(7 * points[:, :1]) * np.cos(9 * points[:, 1:2])
    return Mesh(points * radius, np.asarray(ball.triangles).astype(np.int64))


def make_scene(folder: Path, mesh: Mesh, count: int) -> tuple[Scene, Trajectory]:
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
        Frame(i, i / 30, folder / "none.png", folder / f"{i % FILES:06d}.png") for i in range(count)
    )
    trajectory = Trajectory(np.arange(count), np.array([poses[i % FILES] for i in range(count)]))
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


def rate(count: int, seconds: float) -> str:
    """Frames/s and ms."""
    return f"{count / seconds:8.1f} frames/s  {seconds / count * 1000:6.2f} ms"


def peak_mb() -> float:
    """The largest resident size of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(count: int) -> None:
    """Print everything."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one core, whatever threads libraries start
    mesh = bumpy_ball()
    keypoints = mesh.vertices[:: len(mesh.vertices) // 12][:12]
    model = KeypointModel("ball", tuple(f"k{i}" for i in range(12)), keypoints)
    item = SceneObject(model, np.tile(np.eye(3) * 1e-6, (12, 1, 1)), mesh, np.eye(4))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mesh.vertices)).voxel_down_sample(0.005)
    points = np.asarray(cloud.points)
    with tempfile.TemporaryDirectory() as folder:
        scene, trajectory = make_scene(Path(folder), mesh, count)
        workspace = Workspace(Path(folder) / "workspace")

        def labels(frames: Sequence[Frame]) -> list[FrameLabel]:
            return list(label_frames(scene, trajectory, [item], frames, decoded.__getitem__))

        start = time.process_time()
        for i in range(FILES):
            splat_mask(transform(invert(trajectory.scene_from_camera[i]), points))
        splat = time.process_time() - start
        decoded = {frame: read_depth_m(scene, frame) for frame in scene.frames[:FILES]}
        found = labels(scene.frames[:2])  # warm
        start = time.process_time()
        labels(scene.frames[:FILES])
        warm = time.process_time() - start
        photo = np.random.default_rng(1).normal(120, 40, (120, 160, 3)).clip(0, 255).astype(np.uint8)
        color = Path(folder) / "color.jpg"
        cv2.imwrite(str(color), cv2.resize(photo, (640, 480), interpolation=cv2.INTER_CUBIC))
        start = time.process_time()
        for i in range(FILES):
            seen = transform(invert(trajectory.scene_from_camera[i]), points)
            published_path(Path(folder), color, i, seen)
        published = time.process_time() - start
        start = time.process_time()
        for frame in scene.frames[:FILES]:
            read_depth_m(scene, frame)
        decoding = time.process_time() - start
        area = sum(int(c) for c in _areas(found)) / len(found)
        print(
            f"{len(mesh.triangles)} triangles, cloud {len(points)} points, full mask {area:.0f} px, "
            f"visible {found[0].instances[0].visib_fract:.2f}, one core"
        )
        print(f"point splat (baseline, mask only)     {rate(FILES, splat)}  ratio 1.00")
        print(f"labels, depth at hand                 {rate(FILES, warm)}  ratio {splat / warm:.2f}")
        print(f"published code's whole path           {rate(FILES, published)}  {published / warm:.2f}")
        by_published = ("the published code's whole path", FILES / published)
        by_splat = ("point splat, mask only", FILES / splat)
        at_hand, more = FILES / warm, {"more_is_better": True}
        record("label", "depth at hand, occlusion", at_hand, "frames/s", baseline=by_splat, **more)
        work = "depth at hand, occlusion, beside the published path"
        record("label", work, at_hand, "frames/s", baseline=by_published, asked=10.0, **more)
        cached = cached_reader(Path(folder) / "cache", scene, keep=True)
        for frame in scene.frames[:FILES]:
            cached(frame)
        start = time.process_time()
        list(label_frames(scene, trajectory, [item], scene.frames[:FILES], cached))
        from_cache = FILES / (time.process_time() - start)
        print(f"labels, depth from the cache          {rate(FILES, FILES / from_cache)}")
        work = "depth from the cache, occlusion, beside the published path"
        record("label", work, from_cache, "frames/s", baseline=by_published, asked=10.0, **more)
        print(f"reading depth PNG alone               {rate(FILES, decoding)}")
        for frames in (100, count):
            start = time.process_time()
            made = label_frames(scene, trajectory, [item], scene.frames[:frames], depth_reader(scene))
            workspace.save_labels("bench", made)
            seconds = time.process_time() - start
            work = f"{frames} frames, PNG to labels on disk"
            record("label", work, frames / seconds, "frames/s", baseline=by_published, **more)
            print(
                f"{frames:6d} frames, PNG to labels on disk  {rate(frames, seconds)}  "
                f"ratio {splat / FILES * frames / seconds:.2f}  peak {peak_mb():.1f} MB",
                flush=True,
            )


def _areas(found: list[FrameLabel]) -> Iterator[int]:
    from pycocotools import mask as coco

    for label in found:
        rle = label.instances[0].mask_full
        yield int(coco.area({"size": rle["size"], "counts": rle["counts"].encode()}))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else shared(10_000, least=1_000))
