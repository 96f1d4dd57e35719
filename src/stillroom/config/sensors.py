"""What of a configuration works with a sensor: the parts that need a depth image go where there is none.

A part says so beside its settings, `needs_depth_image: ClassVar[bool] = True`; the nearest part that works without one
takes its place. `docs/sensors.md` has what comes of each preset.
"""

from dataclasses import replace

from stillroom.config.kinds import ChainConfig, MatchSieveConfig
from stillroom.config.tree import SlamConfig
from stillroom.data.sensor import Sensor
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.dynamics.chain import KeepAllConfig, KeepAllKeypointsConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.dynamics.epipolar_sieve import EpipolarConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.multiview.multiview_sieve import MultiViewConfig
from stillroom.dynamics.paper_clusters import PaperClustersConfig
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig
from stillroom.dynamics.segment_sieve import MovedSegmentsConfig
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.errors import ConfigError
from stillroom.optimize.bundle import BundleConfig
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.semantics.depth_clusters import NoClustersConfig
from stillroom.tracking.shutter import DepthNoiseConfig

NO_DEPTH_IMAGE = {
    Sensor.STEREO: "a stereo pair has no depth image unless --set stereo.dense=sgbm makes one",
    Sensor.MONOCULAR: "a single camera has no depth image",
}


def has_depth_image(config: SlamConfig, sensor: Sensor) -> bool:
    """Return whether images of a sensor have a depth image when they are tracked."""
    return sensor is Sensor.RGBD or (sensor is Sensor.STEREO and config.stereo.dense != "none")


def fit_to_sensor(config: SlamConfig, sensor: Sensor) -> tuple[SlamConfig, tuple[str, ...]]:
    """Return a config without what does not work with a sensor, and what was left out or replaced, in words.

    Args:
        config: The method.
        sensor: What kind of camera takes the images. With an RGB-D one the config is returned as it is.

    Raises:
        ConfigError: Nothing would be left of what the method rejects what moves by.
    """
    if sensor is Sensor.RGBD:
        return config, ()
    left_out: list[str] = []
    fitted = config if has_depth_image(config, sensor) else _without_depth_image(config, left_out)
    if not sensor.is_metric:
        fitted = replace(fitted, dynamics=_without_keypoint_depth(fitted.dynamics, left_out))
    if _is_static_world(fitted) and not _is_static_world(config):
        raise ConfigError(
            f"{config.method}: finds what moves in depth images alone, and {NO_DEPTH_IMAGE[sensor]}; "
            "choose another method, such as pspnet-slam or orb-slam2"
        )
    fitted = _without_structured_light(fitted, left_out)
    if not sensor.is_metric and fitted.trajectory.enabled:
        left_out.append("the prior of smooth motion, which is in metres")
        fitted = replace(fitted, trajectory=TrajectoryPriorConfig())
    return fitted, tuple(left_out)


def with_depth(config: SlamConfig, depth: DepthNoiseConfig) -> SlamConfig:
    """Return a config in which depth counts as it says, in poses and in all bundle adjustments."""
    mapping, loops = config.mapping, config.loops

    def weighed(bundle: BundleConfig) -> BundleConfig:
        return replace(bundle, right_sigma=depth.right_sigma, depth_model=depth.model)

    return replace(
        config,
        tracking=replace(config.tracking, depth=depth),
        mapping=replace(mapping, bundle=weighed(mapping.bundle), looped_bundle=weighed(mapping.looped_bundle)),
        loops=replace(loops, bundle=weighed(loops.bundle)),
    )


def _without_depth_image(config: SlamConfig, left_out: list[str]) -> SlamConfig:
    if _needs(config.clusters):
        left_out.append("clusters of the depth cloud")
        config = replace(config, clusters=NoClustersConfig())
    sieve = _sieve(config.dynamics, left_out)
    if sieve is not config.dynamics:
        config = replace(config, dynamics=sieve)
    if config.tracking.between_keyframes != "orb":
        left_out.append("optical flow between keyframes (every image has keypoints of its own)")
        config = replace(config, tracking=replace(config.tracking, between_keyframes="orb"))
    if _needs(config.dense):
        left_out.append("the dense map")
        config = replace(config, dense=NoDenseMapConfig())
    if config.storage.images:
        left_out.append("images of keyframes in the map file")
        config = replace(config, storage=replace(config.storage, images=False))
    return config


def _sieve(sieve: MatchSieveConfig, left_out: list[str]) -> MatchSieveConfig:
    """Return a match sieve that needs no depth image: the same, its nearest, or one that keeps everything."""
    match sieve:
        case ChainConfig():
            first, second = _sieve(sieve.first, left_out), _sieve(sieve.second, left_out)
            unchanged = first is sieve.first and second is sieve.second
            return sieve if unchanged else replace(sieve, first=first, second=second)
        case MultiViewConfig(geometry=True):
            left_out.append("multi-view geometry")
            return replace(sieve, geometry=False)
        case ClusterSieveConfig() | EpipolarConfig():
            left_out.append("the depth history (all keypoints in a box are dynamic: nothing shows one to be static)")
            return WholeBoxesConfig()
        case PaperClustersConfig():
            left_out.append("moving clusters (pairs in boxes are tested against their epipolar lines alone)")
            return PaperEpipolarConfig()
        case PaperAntsConfig():
            left_out.append("the geometry of projected features (masks alone decide)")
            return WholeBoxesConfig()
        case MovedSegmentsConfig():
            left_out.append("segments that move")
            return KeepAllConfig()
    if not _needs(sieve):
        return sieve
    left_out.append(f"the sieve {type(sieve).__name__}")
    return KeepAllConfig()


def _without_keypoint_depth(sieve: MatchSieveConfig, left_out: list[str]) -> MatchSieveConfig:
    """Return a match sieve that does something where no keypoint has a depth."""
    match sieve:
        case ChainConfig():
            first = _without_keypoint_depth(sieve.first, left_out)
            second = _without_keypoint_depth(sieve.second, left_out)
            unchanged = first is sieve.first and second is sieve.second
            return sieve if unchanged else replace(sieve, first=first, second=second)
        case CompensatedHomographyConfig():
            left_out.append("the compensated homography (it needs keypoints with depth; masks alone decide)")
            return WholeBoxesConfig()
    return sieve


def _without_structured_light(config: SlamConfig, left_out: list[str]) -> SlamConfig:
    """Return a config in which the right coordinate counts as ORB-SLAM2 has it, not as that of structured light."""
    if config.tracking.depth == DepthNoiseConfig():
        return config
    left_out.append("the small noise of structured light (a depth counts as ORB-SLAM2 has it)")
    return with_depth(config, DepthNoiseConfig())


def _needs(part: object) -> bool:
    """Return whether a part says that it needs a depth image."""
    return bool(getattr(part, "needs_depth_image", False))


def _is_static_world(config: SlamConfig) -> bool:
    """Return whether nothing is rejected: neither sieve of the two that tracking asks does anything."""
    return isinstance(config.keypoints, KeepAllKeypointsConfig) and not _rejects(config.dynamics)


def _rejects(sieve: MatchSieveConfig) -> bool:
    match sieve:
        case ChainConfig():
            return _rejects(sieve.first) or _rejects(sieve.second)
        case MultiViewConfig():
            return sieve.geometry or sieve.network
    return not isinstance(sieve, KeepAllConfig)
