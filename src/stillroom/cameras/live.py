"""What all devices have in common: they start, one waits for their images, they stop, and they may be gone."""

import importlib
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.data.sensor import Sensor
from stillroom.datasets.image_sequence import depth_in_metres
from stillroom.errors import CameraError, FrameError, MissingExtraError
from stillroom.geometry.arrays import U8, U16
from stillroom.geometry.camera import Camera

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
GONE_AFTER_S = 5.0
SLICE_S = 0.25
"""A wait within the device's library cannot be interrupted, so it is cut into short ones: Ctrl-C is heard between."""


@dataclass(frozen=True)
class Shot:
    """An image as a device delivers it.

    Attributes:
        time_s: When it was taken, by the device's clock [s].
        rgb: Colours (H, W, 3) uint8, RGB; this program's own memory, not the device's.
        units: Depth (H, W) uint16 in the device's units on the colour pixels, 0 where unknown; likewise.
    """

    time_s: float
    rgb: U8 = field(repr=False)
    units: U16 = field(repr=False)


def library(name: str, extra: str) -> Any:
    """Import the library of a device.

    Raises:
        MissingExtraError: It is not installed; the extra of this name brings it.
        CameraError: It is installed, and lacks something of the system, such as libusb.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise MissingExtraError(name, extra) from error
    except ImportError as error:
        raise CameraError(f"{name}: does not load ({error}) [see troubleshooting: camera-start]") from error


class Device(Protocol):
    """An adapter to the library of a camera. Errors of the library are `RuntimeError`."""

    def start(self) -> Camera:
        """Start it, and return its calibration.

        Raises:
            CameraError: Its images cannot be used here.
        """

    def wait(self, timeout_s: float) -> Shot | None:
        """Wait for the next image; None where none has come within the time [s].

        Raises:
            FrameError: This one cannot be used.
        """

    def stop(self) -> None:
        """Stop it, started or not."""


class LiveCamera:
    """A device as a `CameraStream`."""

    comes_in_time = True
    sensor = Sensor.RGBD
    groundtruth = None
    groundtruth_at_camera = None

    def __init__(self, kind: str, serial: str, device: Device) -> None:
        """Keep the device; it is started when this is entered.

        Args:
            kind: The name of its kind.
            serial: Its serial number, where one is asked for; else "".
            device: The adapter.
        """
        self.name = f"{kind}-{serial}" if serial else kind
        self.camera_source = "the device's own calibration"
        self._asked, self._device = f"camera:{kind}" + (f":{serial}" if serial else ""), device
        self._camera: Camera | None = None
        self._n_taken = 0

    @property
    def camera(self) -> Camera:
        """The calibration that the device has stored.

        Raises:
            CameraError: The device was never started.
        """
        if self._camera is None:
            raise CameraError(f"{self._asked}: is not started; its calibration is known once it is entered")
        return self._camera

    def __enter__(self) -> Self:
        """Start the device.

        Raises:
            CameraError: There is none, or it does not start.
            CalibrationError: No camera can have the calibration that it has stored.
        """
        self._n_taken = 0
        try:
            self._camera = self._device.start()
        except RuntimeError as error:
            self._stop()
            raise CameraError(
                f"{self._asked}: does not start ({_one_line(error)}) [see troubleshooting: camera-start]"
            ) from error
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Stop the device."""
        self._stop()

    def next(self) -> RgbdImage:
        """Wait for the next image.

        Raises:
            FrameError: This one cannot be used.
            CameraError: The device is gone, or has sent nothing for `GONE_AFTER_S`.
        """
        shot = self._next_shot()
        self._n_taken += 1
        depth_m = depth_in_metres(shot.units, self.camera.depth_factor)
        return RgbdImage(shot.time_s, np.ascontiguousarray(shot.rgb), depth_m, self._n_taken - 1)

    def _next_shot(self) -> Shot:
        for _ in range(round(GONE_AFTER_S / SLICE_S)):
            try:
                shot = self._device.wait(SLICE_S)
            except FrameError:
                self._n_taken += 1
                raise
            except RuntimeError as error:
                raise CameraError(f"{self._asked}: the camera is gone ({_one_line(error)})") from error
            if shot is not None:
                return shot
        raise CameraError(f"{self._asked}: the camera is gone: it has sent nothing for {GONE_AFTER_S:g} s")

    def _stop(self) -> None:
        with suppress(RuntimeError):  # of a device that is gone, or was never started
            self._device.stop()


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
