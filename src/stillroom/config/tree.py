"""The configuration of a whole system: one tree of frozen dataclasses.

Reading, writing and overriding it lives in `settings`; this module only declares it.
"""

from dataclasses import dataclass, field

from stillroom.config.kinds import (
    CLUSTERS,
    DENSE,
    DYNAMICS,
    KEYPOINTS,
    LOW_COST,
    SEMANTICS,
    ClustererConfig,
    DenseMappingConfig,
    KeypointSieveConfig,
    MatchSieveConfig,
    QuickTrackingConfig,
    SegmenterConfig,
)
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.dynamics.chain import KeepAllConfig, KeepAllKeypointsConfig
from stillroom.features.orb import OrbConfig
from stillroom.features.places.place_index import PlacesConfig
from stillroom.features.stereo_matching import StereoConfig
from stillroom.loops.joining import JoiningConfig
from stillroom.loops.loop_closer import LoopsConfig
from stillroom.mapping.local_mapper import LocalMapperConfig
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.semantics.depth_clusters import NoClustersConfig
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.storage.keeper import MapKeeperConfig
from stillroom.tracking.keyframe_policy import KeyframePolicyConfig
from stillroom.tracking.low_cost import NoLowCostConfig
from stillroom.tracking.monocular import MonocularConfig
from stillroom.tracking.relocalizer import RelocalizerConfig
from stillroom.tracking.tracker import TrackerConfig


@dataclass(frozen=True)
class SlamConfig:
    """Everything that a run depends on, apart from its input.

    Attributes:
        method: Name of the preset that it started from.
        seed: Seed of all random choices.
        semantics: The segmenter: what is potentially dynamic; `kind` chooses the part (see `kinds`).
        clusters: Clusters of an image's depth cloud; `kind` chooses the part.
        keypoints: Which keypoints tracking may use (sieve 1); `kind` chooses the part.
        dynamics: What is dynamic (sieve 2); `kind` chooses the part.
        low_cost: Low-cost tracking: a pose before the tracking stages, for geometry to start from; `kind` chooses the
            part.
        features: Keypoints.
        stereo: Depth of keypoints from pairs of images, with a stereo camera.
        monocular: How a map is begun with a single camera.
        places: The bag-of-words index of keyframes, for place recognition.
        tracking, recovery, keyframes, mapping, loops: ORB-SLAM2's parts.
        joining: When sub-maps are merged.
        trajectory: The prior under which the poses of all frames become one estimate.
        dense: The dense map (sieve 3); `kind` chooses the part.
        storage: What a map file keeps in addition to the map, where a run writes one.
    """

    method: str = "orb-slam2"
    seed: int = 0
    semantics: SegmenterConfig = field(default_factory=NothingConfig, metadata={"kinds": SEMANTICS})
    clusters: ClustererConfig = field(default_factory=NoClustersConfig, metadata={"kinds": CLUSTERS})
    keypoints: KeypointSieveConfig = field(default_factory=KeepAllKeypointsConfig, metadata={"kinds": KEYPOINTS})
    dynamics: MatchSieveConfig = field(default_factory=KeepAllConfig, metadata={"kinds": DYNAMICS})
    low_cost: QuickTrackingConfig = field(default_factory=NoLowCostConfig, metadata={"kinds": LOW_COST})
    features: OrbConfig = field(default_factory=OrbConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    monocular: MonocularConfig = field(default_factory=MonocularConfig)
    places: PlacesConfig = field(default_factory=PlacesConfig)
    tracking: TrackerConfig = field(default_factory=TrackerConfig)
    recovery: RelocalizerConfig = field(default_factory=RelocalizerConfig)
    keyframes: KeyframePolicyConfig = field(default_factory=KeyframePolicyConfig)
    mapping: LocalMapperConfig = field(default_factory=LocalMapperConfig)
    loops: LoopsConfig = field(default_factory=LoopsConfig)
    joining: JoiningConfig = field(default_factory=JoiningConfig)
    trajectory: TrajectoryPriorConfig = field(default_factory=TrajectoryPriorConfig)
    dense: DenseMappingConfig = field(default_factory=NoDenseMapConfig, metadata={"kinds": DENSE})
    storage: MapKeeperConfig = field(default_factory=MapKeeperConfig)
