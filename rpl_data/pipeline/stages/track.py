"""Stage `track`: compute camera poses from the images, if the recipe does not use the recording's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from rpl_data.images import read_grey
from rpl_data.pipeline.context import Context, step
from rpl_data.pipeline.ledger import Advance, Outcome, Step
from rpl_data.types import DepthImage, Frame, GreyImage, ReadDepth

VERSION = 1
"""Raised when the stage writes something else for the same input; its steps then run again."""

AHEAD = 8
"""Number of frames that are decoded ahead while others are tracked."""


def track_steps(context: Context) -> list[Step]:
    """Plan the steps that track the camera, one per recording."""
    return [_track_step(context, name) for name in context.workspace.video_names()] if context.tracks else []


def _track_step(context: Context, name: str) -> Step:
    workspace = context.workspace

    def run(advance: Advance) -> Outcome:
        from rpl_data.reconstruct.path import collected, losses
        from rpl_data.reconstruct.tracking import track

        scene = workspace.load_scene(name)
        frames = [frame for frame in scene.frames if frame.depth is not None]
        images = decoded(frames, workspace.depth_reader(scene, keep=True), advance)
        found = collected(scene, track(scene, images))
        workspace.save_trajectory(scene, found.trajectory)
        lines = [f"scene {name}: {line}" for line in losses(scene, found)]
        return Outcome(len(frames), tuple(lines), {"lost": len(found.lost)})

    return step(
        "track", name, run, version=VERSION, after=["import"], outputs=[workspace.trajectory_file(name)]
    )


def decoded(
    frames: Sequence[Frame], depths: ReadDepth, advance: Advance
) -> Iterator[tuple[Frame, GreyImage, DepthImage]]:
    """Decode frames to small brightness and depth images, in a thread that works ahead of the caller.

    Args:
        depths: function that reads a depth image.
    """
    from rpl_data.reconstruct.view import REDUCE

    def read(frame: Frame) -> tuple[Frame, GreyImage, DepthImage]:
        return frame, read_grey(frame, reduce=REDUCE), depths(frame)

    with ThreadPoolExecutor(1) as thread:
        waiting = [thread.submit(read, frame) for frame in frames[:AHEAD]]
        try:
            for number in range(len(frames)):
                advance(number, len(frames))
                ready = waiting.pop(0)
                if number + AHEAD < len(frames):
                    waiting.append(thread.submit(read, frames[number + AHEAD]))
                yield ready.result()
        finally:
            for future in waiting:
                future.cancel()
