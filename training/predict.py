"""Estimate poses of objects in images that nobody labelled: `rpl predict poses --help`."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rpl_data.pose.estimate import Method, PoseEstimate, PoseFailure
from rpl_data.types import Click, DataError, Intrinsics
from rpl_data.wording import counted

from .runs.options import IMAGE_SUFFIXES
from .runs.program import reasons

TYPE_CHECKING = False  # not typing's: the parser of the options would import what follows, torch and all
if TYPE_CHECKING:
    from .pose.pipeline import PosePipeline, SeenKeypoints

DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
"""How many coefficients OpenCV's models of a lens have."""

SURE = 0.5
"""Least confidence of a keypoint that is proposed as a click."""


def predict(
    images: Path,
    keypoints: list[Path] | Path = [],  # noqa: B006 (never changed)
    detector: Path | None = None,
    camera: list[float] = [],  # noqa: B006
    distortion: list[float] = [],  # noqa: B006
    depth: Path | None = None,
    metres_per_unit: float = 0.001,
    out: Path = Path("runs/predicted_poses"),
    overlays: bool = True,
    clicks: Path | None = None,
    method: Method = "consensus",
    threads: int | None = None,
) -> None:
    """Estimate the poses of the objects in an image, or in all images of a folder.

    For example: rpl predict poses photos --keypoints '[drill/last.ckpt, carton/last.ckpt]' --detector
    detector/last.ckpt --camera '[615, 615, 320, 240]'. Writes poses.json (one entry per image: for every
    object camera_from_object or why there is none, keypoints, confidences) and, in overlays/, the images with
    what was found drawn on them. Images that cannot be read are left out and counted.

    Args:
        images: an image, or a folder; folders in it are looked into.
        keypoints: checkpoint of `rpl train keypoints`, or a list with one per object.
        detector: checkpoint of `rpl train detector`.
        camera: fx, fy, cx, cy in pixels, '[615, 615, 320, 240]'; the centre of the top-left pixel is 0, 0.
        distortion: OpenCV's coefficients, when the lens has any.
        depth: folder of depth images (16-bit PNG) registered to the images and named like them. Poses then
            use the depth at the keypoints too.
        metres_per_unit: of the depth images; 0.001 for millimetres.
        out: folder for everything that is written.
        overlays: write pictures too.
        clicks: a CSV file for the confident keypoints of objects that have a pose, as click proposals for
            `rpl clicks import --proposed true`. An image's folder is its scene, its name its frame's number.
        method: of PnP.
        threads: processor threads of torch; None leaves the number to torch.
    """
    from rich.progress import track

    from rpl_data.files import write_json, write_text
    from rpl_data.torch.image_files import read_image

    from .pose.pipeline import load_pipeline
    from .runs.program import say_left_out, use_threads

    refuse_no_camera(camera, distortion, metres_per_unit)
    use_threads(threads)
    files = images_of(images)
    pipeline = load_pipeline([keypoints] if isinstance(keypoints, Path) else keypoints, detector)
    entries: list[dict[str, Any]] = []
    proposals: list[Click] = []
    unreadable: Counter[str] = Counter()
    for file in track(files, images.name, transient=True, disable=not sys.stdout.isatty()):
        try:
            image = read_image(str(file))
            depth_m = _depth_m(depth, file, images, metres_per_unit, image)
        except DataError as error:
            unreadable[str(error)] += 1
            continue
        intrinsics = _intrinsics(camera, distortion, image)
        found = [
            (seen, pipeline.pose(seen, intrinsics, method=method, depth=depth_m))
            for seen in pipeline.see(image)
        ]
        entries.append({"image": str(file), "objects": [_entry(*each) for each in found]})
        if clicks is not None:
            proposals += list(proposed(file, found))
        if overlays:
            place = out / "overlays" / _below(file, images, ".jpg")
            _write_overlay(place, image, found, pipeline, intrinsics)
    if not entries:
        raise DataError(f"{images}: every image was left out; the first: {next(iter(unreadable))}")
    write_json(out / "poses.json", entries)
    if clicks is not None:
        write_text(clicks, clicks_csv(proposals, pipeline))
    print(f"{out / 'poses.json'}: {counts_of(entries)}")
    if clicks is not None:
        print(_about_clicks(clicks, len(proposals)))
    say_left_out(unreadable)


def _about_clicks(file: Path, count: int) -> str:
    if not count:
        return f"{file}: no click, for no object with a pose has a keypoint of confidence {SURE:g} or more"
    return f"{file}: {counted(count, 'click')}; `rpl clicks import {file} --proposed true` adds them"


