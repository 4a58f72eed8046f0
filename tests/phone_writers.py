"""Write a small film as the phone apps do, from what their makers and readers document."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from exr_writer import exr_bytes
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Film:
    """What an app filmed.

    Attributes:
        colors: RGB images.
        depths_m: depth images, smaller than the colour images.
        poses: scene_from_camera in OpenCV's axes.
        lens: fx, fy, cx, cy of the colour images.
        levels: ARKit's confidence of the depth, 0 to 2.
    """

    colors: list[np.ndarray]
    depths_m: list[np.ndarray]
    poses: np.ndarray
    lens: tuple[float, float, float, float]
    levels: list[np.ndarray] = field(default_factory=list)

    @property
    def arkit(self) -> np.ndarray:
        """The same poses of ARKit's cameras: its y is OpenCV's -y, its z is OpenCV's -z."""
        turned = self.poses.copy()
        turned[:, :3, 1:3] *= -1
        return turned

    @property
    def size(self) -> tuple[int, int]:
        return self.colors[0].shape[1], self.colors[0].shape[0]

    def level(self, number: int) -> np.ndarray:
        shape = self.depths_m[number].shape
        return self.levels[number] if self.levels else np.full(shape, 2, np.uint8)


def jpeg(color: np.ndarray) -> bytes:
    content: bytes = cv2.imencode(".jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    return content


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def millimetres(depth_m: np.ndarray) -> np.ndarray:
    return np.rint(1000 * depth_m).astype(np.uint16)


def write_stray(folder: Path, film: Film, *, first: int = 0, faststart: bool = False) -> None:
    import av

    folder.mkdir(parents=True)
    options = {"movflags": "faststart"} if faststart else {}
    with av.open(str(folder / "rgb.mp4"), "w", options=options) as container:
        stream = container.add_stream("libx264", rate=60, options={"crf": "8"})
        stream.width, stream.height = film.size
        stream.pix_fmt = "yuv420p"
        stream.time_base = Fraction(1, 60)
        for color in film.colors:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(color, format="rgb24")))
        container.mux(stream.encode(None))
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for number, (depth_m, pose) in enumerate(zip(film.depths_m, film.poses, strict=True)):
        write_png(folder / f"depth/{number:06d}.png", millimetres(depth_m))
        write_png(folder / f"confidence/{number:06d}.png", film.level(number))
        words = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
        lines.append(f"{100 + number / 60:.6f}, {number:06d}, {', '.join(map(str, words))}")
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    fx, fy, cx, cy = film.lens
    (folder / "camera_matrix.csv").write_text(f"{fx}, 0.0, {cx}\n0.0, {fy}, {cy}\n0.0, 0.0, 1.0\n")


def record3d_metadata(film: Film) -> dict[str, object]:
    fx, fy, cx, cy = film.lens
    height, width = film.depths_m[0].shape
    quaternions = Rotation.from_matrix(film.arkit[:, :3, :3]).as_quat()
    return {
        "K": [fx, 0, 0, 0, fy, 0, cx, cy, 1],
        "w": film.size[0],
        "h": film.size[1],
        "dw": width,
        "dh": height,
        "fps": 60,
        "poses": np.hstack([quaternions, film.arkit[:, :3, 3]]).tolist(),
        "frameTimestamps": [5 + number / 60 for number in range(len(film.colors))],
        "perFrameIntrinsicCoeffs": [[fx + 0.1 * n, fy, cx, cy] for n in range(-2, len(film.colors) - 2)],
    }


def write_r3d(path: Path, film: Film) -> None:
    import imagecodecs

    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(record3d_metadata(film)))
        for number, (color, depth_m) in enumerate(zip(film.colors, film.depths_m, strict=True)):
            archive.writestr(f"rgbd/{number}.jpg", jpeg(color))
            packed = imagecodecs.lzfse_encode(depth_m.astype("<f4").tobytes())
            archive.writestr(f"rgbd/{number}.depth", packed)
            archive.writestr(f"rgbd/{number}.conf", imagecodecs.lzfse_encode(film.level(number).tobytes()))


def write_record3d_exr(folder: Path, film: Film) -> None:
    for name in ("rgb", "depth"):
        (folder / "EXR_RGBD" / name).mkdir(parents=True)
    (folder / "EXR_RGBD/metadata.json").write_text(json.dumps(record3d_metadata(film)))
    for number, (color, depth_m) in enumerate(zip(film.colors, film.depths_m, strict=True)):
        (folder / f"EXR_RGBD/rgb/{number}.jpg").write_bytes(jpeg(color))
        (folder / f"EXR_RGBD/depth/{number}.exr").write_bytes(exr_bytes(depth_m.astype(np.float32)))


def write_polycam(
    folder: Path, film: Film, *, prefix: str = "corrected_", start_us: int = 99_900_000
) -> None:
    place = folder / "keyframes"
    for name in (f"{prefix}images", f"{prefix}cameras"):
        (place / name).mkdir(parents=True)
    fx, fy, cx, cy = film.lens
    for number, (color, depth_m, pose) in enumerate(zip(film.colors, film.depths_m, film.arkit, strict=True)):
        stamp = start_us + 200_000 * number  # the names get one digit more on the way
        (place / f"{prefix}images/{stamp}.jpg").write_bytes(jpeg(color))
        said = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": film.size[0], "height": film.size[1],
                "blur_score": 9.5}  # fmt: skip
        said |= {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
        (place / f"{prefix}cameras/{stamp}.json").write_text(json.dumps(said))
        write_png(place / f"depth/{stamp}.png", millimetres(depth_m))
        write_png(place / f"confidence/{stamp}.png", np.array([0, 127, 255], np.uint8)[film.level(number)])


def write_scanner_app(folder: Path, film: Film) -> None:
    folder.mkdir(parents=True)
    fx, fy, cx, cy = film.lens
    for number, (color, depth_m, pose) in enumerate(zip(film.colors, film.depths_m, film.arkit, strict=True)):
        (folder / f"frame_{number:05d}.jpg").write_bytes(jpeg(color))
        said = {"intrinsics": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "cameraPoseARFrame": pose.ravel().tolist(),
                "time": 40 + number / 60, "frame_index": number, "motionQuality": 1}  # fmt: skip
        (folder / f"frame_{number:05d}.json").write_text(json.dumps(said))
        write_png(folder / f"depth_{number:05d}.png", millimetres(depth_m))
        write_png(folder / f"conf_{number:05d}.png", film.level(number))


def write_nerfstudio(folder: Path, film: Film) -> None:
    fx, fy, cx, cy = film.lens
    frames = []
    (folder / "images").mkdir(parents=True)
    for number, (color, depth_m, pose) in enumerate(zip(film.colors, film.depths_m, film.arkit, strict=True)):
        (folder / f"images/frame_{number + 1}.jpg").write_bytes(jpeg(color))
        write_png(folder / f"depth/frame_{number + 1}.png", millimetres(depth_m))
        frames.append(
            {
                "file_path": f"images/frame_{number + 1}.jpg",
                "depth_file_path": f"./depth/frame_{number + 1}.png",
                "transform_matrix": pose.tolist(),
            }
        )
    said = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": film.size[0], "h": film.size[1],
            "camera_model": "OPENCV", "k1": 0.0, "frames": frames[::-1]}  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(said))
