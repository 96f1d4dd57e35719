"""A room rendered by the package itself: textured, furnished, peopled, and known to the last pixel."""

from stillroom.datasets.synthetic.config import SyntheticConfig, open_synthetic
from stillroom.datasets.synthetic.room import FrameTruth, SyntheticRoom

__all__ = ["FrameTruth", "SyntheticConfig", "SyntheticRoom", "open_synthetic"]
