"""The system: one image in, one pose out. Read `System.process` first."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from stillroom.bounds import check, in_pixels_of
from stillroom.config import SlamConfig
from stillroom.config.single_camera import for_single_camera
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.frame import Frame
from stillroom.data.image import Image, StereoImage
from stillroom.data.map import Map, submaps
from stillroom.data.question import Perceived
from stillroom.data.result import FrameResult, FrameSummary, Recovery, Tracked
from stillroom.data.semantics import Semantics
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.dynamics.asking import Asking
from stillroom.evaluation.timing import StageClock, timed_part
from stillroom.features.keypoint_depth import KeypointDepth, NoDepth
from stillroom.features.orb import UntilMap
from stillroom.features.places.place_index import PlaceMemory
from stillroom.geometry import se3
from stillroom.geometry.arrays import F32, F64
from stillroom.geometry.camera import Camera
from stillroom.loops.joining import SubmapJoiner
from stillroom.loops.loop_closer import LoopClosing
from stillroom.mapping.local_mapper import LocalMapper
from stillroom.protocols import (
    Clusterer,
    DenseMapping,
    FeatureExtractor,
    KeyframeSegmenter,
    KeypointSieve,
    MapKeeping,
    Parts,
    Pending,
    RunObserver,
    Schedule,
    Segmenter,
)
from stillroom.schedule import Done, InOrder, Worker
from stillroom.storage.keeper import NoKeeper
from stillroom.tracking.flow_tracking import FlowTracking, OrbAlways
from stillroom.tracking.keyframe_policy import KeyframePolicy
from stillroom.tracking.last_look import LastLook, NoLastLook
from stillroom.tracking.relocalizer import Relocalizer
from stillroom.tracking.reported_poses import OwnPoses, ReportedPoses, reported_poses
from stillroom.tracking.start import DepthStart, Start
from stillroom.tracking.tracker import Tracker
from stillroom.viz.no_observer import NoObserver


@dataclass
class System:
    """A SLAM system for one kind of camera, put together by `build`."""

    schedule: Schedule
    segmenter: Segmenter
    see: Callable[[Image], Semantics] | None
    dense_stereo: Callable[[Image], F32] | None
    clusterer: Clusterer
    features: FeatureExtractor
    keypoint_sieve: KeypointSieve
    sieve: Asking
    tracker: Tracker
    flow: FlowTracking | OrbAlways
    recovery: Relocalizer
    keyframe_policy: KeyframePolicy
    mapper: LocalMapper
    places: PlaceMemory
    joiner: SubmapJoiner
    loop_closer: LoopClosing
    dense_mapper: DenseMapping
    keeper: MapKeeping
    map: Map
    observer: RunObserver
    reported: ReportedPoses | OwnPoses
    last_look: LastLook | NoLastLook
    results: list[FrameSummary] = field(default_factory=list)
    first_keyframe: int = 0
    n_repeated: int = 0
    _ahead: deque[tuple[Image, Image, Pending[Frame] | None, Perceived]] = field(default_factory=deque)
    _adjusted: Pending[None] = field(default_factory=partial(Done, None))  # keyframes that were put back

    def process(self, image: Image) -> FrameResult:
        """Track one image; images come in order of time."""
        image, extracted, semantics = self._begun(image)
        with self.map.lock.frame():
            tracked = self.flow.follow(image, semantics, self.map)  # between keyframes, where the method wants it
            if tracked is None:
                with self.map.lock.let_go():
                    frame = self.keypoint_sieve(self._extracted(image, extracted), semantics)  # sieve 1
                tracked = self.tracker.track(frame, semantics, self.map)  # sieve 2 inside: a pose, and what is dynamic
            if tracked.lost:
                tracked = self.recovery.recover(tracked, semantics, self.map)
            keyframe = -1
            if self.keyframe_policy.wants(tracked, self.map, self._mapping_keeps_up):
                tracked = self._seen_by_network(tracked)  # where the network sees keyframes only
                keyframe = self.mapper.insert(tracked)  # now: points from depth, from static keypoints only
            with self.map.lock.let_go():
                if keyframe >= 0:
                    self._refine_around(keyframe, image, tracked)
                self._map_densely(tracked, keyframe)
            return self._conclude(tracked, semantics, keyframe)

    def begin(self, image: Image) -> None:
        """Submit what does not depend on earlier poses for an image that will be processed next.

        Workers do it while the image before is tracked. Images that are begun must be processed, in the same order; one
        that was begun already is not begun again.
        """
        if any(begun is image for begun, *_ in self._ahead):
            return
        submit, waiting = self.schedule.submit, self.map.lock.let_go
        seen = self._with_depth_image(image)
        found = submit(Worker.SEMANTICS, self.segmenter, seen)  # potentially dynamic; awaited by its readers
        clustered = submit(Worker.CLUSTERS, self.clusterer, seen, found)  # the same, with clusters of the depth cloud
        extracted = submit(Worker.FEATURES, self.features.extract, seen) if self.flow.extracts_all else None
        self._ahead.append((image, seen, extracted, Perceived(found, clustered, waiting)))

    def repeat(self, result: FrameResult, image: Image) -> FrameResult:
        """Give an image that shows exactly what the one before it did that one's pose, and count it.

        Args:
            result: The result of the image before.
            image: The image that repeats it.
        """
        repeated = replace(
            result, index=image.index, timestamp_s=image.timestamp_s, is_keyframe=False, recovery=Recovery.NONE,
            n_agreeing=0,
        )  # fmt: skip
        self.n_repeated += 1
        self.reported.repeat(repeated, self.results)
        self.results.append(repeated.summary)
        self.last_look.repeat()
        self.keeper.note(repeated.summary)
        return repeated

    def trajectory(self) -> Trajectory:
        """Return the final poses: each frame relative to its reference keyframe's current pose, under the prior.

        Lost frames are left out, and those in sub-maps that were never merged with the main one.
        """
        placed = self._in_main()
        poses = [self._pose_now(result) for result in placed]
        own = self._as_trajectory([result.timestamp_s for result in placed], poses)
        return self.reported.in_the_end(own, [result.n_agreeing_finally for result in placed])

    def online_trajectory(self) -> Trajectory:
        """Return the poses as `process` returned them, of frames that were in the main sub-map at that moment."""
        main = self.main_submap
        placed = [(r.timestamp_s, r.T_world_cam) for r in self.results if r.T_world_cam is not None if r.submap == main]
        return self._as_trajectory([stamp for stamp, _ in placed], [pose for _, pose in placed])

    def lagged_trajectory(self) -> Trajectory | None:
        """Return the online poses each as settled a few frames later, under the prior; None where there is no prior."""
        return self.reported.lagged(self.main_submap)

    def keyframe_trajectory(self) -> Trajectory:
        """Return the poses of this run's keyframes in the main sub-map; those of earlier runs are left out."""
        keyframes = self.map.keyframes
        chosen = np.flatnonzero(keyframes.is_alive & (keyframes.submap == self.main_submap))
        chosen = chosen[chosen >= self.first_keyframe]
        return self._as_trajectory(list(keyframes.timestamp_s[chosen]), list(keyframes.T_world_cam[chosen]))

    @property
    def main_submap(self) -> int:
        """Id of the sub-map of the trajectories."""
        return submaps.main(self.map, self.first_keyframe)

    def apart(self) -> list[FrameSummary]:
        """Return the frames that were tracked in sub-maps that are not merged with the main one."""
        in_main = {result.index for result in self._in_main()}
        return [result for result in self.results if result.T_world_cam is not None and result.index not in in_main]

    def dense_cloud(self) -> DenseCloud | None:
        """Return the dense map under the poses as known now; None where none is made."""
        self.schedule.submit(Worker.DENSE, self.dense_mapper.refresh)
        return self.schedule.submit(Worker.DENSE, self.dense_mapper.cloud).result()

    def close(self) -> None:
        """Finish pending work, optimise the whole map a last time, and look at it once more from each frame."""
        try:
            self.schedule.submit(Worker.MAPPING, self.mapper.finish)
        finally:
            self.schedule.close()
        self._found_again()
        self.results = self.last_look.again(self.results)

    def _begun(self, image: Image) -> tuple[Image, Pending[Frame] | None, Perceived]:
        """Return an image as parts see it, and what workers do with it; those begun before it are dropped."""
        self.begin(image)
        while True:
            begun, seen, extracted, semantics = self._ahead.popleft()
            if begun is image:
                return seen, extracted, semantics

    def _with_depth_image(self, image: Image) -> Image:
        """Return a pair with the depth image that is made of it, where one is wanted; else the image."""
        if self.dense_stereo is None or not isinstance(image, StereoImage):
            return image
        made = self.schedule.submit(Worker.CLUSTERS, self.dense_stereo, image)  # awaited by its readers
        return replace(image, depth_of_pair=made.result)

    def _extracted(self, image: Image, begun: Pending[Frame] | None) -> Frame:
        """Return the keypoints of an image; those that no worker has begun are awaited by tracking at once."""
        return self.features.extract(image) if begun is None else begun.result()

    def _seen_by_network(self, tracked: Tracked) -> Tracked:
        """Return a frame that becomes a keyframe, after a network that sees keyframes only has seen it."""
        if self.see is None:
            return tracked
        with self.map.lock.let_go():
            found = self.schedule.submit(Worker.SEMANTICS, self.see, tracked.frame.image).result()
        return self.sieve.seen(tracked, found)

    @property
    def _mapping_keeps_up(self) -> bool:
        return self.schedule.keeps_up(Worker.MAPPING) and self.schedule.keeps_up(Worker.DENSE)

    def _refine_around(self, keyframe: int, image: Image, tracked: Tracked) -> None:
        """Submit the mapping of a new keyframe."""
        submit = self.schedule.submit
        submit(Worker.MAPPING, self.mapper.refine, keyframe)  # triangulate, fuse, adjust, cull
        submit(Worker.MAPPING, self.places.remember, keyframe)  # place index; culled ones are removed
        submit(Worker.MAPPING, self.joiner.join, keyframe)  # merge sub-maps where a place is recognised
        submit(Worker.MAPPING, self.loop_closer.close, keyframe)  # correct the map where a place is seen again
        submit(Worker.MAPPING, self.keeper.keep, keyframe, image, tracked.motion.moving)  # on disk, where wanted

    def _map_densely(self, tracked: Tracked, keyframe: int) -> None:
        """Pass the frame to the dense map (sieve 3): keyframes are fused, other frames carve free space."""
        image, moving = tracked.frame.image, tracked.motion.moving
        if keyframe >= 0:
            self.schedule.submit(Worker.DENSE, self.dense_mapper.integrate, keyframe, image, moving)
        elif tracked.T_world_cam is not None:
            self.schedule.offer(Worker.DENSE, self.dense_mapper.carve, image, tracked.T_world_cam, moving)

    def _conclude(self, tracked: Tracked, semantics: Perceived, keyframe: int) -> FrameResult:
        """Store the frame in tracker and sieve, after mapping, and keep a summary of it."""
        tracked, n_agreeing = self._revised(tracked), tracked.n_inliers
        if keyframe >= 0:
            tracked = replace(
                tracked,
                reference_keyframe=keyframe,
                T_world_cam=self.map.keyframe_pose(keyframe),
                point_ids=self.map.points_of(keyframe).copy(),
            )
        self.tracker.remember(tracked, self.map)
        frame = tracked.frame
        if tracked.T_world_cam is not None:
            self.sieve.remember(frame, se3.inverse(tracked.T_world_cam), keyframe)
        result = FrameResult(
            index=frame.image.index,
            timestamp_s=frame.timestamp_s,
            state=tracked.state,
            T_world_cam=tracked.T_world_cam,
            n_keypoints=len(frame),
            n_static=int(tracked.is_static.sum()),
            n_inliers=tracked.n_inliers,
            n_keyframes=len(self.map.alive_keyframes()),
            is_keyframe=keyframe >= 0,
            reference_keyframe=tracked.reference_keyframe,
            T_reference_cam=self._in_reference(tracked),
            submap=self._submap_of(tracked),
            recovery=tracked.recovery,
            n_agreeing=n_agreeing,
            motion=replace(tracked.motion, is_static=tracked.is_static),
            keypoints=frame.keypoints,
        )
        result = self.reported.at_once(result, self.results)
        self.results.append(result.summary)
        self.last_look.keep(tracked)
        self.keeper.note(result.summary)
        self.observer.on_frame(tracked, semantics.result(), result)
        return result

    def _revised(self, tracked: Tracked) -> Tracked:
        """Return the frame, and correct earlier ones, after it turned out that they were found in a wrong way."""
        # Their keyframes are adjusted before, but not awaited: mapping may be waiting for the end of this frame.
        if keyframes := self.tracker.put_back():
            with self.map.lock.let_go():
                self._adjusted = self.schedule.submit(Worker.MAPPING, self.mapper.adjust, keyframes)
        again = self._found_again() if self._adjusted.done() else {}
        return replace(tracked, T_world_cam=again.get(tracked.frame.image.index, tracked.T_world_cam))

    def _found_again(self) -> dict[int, F64]:
        """Correct the results of frames that are found again; return their poses by the index of the image."""
        again = self.tracker.found_again(self.map)
        for place, result in enumerate(self.results) if again else ():
            if result.index in again and result.T_reference_cam is not None:
                noted = self.map.noted_in(result.reference_keyframe, again[result.index])
                self.results[place] = replace(result, T_reference_cam=noted)
        return again

    def _in_main(self) -> list[FrameSummary]:
        """Return the frames that have a pose in the main sub-map."""
        main, submap = self.main_submap, self.map.keyframes.submap
        return [r for r in self.results if r.T_reference_cam is not None and submap[r.reference_keyframe] == main]

    def _as_trajectory(self, timestamps_s: list[float], poses: list[F64]) -> Trajectory:
        T_world_cam = np.array(poses, dtype=np.float64).reshape(-1, 4, 4)
        return Trajectory(np.array(timestamps_s, dtype=np.float64), T_world_cam, self.map.sensor.is_metric)

    def _pose_now(self, result: FrameSummary) -> F64:
        assert result.T_reference_cam is not None
        return self.map.placed_by(result.reference_keyframe, result.T_reference_cam)

    def _submap_of(self, tracked: Tracked) -> int:
        known = tracked.reference_keyframe >= 0
        return int(self.map.keyframes.submap[tracked.reference_keyframe]) if known else 0

    def _in_reference(self, tracked: Tracked) -> F64 | None:
        if tracked.T_world_cam is None:
            return None
        return self.map.noted_in(tracked.reference_keyframe, tracked.T_world_cam)


