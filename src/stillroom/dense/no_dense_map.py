"""The null object of systems without a dense map."""

from dataclasses import dataclass

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import Image
from stillroom.geometry.arrays import F64, Bool
from stillroom.protocols import Parts


@dataclass(frozen=True)
class NoDenseMapConfig:
    """No settings."""

    def build(self, parts: Parts | None = None) -> "NoDenseMap":
        """Return the null object."""
        return NoDenseMap()


class NoDenseMap:
    """Ignores every frame, so that no caller has to check whether there is a dense map."""

    def integrate(self, keyframe: int, image: Image, excluded: Bool | None = None) -> None:
        """Do nothing."""

    def carve(self, image: Image, T_world_cam: F64, excluded: Bool | None = None) -> None:
        """Do nothing."""

    def refresh(self) -> None:
        """Do nothing."""

    def cloud(self) -> DenseCloud | None:
        """Return that there is none."""
        return None