def refuse_no_camera(camera: Sequence[float], distortion: Sequence[float], metres_per_unit: float) -> None:
    """Raise a DataError where options describe no camera."""
    if len(camera) != 4:
        raise DataError(f"--camera is four numbers, '[fx, fy, cx, cy]'; got {len(camera)}: {camera}")
    if not all(map(math.isfinite, camera)) or min(camera[:2]) <= 0:
        raise DataError(f"--camera is {camera}; focal lengths are above 0: '[fx, fy, cx, cy]', in pixels")
    if len(distortion) not in DISTORTION_LENGTHS or not all(map(math.isfinite, distortion)):
        raise DataError(f"--distortion is {distortion}; OpenCV has 4, 5, 8, 12 or 14 coefficients, or none")
    if not 0 < metres_per_unit < math.inf:
        raise DataError(f"--metres_per_unit is {metres_per_unit}; it is above 0: 0.001 for millimetres")


def counts_of(entries: Sequence[Mapping[str, Any]]) -> str:
    """How many images, objects and poses there are, and why poses are missing."""
    objects = [each for entry in entries for each in entry["objects"]]
    none = [each["failure"] for each in objects if each["failure"] is not None]
    why = f"; no pose: {reasons(none)}" if none else ""
    found = f"{counted(len(objects), 'object')}, {len(objects) - len(none)} with a pose"
    return f"{counted(len(entries), 'image')}, {found}{why}"


def images_of(place: Path) -> list[Path]:
    """An image, or those in a folder and below, in order.

    Raises:
        DataError: there is none.
    """
    if place.is_file():
        return [place]
    files = sorted(path for path in place.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    if not files:
        known = ", ".join(sorted(IMAGE_SUFFIXES))
        raise DataError(f"{place} holds no image ({known}); name an image or a folder")
    return files


def proposed(file: Path, found: Sequence[Any]) -> Iterator[Click]:
    """Keypoints that are sure and that the pose rests on.

    Raises:
        DataError: the image's name is not a frame's number.
    """
    if not file.stem.isdigit():
        raise DataError(
            f"{file}: clicks name frames by number, and this name has none; predict on a folder as "
            "export/coco/images, where scenes are folders and frames are numbers"
        )
    for seen, result in found:
        if isinstance(result, PoseFailure):
            continue
        for keypoint in result.keypoints.tolist():
            if seen.confidence[keypoint] >= SURE:
                u, v = seen.positions_px[keypoint].tolist()
                yield Click(seen.object, keypoint, file.parent.name, int(file.stem), u, v)


def clicks_csv(clicks: Sequence[Click], pipeline: PosePipeline) -> str:
    """As `rpl clicks import` reads it, keypoints by name."""
    lines = ["object,keypoint,scene,frame,u_px,v_px"]
    for c in clicks:
        name = pipeline.networks[c.object].model.keypoints[c.keypoint]
        lines.append(f"{c.object},{name},{c.scene},{c.frame},{c.u_px:.4f},{c.v_px:.4f}")
    return "\n".join(lines) + "\n"


def _entry(seen: SeenKeypoints, result: PoseEstimate | PoseFailure) -> dict[str, Any]:
    """One object of an image, ready for JSON; matrices are row-major, in metres."""
    if isinstance(result, PoseFailure):
        pose: dict[str, Any] = {
            "camera_from_object": None,
            "covariance": None,
            "used_keypoints": [],
            "failure": result.reason,
        }
    else:
        pose = {
            "camera_from_object": result.camera_from_object.ravel().tolist(),
            "covariance": result.covariance.ravel().tolist(),
            "used_keypoints": result.keypoints.tolist(),
            "failure": None,
        }
    return {
        "object": seen.object,
        "score": seen.score,
        "square_box": seen.square_px.tolist(),
        **pose,
        "keypoints_px": seen.positions_px.tolist(),
        "confidence": seen.confidence.tolist(),
    }


def _intrinsics(camera: Sequence[float], distortion: Sequence[float], image: Any) -> Intrinsics:
    height, width = image.shape[:2]
    fx, fy, cx, cy = camera
    return Intrinsics(fx, fy, cx, cy, width, height, tuple(distortion))


def _below(file: Path, images: Path, suffix: str) -> Path:
    """The image's place below the folder that was named, with another suffix."""
    place = file.relative_to(images) if images.is_dir() else Path(file.name)
    return place.with_suffix(suffix)


def _depth_m(depth: Path | None, file: Path, images: Path, metres_per_unit: float, image: Any) -> Any:
    """The image's depth in metres; None when no depth was named."""
    from .pose.pipeline import read_depth_like

    if depth is None:
        return None
    return read_depth_like(depth / _below(file, images, ".png"), metres_per_unit, like=image)


def _write_overlay(
    path: Path, image: Any, found: Sequence[Any], pipeline: PosePipeline, intrinsics: Intrinsics
) -> None:
    import cv2

    from rpl_data.files import write_bytes

    from .pose.pictures import drawn, named

    for seen, result in found:
        pose = None if isinstance(result, PoseFailure) else result.camera_from_object
        failure = result.reason if isinstance(result, PoseFailure) else None
        image = drawn(image, seen, pose, intrinsics, pipeline.networks[seen.object].model)
        image = named(image, seen, failure)
    write_bytes(path, bytes(cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]))


if __name__ == "__main__":
    from .runs.program import main

    sys.exit(main(predict))
