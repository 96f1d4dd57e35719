"""RealSense cameras, by librealsense's own `pyrealsense2`: `camera:realsense`, or `camera:realsense:SERIAL`.

Written by the library's documentation, and tested against a stand-in; no device was at hand.
"""

from typing import Any

import numpy as np

from stillroom.cameras.kind import CameraKind
from stillroom.cameras.live import HEIGHT, RATE_HZ, WIDTH, LiveCamera, Shot, library
from stillroom.datasets.camera_file import DEFAULT_BASELINE_M
from stillroom.errors import CameraError, FrameError
from stillroom.geometry.camera import Camera

KNOWN_LENSES = ("none", "brown_conrady", "modified_brown_conrady", "inverse_brown_conrady")
"""All are k1 k2 p1 p2 k3. The library projects by "inverse" as by "modified": forwards, and from Brown–Conrady differs
in the tangential terms alone, which are applied after the radial ones; that is less than a tenth of a pixel."""


class RealSense:
    """Colour, and depth registered to it; a `Device`."""

    def __init__(self, serial: str) -> None:
        """Keep the serial number; "" for the first camera that there is.

        Raises:
            MissingExtraError: `pyrealsense2` is not installed.
        """
        self._rs, self._serial = library("pyrealsense2", "realsense"), serial
        self._pipeline: Any = None
        self._align: Any = None

    def start(self) -> Camera:
        """Start both streams, and return the calibration of the colour images."""
        rs = self._rs
        asked = rs.config()
        if self._serial:
            asked.enable_device(self._serial)
        asked.enable_stream(rs.stream.color, WIDTH, HEIGHT, rs.format.rgb8, RATE_HZ)
        asked.enable_stream(rs.stream.depth, WIDTH, HEIGHT, rs.format.z16, RATE_HZ)
        pipeline = rs.pipeline()
        profile = pipeline.start(asked)
        self._pipeline, self._align = pipeline, rs.align(rs.stream.color)
        lens = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        if lens.model.name not in KNOWN_LENSES:
            raise CameraError(f"camera:realsense: a lens of the model {lens.model.name} is not supported")
        k1, k2, p1, p2, k3 = (float(value) for value in lens.coeffs)
        metres_per_unit = profile.get_device().first_depth_sensor().get_depth_scale()
        return Camera(
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.ppx,
            cy=lens.ppy,
            distortion=(k1, k2, p1, p2, k3),
            depth_factor=round(1.0 / metres_per_unit, 2),  # stored in single precision: 0.001 gives 999.99995
            bf=DEFAULT_BASELINE_M * lens.fx,
        )

    def wait(self, timeout_s: float) -> Shot | None:
        """Wait for the newest pair of images; those that came in between are dropped by the library."""
        has_come, frames = self._pipeline.try_wait_for_frames(round(1000 * timeout_s))
        if not has_come:
            return None
        frames = self._align.process(frames)
        colour, depth = frames.get_color_frame(), frames.get_depth_frame()
        if not colour or not depth:
            raise FrameError("camera:realsense: colour came without depth, or depth without colour")
        # Copies: the library has few buffers and takes them back. Times are in milliseconds.
        rgb, units = np.array(colour.get_data(), dtype=np.uint8), np.array(depth.get_data(), dtype=np.uint16)
        return Shot(colour.get_timestamp() / 1000.0, rgb, units)

    def stop(self) -> None:
        """Stop both streams."""
        if self._pipeline is not None:
            pipeline, self._pipeline = self._pipeline, None
            pipeline.stop()


def open_realsense(serial: str) -> LiveCamera:
    """Return a RealSense camera."""
    return LiveCamera("realsense", serial, RealSense(serial))


KIND = CameraKind("realsense", "camera:realsense[:SERIAL]", "a RealSense depth camera", open_realsense)