def build(
    config: SlamConfig,
    camera: Camera,
    segmenter: Segmenter | None = None,
    schedule: Schedule | None = None,
    observer: RunObserver | None = None,
    clock: StageClock | None = None,
    world: Map | None = None,
    keeper: MapKeeping | None = None,
    sensor: Sensor = Sensor.RGBD,
) -> System:
    """Put a system together.

    Args:
        config: What it consists of; in pixels of images 640 long, whatever the camera's size.
        camera: The calibration of its images.
        segmenter: The segmenter; by default that of the config.
        schedule: When work runs; in order by default.
        observer: Called with every frame; none by default.
        clock: Times the stages. `tracking` includes `dynamics`, sieve 2; `memory` is the update of that sieve's memory.
        world: The map of an earlier run to extend; by default a new one.
        keeper: Writes the map to disk; none by default.
        sensor: What kind of camera takes the images.

    Raises:
        ConfigError, WeightsError, VocabularyError: A value is impossible; what it names is absent, or cannot be read.
    """
    config = _checked(config, camera, sensor)
    clock, world = clock or StageClock(), world or Map(config.features.scales(camera, sensor), sensor)
    parts = Parts(camera, world, config.seed, clock, schedule or InOrder(), sensor)
    sieve = timed_part(Asking(config.dynamics.build(parts), world), clock, judge="dynamics", remember="memory")
    tracker = config.tracking.build(parts, sieve, config.low_cost.build(parts, sieve), _start(config, parts, sieve))
    policy, keypoints, dense = config.keyframes.build(parts), config.keypoints.build(parts), config.dense.build(parts)
    segmenter, places = segmenter or config.semantics.build(parts), config.places.build(parts)
    places.remember_all()
    return System(
        schedule=parts.schedule,
        segmenter=clock.timed("semantics", segmenter),
        see=clock.timed("semantics", segmenter.see) if isinstance(segmenter, KeyframeSegmenter) else None,
        dense_stereo=config.stereo.build_dense(parts),
        clusterer=clock.timed("clusters", config.clusters.build(parts)),
        features=timed_part(_features(config, parts), clock, extract="features"),
        keypoint_sieve=keypoints,
        sieve=sieve,
        tracker=timed_part(tracker, clock, track="tracking"),
        flow=timed_part(config.tracking.build_flow(tracker, keypoints, policy), clock, follow="flow"),
        recovery=timed_part(config.recovery.build(parts, tracker, places), clock, recover="recovery"),
        keyframe_policy=policy,
        mapper=timed_part(config.mapping.build(parts), clock, insert="keyframe", refine="mapping", finish="rest"),
        places=timed_part(places, clock, remember="places"),
        joiner=timed_part(config.joining.build(parts, places, _refreshing(dense, parts)), clock, join="joining"),
        loop_closer=timed_part(config.loops.build(parts, places, _refreshing(dense, parts)), clock, close="loops"),
        dense_mapper=timed_part(dense, clock, integrate="dense", carve="carving"),
        keeper=timed_part(keeper, clock, keep="storage") if keeper else NoKeeper(),
        map=world,
        observer=observer or NoObserver(),
        reported=reported_poses(config.trajectory, world),
        last_look=config.last_look.build(parts, tracker, config.trajectory),
        first_keyframe=len(world.keyframes),
    )


