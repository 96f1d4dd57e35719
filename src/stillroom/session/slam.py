"""`Slam`: a method applied to the images of one camera, from Python and from the command line."""

import logging
import weakref
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np

from stillroom.compiled import said_when_compiling
from stillroom.config import SlamConfig, with_overrides
from stillroom.config.sensors import NO_DEPTH_IMAGE, fit_to_sensor, has_depth_image
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import Image, StereoImage
from stillroom.data.map import Map
from stillroom.data.result import FrameResult, Tracked, TrackingState
from stillroom.data.semantics import Semantics
from stillroom.data.sensor import Sensor, sensor_called
from stillroom.data.trajectory import Trajectory
from stillroom.errors import ConfigError, FrameError, MapError, StillroomError
from stillroom.evaluation.timing import FRAME, StageClock
from stillroom.geometry.camera import Camera
from stillroom.presets.registry import configure
from stillroom.protocols import RunObserver, Schedule, Segmenter
from stillroom.schedule import LiveSchedule, ScheduleName, schedule_of
from stillroom.session import one_thread
from stillroom.session.map_file import MapFile, MapUse, OpenedMap, opened_map, session_of
from stillroom.session.plausibility import (
    DepthRange,
    Doubt,
    ImageTimes,
    ShutterDoubts,
    doubts_of_camera,
    require_possible,
)
from stillroom.storage.schema import FrameNote, StoredMap
from stillroom.storage.writer import save_map
from stillroom.system import System, build

log = logging.getLogger(__name__)


