"""Small ROS bags for the tests, written by the package `rosbags`: what drivers would record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from recordings import color_image, depth_image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_700_000_000 * 10**9
STEP_NS = 33_000_000
COLOR, ALIGNED = "/camera/camera/color", "/camera/camera/aligned_depth_to_color"
OPTICAL = "camera_color_optical_frame"
K = (50.0, 51.0, 31.5, 23.5)

TF = "geometry_msgs/TransformStamped[] transforms"
EXTRINSICS = "float64[9] rotation\nfloat64[3] translation"


class Writing:
    """Makes messages of ROS 1 or 2 and writes them to a bag; `late_ns` is how long they took to arrive."""

    def __init__(self, writer: Any, is_ros1: bool, late_ns: int = 5_000_000) -> None:
        self.writer, self.is_ros1, self.late_ns = writer, is_ros1, late_ns
        self.store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        added = {"realsense2_camera_msgs/msg/Extrinsics": EXTRINSICS} | (
            {"tf2_msgs/msg/TFMessage": TF} if is_ros1 else {}
        )
        for name, text in added.items():
            self.store.register(get_types_from_msg(text, name))
        self._connections: dict[str, Any] = {}

    def new(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        time = self.new("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        more = {"seq": 0} if self.is_ros1 else {}
        return self.new("std_msgs/msg/Header", stamp=time, frame_id=frame, **more)

    def send(self, topic: str, kind: str, message: Any, bag_ns: int) -> None:
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        pack = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(self._connections[topic], bag_ns + self.late_ns, pack(message, kind))

    def image(
        self, topic: str, stamp_ns: int, pixels: np.ndarray, encoding: str, frame: str = OPTICAL, pad: int = 0
    ) -> None:
        height, width = pixels.shape[:2]
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
        data = np.pad(rows, [(0, 0), (0, pad)])
        message = self.new(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_ns, frame),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=int(pixels.dtype.byteorder == ">"),
            step=data.shape[1],
            data=data.ravel(),
        )
        self.send(topic, "sensor_msgs/msg/Image", message, stamp_ns)

    def compressed(
        self, topic: str, stamp_ns: int, content: bytes, format: str, frame: str = OPTICAL
    ) -> None:
        message = self.new(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(stamp_ns, frame),
            format=format,
            data=np.frombuffer(content, np.uint8),
        )
        self.send(topic, "sensor_msgs/msg/CompressedImage", message, stamp_ns)

    def info(
        self,
        topic: str,
        stamp_ns: int,
        k: Sequence[float] = K,
        size: tuple[int, int] = (64, 48),
        *,
        frame: str = OPTICAL,
        lens: Sequence[float] = (0, 0, 0, 0, 0),
        model: str = "plumb_bob",
        p: Sequence[float] | None = None,
    ) -> None:
        fx, fy, cx, cy = k
        px, py, pcx, pcy = p or k
        upper = str.upper if self.is_ros1 else str
        numbers = {
            upper("d"): np.array(lens, float),
            upper("k"): np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1]),
            upper("r"): np.eye(3).ravel(),
            upper("p"): np.array([px, 0, pcx, 0, 0, py, pcy, 0, 0, 0, 1, 0]),
        }
        roi = self.new(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        message = self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, frame),
            height=size[1],
            width=size[0],
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **numbers,
        )
        self.send(topic, "sensor_msgs/msg/CameraInfo", message, stamp_ns)

    def _vector(self, xyz: Sequence[float], kind: str = "Vector3") -> Any:
        return self.new(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, xyz), strict=True)))

    def _quaternion(self, xyzw: Sequence[float]) -> Any:
        return self.new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, xyzw), strict=True)))

    def tf(
        self,
        topic: str,
        stamp_ns: int,
        parent: str,
        child: str,
        xyz: Sequence[float],
        xyzw: Sequence[float] = (0, 0, 0, 1),
    ) -> None:
        moved = self.new(
            "geometry_msgs/msg/Transform", translation=self._vector(xyz), rotation=self._quaternion(xyzw)
        )
        one = self.new(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=moved,
        )
        kind = "tf2_msgs/msg/TFMessage"
        self.send(topic, kind, self.new(kind, transforms=[one]), stamp_ns)

    def odometry(self, topic: str, stamp_ns: int, parent: str, child: str, xyz: Sequence[float]) -> None:
        pose = self.new(
            "geometry_msgs/msg/Pose",
            position=self._vector(xyz, "Point"),
            orientation=self._quaternion((0, 0, 0, 1)),
        )
        twist = self.new(
            "geometry_msgs/msg/Twist", linear=self._vector((0, 0, 0)), angular=self._vector((0, 0, 0))
        )
        unknown = np.zeros(36)
        message = self.new(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            pose=self.new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=unknown),
            twist=self.new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=unknown),
        )
        self.send(topic, "nav_msgs/msg/Odometry", message, stamp_ns)

    def poses(
        self, topic: str, stamps_ns: Sequence[int], xyz: Sequence[Sequence[float]], *, path: bool
    ) -> None:
        kind = "geometry_msgs/msg/PoseStamped"
        made = [
            self.new(
                kind,
                header=self.header(stamp, "map"),
                pose=self.new(
                    "geometry_msgs/msg/Pose",
                    position=self._vector(at, "Point"),
                    orientation=self._quaternion((0, 0, 0, 1)),
                ),
            )
            for stamp, at in zip(stamps_ns, xyz, strict=True)
        ]
        if not path:
            for stamp, one in zip(stamps_ns, made, strict=True):
                self.send(topic, kind, one, stamp)
            return
        for count in (1, len(made)):
            message = self.new(
                "nav_msgs/msg/Path", header=self.header(stamps_ns[0], "map"), poses=made[:count]
            )
            self.send(topic, "nav_msgs/msg/Path", message, stamps_ns[count - 1])

    def extrinsics(self, topic: str, rotation: np.ndarray, xyz: Sequence[float]) -> None:
        kind = "realsense2_camera_msgs/msg/Extrinsics"
        message = self.new(kind, rotation=rotation.ravel(order="F"), translation=np.array(xyz, float))
        self.send(topic, kind, message, START_NS)


@contextmanager
def bag(path: Path, **options: Any) -> Iterator[Writing]:
    """A bag to write to: ROS 1 where the path ends in .bag, else a ROS 2 folder of .db3 or .mcap inside."""
    if path.suffix == ".bag":
        with Writer1(path) as writer:
            writer.chunk_threshold = 20_000
            yield Writing(writer, True, **options)
        return
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    with Writer2(path.with_suffix(""), version=9, storage_plugin=plugin) as writer:
        yield Writing(writer, False, **options)


def stamp(number: int) -> int:
    return START_NS + number * STEP_NS


def realsense(path: Path, count: int = 6, more: Callable[[Writing], None] = lambda writing: None) -> Path:
    """What realsense-ros records with aligned depth; returns what to read: the file, or the folder."""
    with bag(path) as writing:
        for number in range(count):
            at = stamp(number)
            writing.info(f"{COLOR}/camera_info", at)
            writing.image(f"{COLOR}/image_raw", at, color_image(number), "rgb8")
            writing.info(f"{ALIGNED}/camera_info", at)
            writing.image(f"{ALIGNED}/image_raw", at, depth_image(number), "16UC1")
        more(writing)
    return path if path.suffix == ".bag" else path.with_suffix("")
