"""The configuration of a whole system: one tree of frozen dataclasses.

Reading, writing and overriding it lives in `settings`; this page only says what there is.
"""

from dataclasses import dataclass, field

from stillroom.dynamics.keep_all import KeepAllConfig
from stillroom.features.orb import OrbConfig
from stillroom.mapping.local_mapper import LocalMapperConfig
from stillroom.tracking.keyframe_policy import KeyframePolicyConfig
from stillroom.tracking.relocalizer import RelocalizerConfig
from stillroom.tracking.tracker import TrackerConfig


@dataclass(frozen=True)
class SlamConfig:
    """Everything that a run depends on, beside its input.

    Attributes:
        method: Name of the preset that it started from.
        seed: Where every random choice starts.
        features: Keypoints.
        dynamics: What does move (sieve 2).
        tracking, recovery, keyframes, mapping: ORB-SLAM2's parts.
    """

    method: str = "orb-slam2"
    seed: int = 0
    features: OrbConfig = field(default_factory=OrbConfig)
    dynamics: KeepAllConfig = field(default_factory=KeepAllConfig)
    tracking: TrackerConfig = field(default_factory=TrackerConfig)
    recovery: RelocalizerConfig = field(default_factory=RelocalizerConfig)
    keyframes: KeyframePolicyConfig = field(default_factory=KeyframePolicyConfig)
    mapping: LocalMapperConfig = field(default_factory=LocalMapperConfig)