class Slam:
    """A SLAM system: images in, poses, moving pixels and maps out.

    ::

        with Slam("oc-slam", camera) as slam:
            for image in images:
                result = slam.process(image)
        slam.trajectory().write_tum("trajectory.tum")

    As a context it closes itself; trajectory and maps remain available. While any is open, OpenCV and BLAS are limited
    to one thread each; the last one to close restores their settings. Several may be open at a time, on one thread or
    on several: the results of each do not depend on the others.

    Attributes:
        config: The whole configuration.
        camera: The calibration of the images.
        sensor: What kind of camera takes them.
        left_out: What of the method does not work with that sensor and is left out, in words; each was logged once.
        clock: Times of the stages.
        system: The stages, and the map that they share.
        doubts: What is probably wrong with calibration or depth; each was logged once.
    """

    def __init__(
        self,
        method: str | SlamConfig,
        camera: Camera,
        *,
        seed: int | None = None,
        settings: Iterable[str] = (),
        map: str | Path | None = None,
        map_use: MapUse | str = MapUse.NEW,
        segmenter: Segmenter | None = None,
        observers: Iterable[RunObserver] = (),
        schedule: str | Schedule = ScheduleName.IN_ORDER,
        sensor: str | Sensor = Sensor.RGBD,
        sequence: str = "images from Python",
    ) -> None:
        """Initialise the system.

        Args:
            method: A method's name (`stillroom methods` lists them), or a whole configuration.
            camera: The calibration of the images to come.
            seed: Seed of all random choices; by default the configuration's, which is 0 in all presets.
            settings: Single values of the configuration, such as "tracking.min_inliers=20".
            map: A map file: written as the map grows, unless `map_use` says otherwise.
            map_use: "new" makes the file; "continue" relocalizes in the map first and extends it; "localize" tracks
                against the map and writes nothing.
            segmenter: Finds what is potentially dynamic, in place of the method's own segmenter.
            observers: Called with each frame after it was tracked.
            schedule: "in-order" runs everything on the caller's thread, and the same images give the same result byte
                for byte; "live" has the papers' threads: what may move, mapping and the dense map are done by workers
                while tracking goes on.
            sensor: What kind of camera takes the images: "rgbd", "stereo" or "monocular".
            sequence: Name of the images in a map file and in messages.

        Raises:
            ConfigError: A method, a key or a value is wrong, or nothing of the method works with the sensor.
            WeightsError: A network's weights are absent.
            MapError: The map file cannot be used so, or does not fit.
            CalibrationError: No camera can have this calibration.
        """
        require_possible(camera)
        file = None if map is None else MapFile(Path(map), _map_use(map_use))
        if file is None and _map_use(map_use) is not MapUse.NEW:
            raise ConfigError(f"map_use is '{map_use}', which needs a map: name its file")
        schedule = _schedule(schedule)
        self._is_live = isinstance(schedule, LiveSchedule)
        config, self.left_out = _fitted(_configured(method, settings, seed), sensor_called(sensor))
        self.config = config if file is None else file.fitting(config)
        self.camera, self.sensor, self.clock = camera, sensor_called(sensor), StageClock()
        self.doubts: list[Doubt] = []
        self._depths, self._times, self._rows = DepthRange(camera.depth_factor), ImageTimes(), ShutterDoubts()
        self._sequence, self._observers, self._newest = sequence, list(observers), _Newest()
        self._n_given, self._last_s, self._is_open = 0, -np.inf, True
        with ExitStack() as opening:
            self._opened: OpenedMap = opening.enter_context(
                opened_map(file, self.config, camera, sequence, self.sensor)
            )
            self.system = self._built(segmenter, schedule)
            opening.callback(weakref.finalize(self, one_thread.hold()))  # let go with the object at the latest
            self._opening = opening.pop_all()
        self.doubt(doubts_of_camera(camera))

    def _built(self, segmenter: Segmenter | None, schedule: Schedule) -> System:
        return build(
            self.config,
            self.camera,
            segmenter,
            schedule,
            observer=self._newest,
            clock=self.clock,
            world=self._opened.world,
            keeper=self._opened.keeper,
            sensor=self.sensor,
        )

    def observe(self, observer: RunObserver) -> None:
        """Call an observer with each frame from now on; its time does not count as the frame's."""
        self._observers.append(observer)

    def doubt(self, doubts: Iterable[Doubt]) -> None:
        """Log what is probably wrong, and keep it in `doubts`."""
        for each in doubts:
            log.warning("%s", each)
            self.doubts.append(each)

    def process(self, image: Image, following: Sequence[Image] = ()) -> FrameResult:
        """Track one image.

        Args:
            image: The next one in order of time.
            following: Those after it that are there already, in order: under the live schedule workers begin them.

        Returns:
            The pose as known now (under the trajectory prior, where the method has one: what all images so far say of
            it), what moves, and how tracking stands.

        Raises:
            FrameError: Colours or depth are of another size or type than they must be, or the time does not increase;
                the image is left out, and the next one may come.
            StillroomError: The system is closed already.
        """
        if not self._is_open:
            raise StillroomError("this Slam is closed; make another one for more images")
        self._require(image)
        if image.index < 0:
            image = image.at(self._n_given, image.timestamp_s)
        self._n_given, self._last_s = self._n_given + 1, image.timestamp_s
        self.doubt(self._times.add(image.timestamp_s))
        if self.sensor is Sensor.RGBD:
            self.doubt(self._depths.add(image.depth_m))
        is_first = len(self.system.results) == 0
        with self.clock.stage(FRAME), said_when_compiling() if is_first else nullcontext():
            result = self._repeated(image) or self._tracked(image, following)
        self.doubt(self._rows.add(self.system.tracker.rows))
        self.clock.next_frame(image.index)
        self._newest.show(self._observers)
        return result

    def close(self) -> None:
        """Finish pending work, optimise the whole map a last time, and complete the map file.

        Raises:
            MapError: The map file cannot be completed; what was committed is in it.
        """
        if not self._is_open:
            return
        self._is_open = False
        with self._opening:
            self._finish()
            if self._opened.keeper is not None:
                for result in self.system.results:
                    if result.n_looked is not None:  # noted when it was tracked; found again since
                        self._opened.keeper.note(result)
                self._opened.keeper.close()

    def __enter__(self) -> "Slam":
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close; after an error, a map file stays as the last keyframe's commit left it."""
        if error is None:
            self.close()
        elif self._is_open:
            self._is_open = False
            try:
                self._finish()
            finally:
                self._opening.__exit__(kind, error, traceback)

    @property
    def map(self) -> Map:
        """The sparse map: keyframes, points, and how they hang together."""
        return self.system.map

    @property
    def map_file(self) -> Path | None:
        """The map file that is written; None where none is."""
        return self._opened.written

    def trajectory(self) -> Trajectory:
        """Return the final poses, `T_world_cam`, of the images that were tracked; see `System.trajectory`."""
        return self.system.trajectory()

    def lagged_trajectory(self) -> Trajectory | None:
        """Return the poses as they are settled a few images later; None where the method has no trajectory prior."""
        return self.system.lagged_trajectory()

    def dense_cloud(self) -> DenseCloud:
        """Return the dense map as coloured, oriented points, without what moves.

        Raises:
            MapError: The method makes no dense map.
        """
        cloud = self.system.dense_cloud()
        if cloud is None:
            if not has_depth_image(self.config, self.sensor):
                raise MapError(f"{self.config.method} makes no dense map here: {NO_DEPTH_IMAGE[self.sensor]}")
            raise MapError(f"{self.config.method} makes no dense map here; the setting 'dense.kind=voxels' makes one")
        return cloud

    def save_map(self, path: str | Path) -> None:
        """Write the sparse map into a new file, to extend it or to localize in it later.

        Raises:
            MapError: There is such a file already, it cannot be written, or there is no keyframe to write.
        """
        if len(self.map.alive_keyframes()) == 0:
            raise MapError(f"{path}: there is no keyframe yet, so there is no map to save")
        system, earlier = self.system, self._opened.earlier or StoredMap(self.map, self.camera)
        session = session_of(self.map, self.config, self._sequence, system.first_keyframe)
        notes = [FrameNote.of(result, len(earlier.sessions)) for result in system.results]
        frames = (*earlier.frames, *(note for note in notes if note is not None))
        save_map(Path(path), StoredMap(self.map, earlier.camera, (*earlier.sessions, session), frames))

    def _repeated(self, image: Image) -> FrameResult | None:
        """Return the result before, for an image that shows exactly the same; None for a new one.

        Recorders that wait for a slow sensor write the last image again. It carries no information, and a motion model
        would take the camera to stand still.
        """
        if self._newest.seen is None:
            return None
        tracked, semantics, result = self._newest.seen
        before = tracked.frame.image
        if result.state is not TrackingState.OK or not _is_same(before, image):
            return None
        if isinstance(image, StereoImage) and isinstance(before, StereoImage):
            image = replace(image, depth_of_pair=before.depth_of_pair)  # observers see it as every other
        if self.system.n_repeated == 0:
            text = f"image {image.index} is the one before it once more; such images get its pose, and are counted"
            self.doubt([Doubt("repeated-images", text)])
        result = self.system.repeat(result, image)
        self._newest.on_frame(replace(tracked, frame=replace(tracked.frame, image=image)), semantics, result)
        return result

    def _tracked(self, image: Image, following: Sequence[Image]) -> FrameResult:
        if self._is_live:
            self.system.begin(image)
            last = image
            for coming in following:
                if not self._may_follow(last, coming):
                    break  # what follows will be begun when it is clear what becomes of this one
                self.system.begin(coming)
                last = coming
        return self.system.process(image)

    def _may_follow(self, image: Image, following: Image) -> bool:
        """Return whether an image will be tracked after this one: it is neither refused nor a repetition."""
        try:
            self._require(following)
        except FrameError:
            return False
        return following.index >= 0 and following.timestamp_s > image.timestamp_s and not _is_same(image, following)

    def _finish(self) -> None:
        with self.clock.stage(FRAME):
            self.system.close()
        self.clock.conclude()

    def _require(self, image: Image) -> None:
        """Refuse an image that is not what the camera takes.

        Raises:
            FrameError: Saying what is wrong with it.
        """
        size, where = (self.camera.height, self.camera.width), f"image {self._n_given}"
        if image.sensor is not self.sensor:
            raise FrameError(f"{where}: is {image.sensor.words}; this Slam takes {self.sensor.words} images")
        if image.rgb.dtype != np.uint8 or image.rgb.shape != (*size, 3):
            raise FrameError(
                f"{where}: rgb is {image.rgb.dtype} {image.rgb.shape}; the camera's images are uint8 {(*size, 3)}"
            )
        if isinstance(image, StereoImage) and (image.right.dtype != np.uint8 or image.right.shape != size):
            raise FrameError(
                f"{where}: right is {image.right.dtype} {image.right.shape}; it must be the brightness, uint8 {size}"
            )
        if image.has_depth_image and (image.depth_m.dtype != np.float32 or image.depth_m.shape != size):
            is_whole = image.depth_m.dtype.kind in "iu"
            hint = f": divide a sensor's units by {self.camera.units_per_m:g}, as float32" if is_whole else ""
            raise FrameError(
                f"{where}: depth_m is {image.depth_m.dtype} {image.depth_m.shape}; it must be float32 {size} in metres"
                + hint
            )
        if not np.isfinite(image.timestamp_s):
            raise FrameError(f"{where}: its time is {image.timestamp_s}; give it in seconds")
        if image.timestamp_s <= self._last_s:
            raise FrameError(
                f"{where}: its time, {image.timestamp_s} s, is not after {self._last_s} s, that of the image before it"
            )


