"""How a run uses a map file: it makes it, extends it, or tracks against it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from stillroom.bounds import in_pixels_of
from stillroom.config import SlamConfig, to_toml
from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.map import Map
from stillroom.data.sensor import Sensor
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.errors import MapError
from stillroom.features.places.vocabulary import load_vocabulary
from stillroom.geometry.camera import Camera
from stillroom.protocols import Parts
from stillroom.session.provenance import provenance
from stillroom.storage.keeper import MapKeeper
from stillroom.storage.opening import inspect, require_unused
from stillroom.storage.reader import keyframe_images, load_map
from stillroom.storage.schema import Session, StoredMap
from stillroom.storage.writer import MapWriter


class MapUse(StrEnum):
    """What a run does with a map file."""

    NEW = "new"
    """Make it, and write it as it grows."""
    CONTINUE = "continue"
    """Relocalize in the map first, and extend it; write it as it grows."""
    LOCALIZE = "localize"
    """Track against it as it is; the file is read once, and nothing is written."""


@dataclass(frozen=True)
class MapFile:
    """A map file and what is to be done with it."""

    path: Path
    use: MapUse = MapUse.NEW

    @property
    def earlier(self) -> Path | None:
        """The file, where it is of earlier runs; None where it is made."""
        return None if self.use is MapUse.NEW else self.path

    def described(self) -> dict[str, str]:
        """Return what config.toml says of it."""
        return {"map": str(self.path), "map_use": self.use.value}

    def require_usable(self) -> None:
        """See to it that the file is there, or is not there yet, as its use asks; it is not touched.

        Raises:
            MapError: It is not so.
        """
        if self.use is MapUse.NEW:
            require_unused(self.path)
        else:
            inspect(self.path)

    def fitting(self, config: SlamConfig) -> SlamConfig:
        """Return the config of a run on this file: one that only tracks adds nothing to the map and moves nothing."""
        if self.use is not MapUse.LOCALIZE:
            return config
        return replace(
            config,
            keyframes=replace(config.keyframes, enabled=False),
            mapping=replace(config.mapping, max_final_keyframes=0),
            recovery=replace(config.recovery, patience=0),
            monocular=replace(config.monocular, patience=0),  # which takes the place of the one above
            loops=replace(config.loops, enabled=False),
            dense=NoDenseMapConfig(),
        )


@dataclass(frozen=True)
class OpenedMap:
    """A map file in use.

    Attributes:
        world: The map in it; None for a run that keeps no map.
        keeper: Writes it; None where nothing is written.
        written: The file, where it is written.
        earlier: What the file held before the run; None where it held nothing.
    """

    world: Map | None = None
    keeper: MapKeeper | None = None
    written: Path | None = None
    earlier: StoredMap | None = None


@contextmanager
def opened_map(
    file: MapFile | None, config: SlamConfig, camera: Camera, sequence: str, sensor: Sensor = Sensor.RGBD
) -> Iterator[OpenedMap]:
    """Open the map file of a run, where it has one, and let it go in any case.

    Args:
        file: The file and what is to be done with it.
        config: The method.
        camera: The calibration of the images to come.
        sequence: What they are called.
        sensor: What kind of camera takes them.

    Raises:
        MapError: The file cannot be used so, or does not fit the config or the camera; it is then as it was.
    """
    if file is None:
        yield OpenedMap()
        return
    earlier = None if file.use is MapUse.NEW else _loaded(file.path, config)
    if earlier is not None:
        _require_sensor(file, earlier.world.sensor, sensor, sequence)
    if file.use is MapUse.LOCALIZE:
        assert earlier is not None
        yield OpenedMap(earlier.world, earlier=earlier)
        return
    if earlier is None:
        world = Map(config.features.scales(camera, sensor), sensor)
        writer = MapWriter.create(file.path, world, camera)
    else:
        _require_camera(file.path, earlier.camera, camera, sequence)
        world, writer = earlier.world, MapWriter.go_on(file.path, earlier.world)
    try:
        number = writer.begin(session_of(world, config, sequence))
        keeper = config.storage.build(Parts(camera, world, config.seed), writer, number)
        yield OpenedMap(world, keeper, file.path, earlier)
    except BaseException:
        writer.abandon()
        if file.use is MapUse.NEW and len(world.keyframes) == 0:
            file.path.unlink(missing_ok=True)  # Nothing is in it, and its name would be in the way of the next try.
        raise
    finally:
        writer.abandon()


def _loaded(path: Path, config: SlamConfig) -> StoredMap:
    stored = load_map(path)
    was, asked = stored.world.scales, config.features.scales(stored.camera, stored.world.sensor)
    if was != asked:
        raise MapError(
            f"{path}: was made with {was.count} pyramid levels of {was.factor}, not {asked.count} of {asked.factor}; "
            f"--set features.n_levels={was.count} --set features.scale_factor={was.factor}"
        )
    if stored.world.is_empty:
        raise MapError(f"{path}: holds no keyframe; there is nothing to recognise; make it again")
    return stored


def _require_sensor(file: MapFile, made_with: Sensor, sensor: Sensor, sequence: str) -> None:
    """Refuse a map that a sensor cannot use so: lengths differ, or one map would hold keyframes of two sensors.

    In a metric map any camera may be localized: the points give the lengths that a single one does not measure.
    """
    if sensor is made_with or (made_with.is_metric and file.use is MapUse.LOCALIZE):
        return
    which = f"{file.path}: is a map of {made_with.words} images, and {sequence} has {sensor.words} ones"
    remedy = "--localize works with any sensor" if made_with.is_metric else "make a new map"
    if made_with.is_metric and sensor.is_metric:
        raise MapError(f"{which}; one map holds one sensor's keyframes; {remedy}")
    raise MapError(
        f"{which}: lengths of a single camera are known up to a factor, those of the other in metres; {remedy}"
    )


def _require_camera(path: Path, made_with: Camera, camera: Camera, sequence: str) -> None:
    if _projection_of(made_with) != _projection_of(camera):
        raise MapError(
            f"{path}: was made with another camera ({_described(made_with)}) than that of {sequence} "
            f"({_described(camera)}); one map holds one camera's keyframes; --localize works with any"
        )


def _projection_of(camera: Camera) -> Camera:
    """Return a camera with what a map file keeps of it: where points are seen, not how rows and depth are measured."""
    plain = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion)
    return replace(plain, depth_factor=camera.depth_factor, bf=camera.bf)


def _described(camera: Camera) -> str:
    return f"{camera.width}×{camera.height}, fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, cy {camera.cy:g}"


def session_of(world: Map, config: SlamConfig, sequence: str, first_keyframe: int | None = None) -> Session:
    """Return what a map file says of a run.

    Args:
        world: The map.
        config: The method.
        sequence: What its images are called.
        first_keyframe: Id of the run's first keyframe; the next one where the run only begins.
    """
    origin, vocabulary = provenance(), config.places.vocabulary
    return Session(
        first_keyframe=len(world.keyframes) if first_keyframe is None else first_keyframe,
        started=origin["date"],
        stillroom=origin["versions"]["stillroom"],
        source_commit=origin["commit"],
        sequence=sequence,
        method=config.method,
        seed=config.seed,
        vocabulary="" if vocabulary is None else vocabulary.name,
        vocabulary_digest=load_vocabulary(vocabulary).digest,
        config=to_toml(config),
    )


# A dense map from the images that a map file keeps of its keyframes.


def dense_cloud(path: Path, stored: StoredMap, config: DenseMapperConfig | None = None) -> DenseCloud:
    """Fuse the kept images under the poses that the map now gives them; what moved has no depth in them.

    Args:
        path: The map file.
        stored: What was loaded of it.
        config: How to fuse.

    Raises:
        MapError: The file keeps no images, or is damaged.
    """
    # A keyframe that is out of date is no witness here: all are fused under their last poses.
    config = config or replace(DenseMapperConfig(), correction_m=0.0, corrections=0)
    config = in_pixels_of(config, stored.camera.pixel_scale)
    mapper, n_fused = config.build(Parts(stored.camera, stored.world)), 0
    for keyframe, image in keyframe_images(path):
        mapper.integrate(keyframe, image)
        n_fused += 1
    if n_fused == 0:
        raise MapError(f"{path}: keeps no images to make a dense map of; run with --set storage.images=true")
    return mapper.cloud()
