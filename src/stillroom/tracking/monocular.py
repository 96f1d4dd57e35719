"""Settings of tracking with a single camera, whose depth comes from motion alone."""

from dataclasses import dataclass

from stillroom.bounds import bounded


@dataclass(frozen=True)
class MonocularConfig:
    """How a map is begun with a single camera (ORB-SLAM; docs/reference.md#orb-slam2-camera-and-features).

    Attributes:
        min_matches: Fewest matches with the first image; with fewer, the present image takes its place.
    """

    min_matches: int = bounded(100, least=8)