class _Newest:
    """Keeps the newest frame until its time is taken, so that observers do not count as the frame's time."""

    def __init__(self) -> None:
        self.seen: tuple[Tracked, Semantics, FrameResult] | None = None

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        self.seen = (tracked, semantics, result)

    def show(self, observers: Iterable[RunObserver]) -> None:
        """Call the observers with it."""
        if self.seen is not None:
            for observer in observers:
                observer.on_frame(*self.seen)


def _is_same(first: Image, second: Image) -> bool:
    middle = len(first.rgb) // 2
    if not np.array_equal(first.rgb[middle], second.rgb[middle]):
        return False  # nearly always: one row is in a few cache lines, the whole image is in none
    return all(np.array_equal(channel, second.channels[name]) for name, channel in first.channels.items())


def _configured(method: str | SlamConfig, settings: Iterable[str], seed: int | None) -> SlamConfig:
    if isinstance(method, str):
        return configure(method, overrides=settings, seed=seed)
    config = with_overrides(method, settings)
    return config if seed is None else replace(config, seed=seed)


def _fitted(config: SlamConfig, sensor: Sensor) -> tuple[SlamConfig, tuple[str, ...]]:
    """Return what of a config works with a sensor, and what was left out of it, which is logged."""
    fitted, left_out = fit_to_sensor(config, sensor)
    for part in left_out:
        log.warning("%s with %s images: left out: %s", config.method, sensor.words, part)
    return fitted, left_out


def _schedule(asked: str | Schedule) -> Schedule:
    return schedule_of(asked) if isinstance(asked, str) else asked


def _map_use(asked: MapUse | str) -> MapUse:
    try:
        return MapUse(asked)
    except ValueError:
        raise ConfigError(f"map_use is '{asked}'; it must be one of {', '.join(MapUse)}") from None
