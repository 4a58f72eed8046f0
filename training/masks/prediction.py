"""Objects found in an image, a folder of images or a video: overlays and COCO results."""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rich.progress import track

from rpl_data.files import write_bytes, write_json
from rpl_data.json_arrays import Json
from rpl_data.torch.image_files import read_image, to_unit_range
from rpl_data.types import DataError

from ..runs.options import IMAGE_SUFFIXES
from .pictures import draw
from .results import predict
from .weights import Segmenter


@dataclass(frozen=True)
class Picture:
    """What is looked at: RGB pixels, and the name its overlay gets."""

    name: str
    pixels: np.ndarray


# Input --------------------------------------------------------------------------------------------


def pictures_of(source: Path, unreadable: Counter[str]) -> Iterator[Picture]:
    """The images of a file or a folder (in the order of their names), or the frames of a video.

    Args:
        source: the file or folder.
        unreadable: counts the images of a folder that cannot be read, by message; they are left out.

    Raises:
        DataError: nothing is there, or it is neither.
    """
    if source.is_dir():
        files = _images_in(source)
        if not files:
            known = ", ".join(sorted(IMAGE_SUFFIXES))
            raise DataError(f"{source} holds no image ({known}); name one of the folders in it, or an image")
        for path in files:
            try:
                pixels = read_image(str(path))
            except DataError as error:
                unreadable[str(error)] += 1
                continue
            yield Picture(path.name, pixels)
    elif source.suffix.lower() in IMAGE_SUFFIXES:
        yield Picture(source.name, read_image(str(source)))
    else:
        yield from _frames(source)


def count_of(source: Path) -> int | None:
    """How many pictures `pictures_of` will give; a video may not say."""
    if is_video(source):
        frames = _number_of(source, cv2.CAP_PROP_FRAME_COUNT)
        return round(frames) if frames > 0 else None
    return len(_images_in(source)) if source.is_dir() else 1


def is_video(source: Path) -> bool:
    """A file that is not an image."""
    return not source.is_dir() and source.suffix.lower() not in IMAGE_SUFFIXES


def _images_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def _frames(video: Path) -> Iterator[Picture]:
    capture = cv2.VideoCapture(str(video))
    try:
        number = 0
        while True:
            there, frame = capture.read()
            if not there:
                break
            yield Picture(f"{number:06d}.jpg", cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
            number += 1
        if number == 0:
            raise DataError(f"{video} is neither an image, nor a folder, nor a video that can be read")
    finally:
        capture.release()


def frame_rate(video: Path) -> float:
    """Frames a second, 30 where the file does not say."""
    rate = _number_of(video, cv2.CAP_PROP_FPS)
    return rate if 0 < rate < 1000 else 30.0


def _number_of(video: Path, which: int) -> float:
    """A property of a video, by OpenCV's number for it; 0 where the file does not say."""
    capture = cv2.VideoCapture(str(video))
    value = float(capture.get(which))
    capture.release()
    return value


# Output -------------------------------------------------------------------------------------------

Saver = Callable[[Picture], None]


@contextmanager
def saving_images(out: Path) -> Iterator[Saver]:
    """Overlays as files of the pictures' names."""

    def save(picture: Picture) -> None:
        suffix = Path(picture.name).suffix
        done, content = cv2.imencode(suffix, cv2.cvtColor(picture.pixels, cv2.COLOR_RGB2BGR))
        if not done:
            raise DataError(f"OpenCV cannot write {suffix} images ({picture.name}); convert it to PNG")
        write_bytes(out / picture.name, content.tobytes())

    yield save


@contextmanager
def saving_video(path: Path, rate: float) -> Iterator[Saver]:
    """Overlays as frames of an MP4 file, which takes its name when the block ends well."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.stem}.") as folder:
        partial = Path(folder) / path.name
        writer = cv2.VideoWriter()

        def save(picture: Picture) -> None:
            height, width = picture.pixels.shape[:2]
            if not writer.isOpened():
                writer.open(str(partial), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
            writer.write(cv2.cvtColor(picture.pixels, cv2.COLOR_RGB2BGR))

        try:
            yield save
        finally:
            writer.release()
        if not partial.exists():
            raise DataError(f"OpenCV cannot write the video {path}; give a folder of images instead")
        partial.replace(path)


def predict_to(
    segmenter: Segmenter, source: Path, out: Path, *, threshold: float, unreadable: Counter[str]
) -> tuple[int, int]:
    """Write overlays, results.json and images.json; how many images and drawn objects there are comes back.

    Args:
        segmenter: the trained network.
        source: an image, a folder of images, or a video.
        out: folder. results.json holds COCO results; images.json the ids of images and categories.
        threshold: least score of what is drawn.
        unreadable: counts the images of a folder that cannot be read, by message.
    """
    hidden = not sys.stdout.isatty()
    pictures = track(
        pictures_of(source, unreadable), source.name, count_of(source), transient=True, disable=hidden
    )
    results: list[Json] = []
    images: list[Json] = []
    drawn = 0
    out.mkdir(parents=True, exist_ok=True)
    overlays = saving_images(out)
    if is_video(source):
        overlays = saving_video(out / f"{source.stem}.mp4", frame_rate(source))
    with overlays as save:
        for number, picture in enumerate(pictures, start=1):
            found = predict(segmenter, to_unit_range(picture.pixels), number)
            seen = [entry for entry in found if entry["score"] >= threshold]
            save(Picture(picture.name, draw(picture.pixels, seen, segmenter.names)))
            height, width = picture.pixels.shape[:2]
            images.append({"id": number, "file_name": picture.name, "width": width, "height": height})
            results += found
            drawn += len(seen)
    categories = [{"id": n, "name": name} for n, name in enumerate(segmenter.names) if n > 0]
    write_json(out / "results.json", results, indent=None)
    write_json(out / "images.json", {"images": images, "categories": categories, "annotations": []})
    return len(images), drawn
