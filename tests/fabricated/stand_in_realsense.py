"""A stand-in for `pyrealsense2` with the names that the adapter uses, each as in the library; no device behind it.

A device is a list of steps: a `Taken` pair, None where nothing comes within a wait, or an error of the library.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

stream = Enum("stream", "color depth")
format = Enum("format", "rgb8 z16")
distortion = Enum(
    "distortion", "none brown_conrady inverse_brown_conrady modified_brown_conrady ftheta kannala_brandt4"
)


@dataclass
class Taken:
    """What the device takes: milliseconds, colour and depth; one of the two may be lacking."""

    time_ms: float
    rgb: np.ndarray | None
    units: np.ndarray | None


class _Plugged:
    """What is plugged in, and what was asked of it."""

    serial = "012345678901"
    steps: list[Any]
    model = distortion.inverse_brown_conrady
    is_streaming = False
    n_waits = 0
    streams: list[tuple[Any, ...]]


plugged: _Plugged | None = None


def plug(steps: list[Any]) -> _Plugged:
    global plugged
    plugged = _Plugged()
    plugged.steps, plugged.streams = list(steps), []
    return plugged


class intrinsics:
    def __init__(self, model: distortion) -> None:
        self.width, self.height, self.model = 640, 480, model
        self.fx, self.fy, self.ppx, self.ppy = 607.5, 606.25, 318.5, 241.75
        self.coeffs = [0.125, -0.25, 0.001, -0.002, 0.0625]

    width = height = model = fx = fy = ppx = ppy = coeffs = None


class video_stream_profile:
    def get_intrinsics(self) -> intrinsics:
        assert plugged is not None
        return intrinsics(plugged.model)


class stream_profile:
    def as_video_stream_profile(self) -> video_stream_profile:
        return video_stream_profile()


class depth_sensor:
    def get_depth_scale(self) -> float:
        return float(np.float32(0.001))


class device:
    def first_depth_sensor(self) -> depth_sensor:
        return depth_sensor()


class pipeline_profile:
    def get_stream(self, which: stream) -> stream_profile:
        assert which is stream.color
        return stream_profile()

    def get_device(self) -> device:
        return device()


class config:
    def __init__(self) -> None:
        self._serial, self._streams = "", []

    def enable_device(self, serial: str) -> None:
        self._serial = serial

    def enable_stream(self, which: stream, width: int, height: int, kind: format, rate_hz: int) -> None:
        self._streams.append((which.name, width, height, kind.name, rate_hz))


class video_frame:
    def __init__(self, pixels: np.ndarray | None, time_ms: float) -> None:
        self._pixels, self._time_ms = pixels, time_ms

    def __bool__(self) -> bool:
        return self._pixels is not None

    def get_data(self) -> np.ndarray:
        assert self._pixels is not None
        return self._pixels

    def get_timestamp(self) -> float:
        return self._time_ms


class composite_frame:
    def __init__(self, taken: Taken, is_aligned: bool) -> None:
        self._taken, self.is_aligned_ = taken, is_aligned

    def get_color_frame(self) -> video_frame:
        return video_frame(self._taken.rgb, self._taken.time_ms)

    def get_depth_frame(self) -> video_frame:
        assert self.is_aligned_, "depth is not registered to colour"
        return video_frame(self._taken.units, self._taken.time_ms + 3.0)


class align:
    def __init__(self, to: stream) -> None:
        assert to is stream.color

    def process(self, frames: composite_frame) -> composite_frame:
        return composite_frame(frames._taken, True)


class pipeline:
    def start(self, asked: config) -> pipeline_profile:
        if plugged is None or asked._serial not in ("", plugged.serial):
            raise RuntimeError("No device connected")
        plugged.is_streaming, plugged.streams = True, asked._streams
        return pipeline_profile()

    def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, composite_frame]:
        assert plugged is not None
        plugged.n_waits += 1
        step = plugged.steps.pop(0) if plugged.steps else None
        if isinstance(step, Exception):
            raise step
        empty = Taken(0.0, None, None)
        return step is not None, composite_frame(step or empty, False)

    def stop(self) -> None:
        assert plugged is not None
        if not plugged.is_streaming:
            raise RuntimeError("stop() cannot be called before start()")
        plugged.is_streaming = False
