"""Write a twin to disk: a recording in RapidPoseLabels' layout, its clicks, and the ground truth.

::

    camera.txt  clicks.csv
    <scene>/    rgb/*.jpg  depth/*.png  associations.txt  camera.poses
    truth/      a Workspace: objects/<object>/{solution.json,mesh.ply}, labels/<scene>.jsonl
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from multiprocessing import get_context, parent_process
from pathlib import Path

import cv2
import numpy as np

from rpl_data.clicks.table import tables_to_csv
from rpl_data.files import write_bytes, write_text
from rpl_data.formats.recordings.camera_file import write_camera
from rpl_data.formats.recordings.rpl import write_associations, write_poses
from rpl_data.geometry import Transform
from rpl_data.meshes import save_mesh
from rpl_data.twin import annotator
from rpl_data.twin.film import Film, film
from rpl_data.twin.objects import build
from rpl_data.twin.spec import TwinSpec
from rpl_data.twin.unfinished import keep_label, kept_label, label_file, unfinished
from rpl_data.types import Click, DataError, FrameLabel, Solution
from rpl_data.types.instances import placed_as
from rpl_data.workspace.workspace import Workspace

Progress = Callable[[int, int], None]


def write_twin(folder: Path, spec: TwinSpec, *, workers: int = 2, progress: Progress | None = None) -> None:
    """Write the recording, its clicks and its truth; the folder appears only when it is complete.

    An older folder of that name is replaced. `truth/` is a `Workspace` with the true models, meshes and
    labels of every frame; the same spec gives the same pixels.
    Whatever interrupts it, the next call with the same spec goes on with the frames that are missing.

    Args:
        workers: processes that render; 1 uses this process alone.
        progress: called with the number of frames done and their total.

    Raises:
        DataError: an unknown object, a spec that makes no video, a full disk, or a worker that died.
    """
    spec.check()
    for thing in spec.things:
        build(thing)  # refuses what is unknown before anything is written
    with unfinished(folder, spec) as partial:
        truth = Workspace(partial / "truth")
        write_camera(partial, spec.intrinsics)
        labels = _render_all(partial, spec, workers, progress)
        clicks: dict[str, list[Click]] = {thing.name: [] for thing in spec.things}
        poses: dict[str, dict[str, Transform]] = {thing.name: {} for thing in spec.things}
        for number, scene in enumerate(spec.scene_names):
            of_scene = [next(labels) for _ in range(spec.frames(number))]
            truth.save_labels(scene, of_scene)
            video = film(spec, number)
            shown = [video.as_shown(label) for label in of_scene]
            _write_lists(partial / scene, video)
            for row, (one, instance) in enumerate(zip(video.objects, video.instances, strict=True)):
                clicks[one.model.name] += _clicks(spec, number, one.model.name, instance, shown)
                if not video.moves:
                    poses[one.model.name][placed_as(scene, instance)] = video.scene_from_object(row)
        next(labels, None)  # lets the process pool end
        _write_objects(truth, spec, poses)
        write_text(partial / "clicks.csv", _csv(spec, clicks))


# Frames -------------------------------------------------------------------------------------------


def _render_all(
    partial: Path, spec: TwinSpec, workers: int, progress: Progress | None
) -> Iterator[FrameLabel]:
    """Render and write every frame in order, and yield their labels as they are done."""
    jobs = [
        (partial, spec, scene, frame)
        for scene in range(len(spec.casts))
        for frame in range(spec.frames(scene))
    ]
    for done, label in enumerate(_in_processes(jobs, workers), start=1):
        if progress is not None:
            progress(done, len(jobs))
        yield label


def _in_processes(jobs: list[tuple[Path, TwinSpec, int, int]], workers: int) -> Iterator[FrameLabel]:
    if workers <= 1:
        yield from map(_write_frame, jobs)
        return
    # Spawned, not forked: Open3D's threads do not survive a fork.
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin)
    try:
        yield from pool.map(_write_frame, jobs, chunksize=4)
    except BrokenProcessPool as error:
        raise DataError(
            "a process that rendered the twin died, perhaps out of memory; use fewer workers"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Prepare a process: one thread, as the processes share the cores, and no longer life than ours."""
    cv2.setNumThreads(1)
    os.environ["OMP_NUM_THREADS"] = "1"
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A killed build must not leave processes that wait for ever for their next frame."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@lru_cache(maxsize=1)
def _film(spec: TwinSpec, scene: int) -> Film:
    """The prepared scene; a process works on one scene at a time."""
    return film(spec, scene)


def _write_frame(job: tuple[Path, TwinSpec, int, int]) -> FrameLabel:
    """Render and write a frame, unless that was done before it was interrupted."""
    partial, spec, scene, frame = job
    name = spec.scene_names[scene]
    color, depth = partial / name / _color_name(frame), partial / name / _depth_name(frame)
    label = kept_label(label_file(partial, name, frame), color, depth)
    if label is not None:
        return label
    shot = _film(spec, scene).shoot(frame)
    quality = [cv2.IMWRITE_JPEG_QUALITY, spec.sensor.color.jpeg_quality]
    _write_image(color, shot.color[..., ::-1], quality)
    # The reader multiplies by 0.001, so the image holds millimetres whatever the sensor's quantum is.
    units = np.round(shot.depth_m * 1000).clip(0, 65535).astype(np.uint16)
    _write_image(depth, units, [])
    keep_label(label_file(partial, name, frame), shot.label)
    return shot.label


def _write_image(path: Path, image: np.ndarray, options: list[int]) -> None:
    ok, encoded = cv2.imencode(path.suffix, image, options)
    if not ok:
        raise DataError(f"cannot encode {path}")
    write_bytes(path, encoded.tobytes())


def _color_name(frame: int) -> str:
    return f"rgb/{frame:06d}.jpg"


def _depth_name(frame: int) -> str:
    return f"depth/{frame:06d}.png"


# Lists, clicks and truth --------------------------------------------------------------------------


def _write_lists(folder: Path, video: Film) -> None:
    frames, times_s = range(len(video.times_s)), video.times_s.tolist()
    write_associations(folder, times_s, [_color_name(f) for f in frames], [_depth_name(f) for f in frames])
    write_poses(folder, times_s, video.scene_from_camera)


def _clicks(spec: TwinSpec, number: int, name: str, instance: str, labels: list[FrameLabel]) -> list[Click]:
    several = [int(instance)] if instance else []
    return annotator.click(
        labels,
        name,
        intrinsics=spec.intrinsics,
        clicks_per_keypoint=spec.clicks_per_keypoint,
        noise_px=spec.click_noise_px,
        mistakes=spec.mistakes,
        rng=np.random.default_rng(
            [spec.seed, number, 2, list(spec.casts[number].objects).index(name), *several]
        ),
        instance=instance,
        same_frames=spec.casts[number].moving,
    )


def _csv(spec: TwinSpec, clicks: dict[str, list[Click]]) -> str:
    """Write the clicks on all objects as one table with one heading."""
    return tables_to_csv((clicks[thing.name], build(thing).model.keypoints) for thing in spec.things)


def _write_objects(truth: Workspace, spec: TwinSpec, poses: Mapping[str, Mapping[str, Transform]]) -> None:
    for thing in spec.things:
        one = build(thing)
        covariance = np.zeros((len(one.model.keypoints), 3, 3))
        truth.save_solution(Solution(one.model, covariance, poses[thing.name]))
        save_mesh(truth.mesh_file(thing.name), one.surface.mesh)
