"""A stand-in for `depthai` 3 with the names that the adapter uses, each as in the library; no device behind it.

A device is a list of steps: a `Taken` pair, None where nothing comes within a wait, or an error of the library.
"""

from dataclasses import dataclass, field
from datetime import timedelta
from enum import Enum
from typing import Any

import numpy as np

CameraBoardSocket = Enum("CameraBoardSocket", "CAM_A CAM_B CAM_C")
Platform = Enum("Platform", "RVC2 RVC4")
LengthUnit = Enum("LengthUnit", "METER CENTIMETER MILLIMETER")


@dataclass
class Taken:
    """What the device takes: its clock, colour as OpenCV has it (BGR), and depth."""

    time: timedelta
    bgr: np.ndarray
    units: np.ndarray


@dataclass
class _Plugged:
    device_id: str = "14442C10D13EABCE00"
    platform: Platform = Platform.RVC2
    steps: list[Any] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)
    asked: list[tuple[Any, ...]] = field(default_factory=list)
    is_open: bool = False
    is_running: bool = False
    n_waits: int = 0


plugged: _Plugged | None = None


def plug(steps: list[Any], platform: Platform = Platform.RVC2) -> _Plugged:
    global plugged
    plugged = _Plugged(platform=platform, steps=list(steps))
    return plugged


def _now() -> _Plugged:
    assert plugged is not None
    return plugged


class ImgTransformation:
    def getIntrinsicMatrix(self) -> list[list[float]]:
        return [[455.5, 0.0, 321.25], [0.0, 456.5, 238.75], [0.0, 0.0, 1.0]]


class ImgFrame:
    Type = Enum("Type", "RGB888i")

    def __init__(self, pixels: np.ndarray, time: timedelta) -> None:
        self._pixels, self._time = pixels, time

    def getCvFrame(self) -> np.ndarray:
        return self._pixels.copy()

    def getFrame(self) -> np.ndarray:
        return self._pixels

    def getTimestampDevice(self) -> timedelta:
        return self._time

    def getTransformation(self) -> ImgTransformation:
        return ImgTransformation()


class MessageGroup:
    def __init__(self, frames: dict[str, ImgFrame]) -> None:
        self._frames = frames

    def __getitem__(self, name: str) -> ImgFrame:
        return self._frames[name]


class MessageQueue:
    class QueueException(Exception):
        pass

    def get(self, timeout: timedelta) -> MessageGroup | None:
        now = _now()
        assert now.is_running
        now.n_waits += 1
        step = now.steps.pop(0) if now.steps else None
        if isinstance(step, Exception):
            raise step
        if step is None:
            return None
        # Colour and depth go by the names under which they were linked to the node that pairs them.
        inputs = [into.removeprefix("Sync.") for _, into in now.links if into.startswith("Sync.")]
        assert inputs == ["colour", "depth"]
        later = step.time + timedelta(milliseconds=1)
        return MessageGroup({"colour": ImgFrame(step.bgr, step.time), "depth": ImgFrame(step.units, later)})


class Node:
    class Input:
        def __init__(self, name: str) -> None:
            self._name = name

    class Output:
        def __init__(self, name: str) -> None:
            self._name = name

        def link(self, into: "Node.Input") -> None:
            _now().links.append((self._name, into._name))

        def createOutputQueue(self, maxSize: int, blocking: bool) -> MessageQueue:
            assert (self._name, maxSize >= 1, blocking) == ("Sync.out", True, False)
            return MessageQueue()

    class InputMap:
        def __getitem__(self, name: str) -> "Node.Input":
            return Node.Input(f"Sync.{name}")


class StereoDepthConfig:
    def getDepthUnit(self) -> LengthUnit:
        return LengthUnit.MILLIMETER


class node:
    class Camera:
        def build(self, socket: CameraBoardSocket) -> "node.Camera":
            self._socket = socket
            return self

        def requestOutput(
            self,
            size: tuple[int, int],
            type: ImgFrame.Type | None = None,
            fps: float | None = None,
            enableUndistortion: bool | None = None,
        ) -> Node.Output:
            _now().asked.append((self._socket.name, size, fps, enableUndistortion))
            return Node.Output(self._socket.name)

    class StereoDepth:
        left, right = Node.Input("StereoDepth.left"), Node.Input("StereoDepth.right")
        inputAlignTo = Node.Input("StereoDepth.inputAlignTo")
        depth = Node.Output("StereoDepth.depth")
        initialConfig = StereoDepthConfig()

        def setLeftRightCheck(self, enable: bool) -> None:
            assert enable

        def setSubpixel(self, enable: bool) -> None:
            assert enable

    class ImageAlign:
        input, inputAlignTo = Node.Input("ImageAlign.input"), Node.Input("ImageAlign.inputAlignTo")
        outputAligned = Node.Output("ImageAlign.outputAligned")

    class Sync:
        inputs = Node.InputMap()
        out = Node.Output("Sync.out")

        def setSyncThreshold(self, threshold: timedelta) -> None:
            assert timedelta(0) < threshold < timedelta(seconds=1 / 30)


class DeviceInfo:
    def __init__(self, device_id: str) -> None:
        self._id = device_id


class Device:
    def __init__(self, info: DeviceInfo | None = None) -> None:
        if plugged is None:
            raise RuntimeError("No available devices")
        if info is not None and info._id != plugged.device_id:
            raise RuntimeError("Cannot find any device with given deviceInfo")
        plugged.is_open = True

    def getPlatform(self) -> Platform:
        return _now().platform

    def close(self) -> None:
        _now().is_open = False


class Pipeline:
    def __init__(self, device: Device) -> None:
        assert _now().is_open

    def create(self, kind: type[Any]) -> Any:
        return kind()

    def start(self) -> None:
        _now().is_running = True

    def stop(self) -> None:
        _now().is_running = False
