"""`depthai` 3 made of software, as far as the capture uses it.

It sends what its pipeline is wired for: depth is at the colour pixels only where an alignment is wired, and
colour is free of distortion only where that was asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from software_camera import color_pixels, depth_pixels

NAMES = (
    "Device.getAllAvailableDevices", "Device.getDeviceName", "Device.getDeviceId", "Device.readCalibration",
    "Device.getPlatform", "Device.close", "DeviceInfo.getDeviceId", "CalibrationHandler.getLensPosition",
    "Pipeline.create", "Pipeline.start", "Pipeline.stop", "Pipeline.isRunning", "Platform.RVC2",
    "Platform.RVC4", "CameraBoardSocket.CAM_A", "CameraBoardSocket.CAM_B", "CameraBoardSocket.CAM_C",
    "node.Camera.build", "node.Camera.requestOutput", "node.Camera.initialControl",
    "node.Camera.inputControl", "node.StereoDepth.setLeftRightCheck", "node.StereoDepth.setSubpixel",
    "node.StereoDepth.initialConfig", "node.StereoDepth.inputAlignTo", "node.StereoDepth.left",
    "node.StereoDepth.right", "node.StereoDepth.depth", "StereoDepthConfig.setDepthUnit",
    "LengthUnit.MILLIMETER", "node.Sync.setSyncThreshold", "node.Sync.inputs", "node.Sync.out",
    "node.ImageAlign.input", "node.ImageAlign.inputAlignTo", "node.ImageAlign.outputAligned",
    "Node.Output.link", "Node.Output.createOutputQueue", "Node.Input.createInputQueue",
    "MessageQueue.get", "MessageQueue.QueueException", "InputQueue.send", "MessageGroup.__getitem__",
    "CameraControl.setAutoExposureLock", "CameraControl.setAutoWhiteBalanceLock",
    "CameraControl.setManualFocus", "ImgFrame.getSequenceNum", "ImgFrame.getTimestampDevice",
    "ImgFrame.getCvFrame", "ImgFrame.getFrame", "ImgFrame.getTransformation",
    "ImgTransformation.getIntrinsicMatrix", "ImgTransformation.getSize",
    "ImgTransformation.getDistortionCoefficients",
)  # fmt: skip
"""What of the package is imitated; a test looks for each name where the package is installed."""

K = [[60.0, 0.0, 31.25], [0.0, 61.0, 23.75], [0.0, 0.0, 1.0]]
LENS = [0.1, -0.2, 0.001, 0.002, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


class QueueException(Exception):
    pass


class Input:
    def __init__(self) -> None:
        self.source: Output | None = None
        self.sent: list[Any] = []

    def createInputQueue(self) -> Any:
        return SimpleNamespace(send=self.sent.append)


class Output:
    def __init__(self, **facts: Any) -> None:
        self.facts = facts

    def link(self, target: Input) -> None:
        target.source = self


class Control(SimpleNamespace):
    def setAutoExposureLock(self, lock: bool) -> None:
        self.exposure = lock

    def setAutoWhiteBalanceLock(self, lock: bool) -> None:
        self.balance = lock

    def setManualFocus(self, position: int) -> None:
        self.focus = position


class Camera:
    def __init__(self) -> None:
        self.initialControl, self.inputControl = Control(), Input()

    def build(self, socket: Any) -> Camera:
        self.socket = socket
        return self

    def requestOutput(self, size: Any, *, fps: float, enableUndistortion: bool = False) -> Output:
        return Output(size=size, fps=fps, straight=enableUndistortion, socket=self.socket)


class StereoDepth:
    def __init__(self) -> None:
        self.left, self.right, self.inputAlignTo = Input(), Input(), Input()
        self.depth = Output(stereo=self)
        self.initialConfig = SimpleNamespace(setDepthUnit=lambda unit: setattr(self, "unit", unit))
        self.unit, self.checked, self.fine = None, False, False

    def setLeftRightCheck(self, on: bool) -> None:
        self.checked = on

    def setSubpixel(self, on: bool) -> None:
        self.fine = on


class ImageAlign:
    def __init__(self) -> None:
        self.input, self.inputAlignTo = Input(), Input()
        self.outputAligned = Output(align=self)


class SoftwareOak:
    """An OAK camera, as a module `depthai`."""

    def __init__(
        self,
        *,
        serials: tuple[str, ...] = ("14442C10D1",),
        until: int = 10**9,
        lost: Callable[[int], bool] = lambda number: False,
        old_calibration: bool = False,
        prism: float = 0.0,
        platform: str = "RVC2",
    ) -> None:
        self.serials, self.until, self.lost = serials, until, lost
        self.old_calibration, self.prism, self.platform = old_calibration, prism, platform
        self.number, self.running, self.closed = 0, False, False
        self.cameras: list[Camera] = []
        self.module = self._module()

    def _module(self) -> ModuleType:
        dai: Any = ModuleType("depthai")
        dai.CameraBoardSocket = Enum("CameraBoardSocket", "CAM_A CAM_B CAM_C")
        dai.Platform = Enum("Platform", "RVC2 RVC4")
        dai.LengthUnit = Enum("LengthUnit", "METER MILLIMETER")
        dai.MessageQueue = SimpleNamespace(QueueException=QueueException)
        dai.CameraControl = Control
        dai.DeviceInfo = lambda serial: SimpleNamespace(getDeviceId=lambda: serial)
        dai.Device = lambda info: SimpleNamespace(
            getDeviceName=lambda: "OAK-D",
            getDeviceId=info.getDeviceId,
            getPlatform=lambda: dai.Platform[self.platform],
            readCalibration=lambda: SimpleNamespace(getLensPosition=lambda socket: 130),
            close=lambda: setattr(self, "closed", True),
        )
        dai.Device.getAllAvailableDevices = lambda: [dai.DeviceInfo(s) for s in self.serials]
        dai.node = SimpleNamespace(
            Camera=Camera, StereoDepth=StereoDepth, ImageAlign=ImageAlign, Sync=self._sync
        )
        dai.Pipeline = lambda device: SimpleNamespace(
            create=self._create,
            start=lambda: setattr(self, "running", True),
            stop=lambda: setattr(self, "running", False),
            isRunning=lambda: self.running,
        )
        self.dai = dai
        return dai

    def _create(self, kind: Any) -> Any:
        node = kind()
        if isinstance(node, Camera):
            self.cameras.append(node)
        return node

    def _sync(self) -> Any:
        self.inputs = {"color": Input(), "depth": Input()}
        queue = SimpleNamespace(get=self._get)
        return SimpleNamespace(
            inputs=self.inputs,
            setSyncThreshold=lambda threshold: None,
            out=SimpleNamespace(createOutputQueue=lambda: queue),
        )

    def _get(self, timeout: timedelta) -> Any:
        time.sleep(0.002)
        while self.lost(self.number):
            self.number += 1
        if self.number >= self.until:
            self.running = False
            raise QueueException("MessageQueue was closed")
        number, self.number = self.number, self.number + 1
        return {"color": self._color(number), "depth": SimpleNamespace(getFrame=lambda: self._depth(number))}

    def _color(self, number: int) -> Any:
        output = self.inputs["color"].source
        assert output is not None and output.facts["socket"].name == "CAM_A"
        straight = output.facts["straight"] and not self.old_calibration
        bent = [*LENS[:8], self.prism, *LENS[9:]]
        lens = SimpleNamespace(
            getIntrinsicMatrix=lambda: K,
            getSize=lambda: output.facts["size"],
            getDistortionCoefficients=lambda: [0.0] * 14 if straight else bent,
        )
        return SimpleNamespace(
            getSequenceNum=lambda: number,
            getTimestampDevice=lambda: timedelta(seconds=1 + number / 30),
            getCvFrame=lambda: color_pixels(number % 50)[..., ::-1],
            getTransformation=lambda: lens,
        )

    def _depth(self, number: int) -> np.ndarray:
        output = self.inputs["depth"].source
        assert output is not None
        align = output.facts.get("align")
        stereo = output.facts["stereo"] if align is None else align.input.source.facts["stereo"]
        target = (stereo if align is None else align).inputAlignTo.source
        assert (align is None) == (self.platform == "RVC2") and stereo.fine
        assert [side.source.facts["socket"].name for side in (stereo.left, stereo.right)] == [
            "CAM_B",
            "CAM_C",
        ]
        if target is not self.inputs["color"].source or not stereo.checked:
            return np.zeros((400, 640), np.uint16)
        assert stereo.unit is self.dai.LengthUnit.MILLIMETER
        return depth_pixels(number)