def _checked(config: SlamConfig, camera: Camera, sensor: Sensor) -> SlamConfig:
    """Return a config that is within its bounds, for a sensor, in pixels of a camera's images."""
    check(config)
    return in_pixels_of(config if sensor.is_metric else for_single_camera(config), camera.pixel_scale)


def _refreshing(dense: DenseMapping, parts: Parts) -> tuple[Callable[[], object]]:
    """Return what follows a change of the whole map: the dense map is built again, by its worker."""
    return (partial(parts.schedule.submit, Worker.DENSE, dense.refresh),)


def _start(config: SlamConfig, parts: Parts, sieve: Asking) -> Start:
    """Return how a map begins, with the sensor that there is."""
    if parts.sensor.is_metric:
        return DepthStart(config.tracking.min_initial_keypoints, sieve)
    return config.monocular.build(parts, sieve)


def _features(config: SlamConfig, parts: Parts) -> FeatureExtractor:
    """Return what finds keypoints; a single camera begins a map with more of them."""
    features, depth = config.features, _keypoint_depth(config, parts)
    if parts.sensor.is_metric:
        return features.build(parts, depth)
    many = features.many(config.monocular.features_before_map)
    return UntilMap(many.build(parts, depth), features.build(parts, depth), parts.world)


def _keypoint_depth(config: SlamConfig, parts: Parts) -> KeypointDepth:
    """Return where keypoints get their depth from, with the sensor that there is."""
    match parts.sensor:
        case Sensor.RGBD:
            return config.features.registered_depth(parts.camera)
        case Sensor.STEREO:
            return config.stereo.build(parts, config.features)
        case Sensor.MONOCULAR:
            return NoDepth()


def segmenter_of(
    config: SlamConfig, camera: Camera, schedule: Schedule | None = None, sensor: Sensor = Sensor.RGBD
) -> Segmenter:
    """Return the segmenter of a config on its own, such as to check early for missing files.

    Args:
        config: The config.
        camera: The calibration of the images.
        schedule: That of the system that will use it; in order by default.
        sensor: What kind of camera takes the images.

    Raises:
        ConfigError, WeightsError: As `build`.
    """
    world = Map(config.features.scales(camera, sensor), sensor)
    parts = Parts(camera, world, config.seed, schedule=schedule or InOrder(), sensor=sensor)
    return in_pixels_of(config.semantics, camera.pixel_scale).build(parts)
