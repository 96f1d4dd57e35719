"""OAK cameras with stereo depth, by Luxonis' `depthai` (version 3): `camera:oak`, or `camera:oak:ID`.

Written by the library's documentation, and tested against a stand-in; no device was at hand.
"""

from contextlib import ExitStack
from datetime import timedelta
from typing import Any

import cv2
import numpy as np

from stillroom.cameras.kind import CameraKind
from stillroom.cameras.live import HEIGHT, RATE_HZ, WIDTH, LiveCamera, Shot, library
from stillroom.datasets.camera_file import DEFAULT_BASELINE_M
from stillroom.errors import CameraError
from stillroom.geometry.camera import Camera

STEREO_SIZE = (640, 400)
UNITS_PER_METRE = {"METER": 1.0, "CENTIMETER": 100.0, "MILLIMETER": 1000.0}
COLOUR, DEPTH = "colour", "depth"
FIRST_WAIT_S = 10.0


class Oak:
    """Undistorted colour, and stereo depth registered to it; a `Device`."""

    def __init__(self, device_id: str) -> None:
        """Keep the id, "" for the first camera that there is; `library` says where `depthai` is not installed."""
        self._dai, self._id = library("depthai", "oak"), device_id
        self._running = ExitStack()
        self._first: Any = None

    def start(self) -> Camera:
        """Start the device, and return the calibration that its first colour image has."""
        dai = self._dai
        device = dai.Device(dai.DeviceInfo(self._id)) if self._id else dai.Device()
        self._running.callback(device.close)
        pipeline = dai.Pipeline(device)
        stereo, self._queue = self._built(pipeline.create, device.getPlatform() == dai.Platform.RVC4)
        pipeline.start()
        self._running.callback(pipeline.stop)
        if (first := self._next(FIRST_WAIT_S)) is None:
            raise CameraError(f"camera:oak: has sent nothing for {FIRST_WAIT_S:g} s after its start")
        self._first = first
        # The device undistorts the image, so it has no distortion any more.
        (fx, _, cx), (_, fy, cy), _ = first[COLOUR].getTransformation().getIntrinsicMatrix()
        depth_factor = UNITS_PER_METRE[stereo.initialConfig.getDepthUnit().name]
        return Camera(WIDTH, HEIGHT, fx, fy, cx, cy, depth_factor=depth_factor, bf=DEFAULT_BASELINE_M * fx)

    def _built(self, create: Any, is_rvc4: bool) -> tuple[Any, Any]:
        """Connect the nodes as Luxonis' example of aligned depth does; return that of stereo depth, and the queue."""
        dai, node, sockets = self._dai, self._dai.node, self._dai.CameraBoardSocket
        colour = create(node.Camera).build(sockets.CAM_A)
        stereo, sync = create(node.StereoDepth), create(node.Sync)
        stereo.setLeftRightCheck(True)
        stereo.setSubpixel(True)  # whole disparities are steps of half a metre at 4 m
        seen = colour.requestOutput((WIDTH, HEIGHT), dai.ImgFrame.Type.RGB888i, fps=RATE_HZ, enableUndistortion=True)
        for socket, side in ((sockets.CAM_B, stereo.left), (sockets.CAM_C, stereo.right)):
            create(node.Camera).build(socket).requestOutput(STEREO_SIZE, fps=RATE_HZ).link(side)
        seen.link(sync.inputs[COLOUR])
        if is_rvc4:
            align = create(node.ImageAlign)
            stereo.depth.link(align.input)
            seen.link(align.inputAlignTo)
            align.outputAligned.link(sync.inputs[DEPTH])
        else:
            seen.link(stereo.inputAlignTo)
            stereo.depth.link(sync.inputs[DEPTH])
        sync.setSyncThreshold(timedelta(seconds=0.5 / RATE_HZ))
        return stereo, sync.out.createOutputQueue(maxSize=2, blocking=False)  # the newest: older ones are dropped

    def wait(self, timeout_s: float) -> Shot | None:
        """Wait for the next pair of images."""
        group, self._first = self._first or self._next(timeout_s), None
        if group is None:
            return None
        colour, depth = group[COLOUR], group[DEPTH]
        rgb = np.asarray(cv2.cvtColor(colour.getCvFrame(), cv2.COLOR_BGR2RGB), dtype=np.uint8)
        return Shot(colour.getTimestampDevice().total_seconds(), rgb, np.array(depth.getFrame(), dtype=np.uint16))

    def _next(self, timeout_s: float) -> Any:
        try:
            return self._queue.get(timedelta(seconds=timeout_s))
        except self._dai.MessageQueue.QueueException as error:
            raise RuntimeError("its queue was closed") from error

    def stop(self) -> None:
        """Stop the pipeline, and let the device go."""
        self._first = None
        self._running.close()


def open_oak(device_id: str) -> LiveCamera:
    """Return an OAK camera."""
    return LiveCamera("oak", device_id, Oak(device_id))


KIND = CameraKind("oak", "camera:oak[:ID]", "an OAK camera with stereo depth", open_oak)
