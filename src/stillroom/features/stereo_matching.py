"""Depth of keypoints from a rectified pair of images."""

from dataclasses import dataclass

from stillroom.bounds import bounded
from stillroom.errors import ConfigError
from stillroom.features.keypoint_depth import KeypointDepth
from stillroom.protocols import Parts


@dataclass(frozen=True)
class StereoConfig:
    """How depth is found in a pair of images.

    Attributes:
        dense: How a depth image is made of the pair, for the parts that need one: "none", or "sgbm" for OpenCV's
            semi-global matching.
    """

    dense: str = bounded("none", one_of=("none", "sgbm"))

    def build(self, parts: Parts) -> KeypointDepth:
        """Return the matcher of a camera's pairs."""
        raise ConfigError("stereo pairs cannot be matched yet")
