"""The synthetic room as a data set: any frame from the seed and its number alone."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from stillroom.data.image import Image, RgbdImage
from stillroom.data.semantics import Box, Instance, Semantics
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.recording import Recording
from stillroom.geometry.arrays import F32, F64, U8, U16, Bool
from stillroom.geometry.camera import Camera
from stillroom.geometry.depth_noise import STRUCTURED_LIGHT
from stillroom_scenes import sensor
from stillroom_scenes.cache import FrameCache, StoredFrame
from stillroom_scenes.raster import extents_of
from stillroom_scenes.remains import Remains
from stillroom_scenes.render import Rendering, World, render, render_rows
from stillroom_scenes.scene.people.figures import FIRST_OBJECT

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_factor=5000.0, bf=40.0, depth_noise=STRUCTURED_LIGHT)
SMALLEST_BOX_PX = 150


@dataclass(frozen=True)
class FrameTruth:
    """The ground truth of a frame.

    Attributes:
        T_world_cam: Exact pose (4, 4).
        depth_m: Exact depth (H, W) float32 [m] at the pixel centres.
        instance: What each pixel shows (H, W) uint8: 0 the still room, 1 … figures, 101 … handled objects.
        moving: Pixels of figures, and of objects while they are handled (H, W).
    """

    T_world_cam: F64
    depth_m: F32
    instance: U8
    moving: Bool


class DepthFault(NamedTuple):
    """What is wrong with the depth sensor, of which the camera knows nothing.

    Attributes:
        scale: What it measures, as a share of the truth.
        late_s: How late its images are stamped [s].
    """

    scale: float = 1.0
    late_s: float = 0.0


SOUND = DepthFault()


class SyntheticRoom(Recording):
    """A rendered RGB-D sequence; see `stillroom_scenes.config` for what can be chosen.

    Under a rolling shutter, colours and what is known of their pixels (boxes, masks) are those of each row's own time;
    depth and `truth` are those of the frame's time, that of its middle row.

    Attributes:
        scene: The whole scene.
        empty: Makes the same sequence without people, where it is the same without them.
    """

    empty: "Callable[[], SyntheticRoom] | None" = None

    def __init__(
        self,
        name: str,
        world: World,
        n_frames: int,
        fps: float,
        seed: int,
        noise: bool,
        cache_spec: str | None,
        readout_s: float = 0.0,
        depth: DepthFault = SOUND,
        camera: Camera = CAMERA,
        stated_readout_s: float | None = None,
    ) -> None:
        """Take pictures of a world.

        Args:
            name: Name in results.
            world: The scene, and the camera's path.
            n_frames: How many frames.
            fps: Frames per second [1/s].
            seed: Chooses the noise.
            noise: Whether the sensor has any.
            cache_spec: All that decides what frames look like, to find those kept on disk; None to keep none.
            readout_s: Of the camera's rolling shutter [s]; see `Camera.readout_s`.
            depth: What is wrong with depth.
            camera: Its calibration otherwise.
            stated_readout_s: What the calibration says of the readout [s]; by default the truth.
        """
        self.name = name
        self.camera = replace(camera, readout_s=readout_s if stated_readout_s is None else stated_readout_s)
        self._taken_with = replace(camera, readout_s=readout_s)
        self.camera_source = "the renderer's own pinhole camera: fx = fy = 525, no distortion, exact"
        self.timestamps_s = np.arange(n_frames) / fps
        self.scene = world.scene
        self._way, self._depth = world.way, depth
        self._noise = sensor.NoiseTables(seed) if noise else None
        self._cache: FrameCache | None = None
        if cache_spec is not None:
            spec = f"{_renderer_version()} {cache_spec} {self._taken_with}"
            self._cache = FrameCache(hashlib.sha256(spec.encode()).hexdigest()[:24])

    @cached_property
    def groundtruth(self) -> Trajectory:  # type: ignore[override]  # made when asked for: opening stays cheap
        """The exact pose of each frame."""
        return Trajectory(self.timestamps_s, self._way.poses(self.timestamps_s))

    def load(self, index: int) -> Image:
        """Return frame `index`, from the cache or rendered.

        Raises:
            IndexError: There is no such frame.
        """
        self._check(index)
        stored = self._cache.read(index) if self._cache else None
        if stored is None:
            stored = self._taken(index)
            if self._cache:
                self._cache.keep(index, stored)
        time_s = float(self.timestamps_s[index])
        return self._image(stored, index, time_s, self._semantics(stored.instance, time_s))

    def _image(self, stored: StoredFrame, index: int, time_s: float, truth: Semantics) -> Image:
        """Return a stored frame as what the sensor delivers."""
        depth_m = np.divide(stored.measured, np.float32(self.camera.depth_factor), dtype=np.float32)
        return RgbdImage(time_s, stored.rgb, depth_m, index, truth=truth)

    def truth(self, index: int) -> FrameTruth:
        """Return the ground truth of frame `index`.

        Raises:
            IndexError: There is no such frame.
        """
        self._check(index)
        rendering = self._rendered(index)
        with np.errstate(divide="ignore"):
            depth_m = np.where(rendering.inverse_depth > 0, 1.0 / rendering.inverse_depth, 0.0).astype(np.float32)
        time_s = float(self.timestamps_s[index])
        moving = self._semantics(rendering.instance, time_s).movable
        return FrameTruth(self.pose(index), depth_m, rendering.instance, moving)

    def remains(self, last: int = -1) -> Remains:
        """Return what is static in the end, when frame `last` is the last: the truth of a dense map.

        Raises:
            IndexError: There is no such frame.
        """
        return Remains(self.scene, float(self.timestamps_s[last]))

    def handled(self, instance: U8) -> Bool:
        """Return which pixels (H, W) show handled objects, given the instance of each; see `FrameTruth`."""
        return np.asarray(instance >= FIRST_OBJECT)

    def without_people(self) -> "SyntheticRoom | None":
        """Return the same sequence without people; None where objects are carried or pushed by people."""
        return None if self.empty is None else self.empty()

    def pose(self, index: int) -> F64:
        """Return the exact `T_world_cam` (4, 4) of frame `index`."""
        pose: F64 = self._way.poses(self.timestamps_s[index : index + 1])[0]
        return pose

    def _check(self, index: int) -> None:
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: frame {index} of {len(self)}")

    def _rendered(self, index: int) -> Rendering:
        return render(self.scene, self.camera, self.pose(index), float(self.timestamps_s[index]))

    def _taken(self, index: int) -> StoredFrame:
        """Render frame `index` and apply the sensor model: colours row by row, depth at once in the middle of them."""
        rendering = self._rendered(index)
        inverse_depth = self._inverse_depth(rendering, float(self.timestamps_s[index]))
        if self._taken_with.readout_s > 0.0:
            rows = render_rows(self.scene, self._taken_with, self._way, float(self.timestamps_s[index]))
            rendering = Rendering(rows.rgb, inverse_depth, rows.instance)
        units: U16 = np.empty(rendering.instance.shape, dtype=np.uint16)
        if self._noise is None:
            sensor.clean_units(inverse_depth, self.camera.depth_factor, units)
        else:
            places = self._noise.places(index, self.camera.height, self.camera.width)
            sensor.add_colour_noise(rendering.rgb, self._noise.colour, places[0])
            sensor.measured_units(inverse_depth, self._noise.normal, places[1:], self.camera.depth_factor, units)
        return StoredFrame(rendering.rgb, units, rendering.instance)

    def _inverse_depth(self, rendering: Rendering, time_s: float) -> F32:
        """Return 1/z (H, W) [1/m] as the sensor says that it is at a moment, before its noise."""
        scale, late_s = self._depth
        seen = rendering.inverse_depth
        if late_s != 0.0:
            then_s = time_s - late_s
            pose: F64 = self._way.poses(np.array([then_s]))[0]
            seen = render(self.scene, self.camera, pose, max(0.0, then_s)).inverse_depth
        return seen if scale == 1.0 else np.asarray(seen / np.float32(scale))

    def _movers(self, time_s: float) -> dict[int, str]:
        """Return instance and label of all that moves at a moment."""
        movers = {figure.instance: "person" for figure in self.scene.figures}
        movers |= {thing.instance: thing.label for thing in self.scene.objects if thing.is_moving(time_s)}
        return movers

    def _semantics(self, instance: U8, time_s: float) -> Semantics:
        movers = self._movers(time_s)
        is_mover = np.zeros(256, dtype=np.bool_)
        is_mover[list(movers)] = True
        extents, moving = np.empty((256, 5), dtype=np.int64), np.empty(instance.shape, dtype=np.bool_)
        extents_of(instance, is_mover, extents, moving)
        height, width = instance.shape
        boxes, instances = [], []
        for number, label in movers.items():
            count, left, top, right, bottom = (int(value) for value in extents[number])
            if count > 0:
                own = instance[top : bottom + 1, left : right + 1] == number
                instances.append(Instance(label, 1.0, own, left, top, height, width, track_id=number))
            if count >= SMALLEST_BOX_PX:
                edges = (float(left), float(top), float(right), float(bottom))
                boxes.append(Box(*edges, label=label, confidence=1.0, track_id=number))
        return Semantics(height, width, tuple(boxes), moving, instances=tuple(instances))


@lru_cache(maxsize=1)
def _renderer_version() -> str:
    """Return a hash of the renderer's own sources: frames of other versions are not reused."""
    folder = Path(__file__).parent
    digest = hashlib.sha256(f"{np.__version__} {cv2.__version__}".encode())
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
