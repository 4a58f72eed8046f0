"""OAK cameras of Luxonis, by the third version of their package `depthai`.

The camera computes depth from its stereo pair, moves it onto the pixels of the colour image, and removes the
lens distortion of both; intrinsics are those that each image states for itself. Tested against a software
device only.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

import numpy as np

from rpl_data.capture.camera import (
    POLL_S,
    USB_HINT,
    Shot,
    StreamCamera,
    StreamCounts,
    UnpluggedError,
    Wanted,
    chosen_serial,
    first_of,
    needed,
    until_unplugged,
)
from rpl_data.capture.exposure import MeanColor
from rpl_data.capture.lens import opencv_camera
from rpl_data.types import DataError, Intrinsics

INSTALL = "install it by: pip install 'rpl-data[oak]'"
USUAL_SIZE_PX = (640, 480)
STEREO_SIZE_PX = (640, 400)
"""Size of the two images that depth is computed from; what all OAK cameras can do at 30 Hz."""

METRES_PER_UNIT = 0.001
"""The unit that the camera is told to use; with whole millimetres 16 bits reach 65 m."""

NOT_STRAIGHT = (
    "this camera, with a calibration of an early format, leaves the lens distortion in its colour images; "
    "depth may lie beside colour towards the borders"
)


@contextmanager
def open_oak(wanted: Wanted) -> Iterator[OakStreams]:
    """Open the connected OAK camera while the block lasts.

    Raises:
        DataError: depthai is not installed, there is no camera, it has no stereo pair, or it cannot start.
    """
    dai = needed("depthai", cameras="OAK cameras", install=INSTALL)
    connected = [info.getDeviceId() for info in dai.Device.getAllAvailableDevices()]
    serial = chosen_serial(
        connected,
        wanted.serial,
        cameras="OAK camera",
        hint=USB_HINT,
    )
    try:
        device = dai.Device(dai.DeviceInfo(serial))
    except RuntimeError as error:
        raise DataError(f"cannot open the OAK camera {serial}: {error}; plug it in again") from error
    try:
        yield from _started(dai, device, wanted)
    finally:
        with suppress(RuntimeError):  # one that was unplugged cannot be closed
            device.close()


def _started(dai: Any, device: Any, wanted: Wanted) -> Iterator[OakStreams]:
    """Build the pipeline, start it, and stop it at the end."""
    name = f"{device.getDeviceName()} {device.getDeviceId()}"
    pipeline = dai.Pipeline(device)
    try:
        pairs, controls = _joined(dai, device, pipeline, wanted)
        pipeline.start()
    except RuntimeError as error:
        raise DataError(
            f"cannot start colour and stereo depth of {name}: {error}; choose with --width, --height "
            "and --fps"
        ) from error
    try:
        yield _facts_of(OakStreams(dai, pipeline, pairs, controls, name))
    finally:
        with suppress(RuntimeError):
            pipeline.stop()


def _joined(dai: Any, device: Any, pipeline: Any, wanted: Wanted) -> tuple[Any, Any]:
    """Wire the cameras; returns the queue of pairs and the queue for commands to the colour camera."""
    sockets = dai.CameraBoardSocket
    rate_hz = float(wanted.rate_hz)
    camera = pipeline.create(dai.node.Camera).build(sockets.CAM_A)
    _hold_focus(device, camera, sockets.CAM_A)
    color = camera.requestOutput(
        wanted.size_px or USUAL_SIZE_PX,
        fps=rate_hz,
        enableUndistortion=True,  # as aligned depth has none
    )
    stereo = pipeline.create(dai.node.StereoDepth)
    stereo.setLeftRightCheck(True)  # alignment needs it
    stereo.setSubpixel(True)  # else a step of depth at 0.7 m is 15 mm
    stereo.initialConfig.setDepthUnit(dai.LengthUnit.MILLIMETER)
    for socket, side in ((sockets.CAM_B, stereo.left), (sockets.CAM_C, stereo.right)):
        pipeline.create(dai.node.Camera).build(socket).requestOutput(STEREO_SIZE_PX, fps=rate_hz).link(side)
    sync = pipeline.create(dai.node.Sync)
    sync.setSyncThreshold(timedelta(seconds=0.5 / rate_hz))
    color.link(sync.inputs["color"])
    _aligned(dai, device, pipeline, stereo, color).link(sync.inputs["depth"])
    return sync.out.createOutputQueue(), camera.inputControl.createInputQueue()


def _hold_focus(device: Any, camera: Any, socket: Any) -> None:
    """Keep an autofocus lens where it was calibrated; elsewhere the intrinsics would not hold."""
    position = device.readCalibration().getLensPosition(socket)
    if position > 0:
        camera.initialControl.setManualFocus(position)


def _aligned(dai: Any, device: Any, pipeline: Any, stereo: Any, color: Any) -> Any:
    """Depth at the pixels of the colour image; the newer chip has a node of its own for it."""
    if device.getPlatform() != dai.Platform.RVC4:
        color.link(stereo.inputAlignTo)
        return stereo.depth
    align = pipeline.create(dai.node.ImageAlign)
    stereo.depth.link(align.input)
    color.link(align.inputAlignTo)
    return align.outputAligned


@dataclass
class OakStreams:
    """An open camera (`CameraStreams`).

    Attributes:
        dai: the module depthai.
        pipeline: the running pipeline.
        pairs: queue of pairs.
        controls: queue for commands to the colour camera.
        name: name of the camera.
        intrinsics: of its colour images, once the first has come.
        counts: counts of frames.
    """

    dai: Any
    pipeline: Any
    pairs: Any
    controls: Any
    name: str
    intrinsics: Intrinsics | None = None
    counts: StreamCounts = field(default_factory=StreamCounts)

    @property
    def camera(self) -> StreamCamera:
        """What the device reports about itself."""
        assert self.intrinsics is not None  # set before anybody sees this object
        notes = (NOT_STRAIGHT,) if self.intrinsics.distortion else ()
        return StreamCamera(self.intrinsics, METRES_PER_UNIT, self.name, notes)

    def begin(self) -> None:
        """Count from zero again."""
        self.counts.clear()

    def shots(self, *, patience_s: float) -> Iterator[Shot]:
        """Yield shots until the camera is unplugged or silent."""
        return until_unplugged(self.poll, patience_s=patience_s)

    def lock_exposure(self, mean_color: MeanColor) -> tuple[str, ...]:
        """Hold exposure and white balance as they are now, which this camera does itself."""
        command = self.dai.CameraControl()
        command.setAutoExposureLock(True)
        command.setAutoWhiteBalanceLock(True)
        self.controls.send(command)
        return (f"locked exposure and white balance, brightness {mean_color().mean():.0f} of 255",)

    def poll(self) -> Shot | None:
        """The next pair; None when none has come for a moment."""
        try:
            pair = self.pairs.get(timedelta(seconds=POLL_S))
            if pair is None and not self.pipeline.isRunning():
                raise UnpluggedError
        except (RuntimeError, self.dai.MessageQueue.QueueException) as error:
            raise UnpluggedError from error
        if pair is None:
            return None
        self.counts.pairs += 1
        color, depth = pair["color"], pair["depth"]
        if self.intrinsics is None:
            self.intrinsics = _intrinsics_of(color.getTransformation())
        return Shot(
            color.getSequenceNum(),
            color.getTimestampDevice().total_seconds(),
            np.ascontiguousarray(color.getCvFrame()[..., ::-1]),
            np.array(depth.getFrame(), np.uint16),
        )


def _facts_of(streams: OakStreams) -> OakStreams:
    """Wait for the first pair, which says what its camera is."""
    shot = first_of(streams.poll, streams.name)
    if shot.depth.shape != shot.color.shape[:2]:
        raise DataError(
            f"{streams.name} sends depth of {shot.depth.shape[1]}x{shot.depth.shape[0]} px that is not "
            f"aligned to its colour of {shot.color.shape[1]}x{shot.color.shape[0]} px; choose another "
            "--width and --height"
        )
    return streams


def _intrinsics_of(transformation: Any) -> Intrinsics:
    """The camera of an image after all that was done to it: cut, scaled, freed of distortion."""
    k = np.asarray(transformation.getIntrinsicMatrix(), float)
    lens = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    return opencv_camera(lens, transformation.getSize(), transformation.getDistortionCoefficients())
