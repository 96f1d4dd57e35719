"""What a part is built of in a test."""

from small_world import CAMERA, SCALES

from stillroom.data.map import Map
from stillroom.geometry.camera import Camera
from stillroom.protocols import Parts


def parts(camera: Camera = CAMERA, world: Map | None = None, seed: int = 0) -> Parts:
    """Return parts of a small world's camera and an empty map, where nothing else is said."""
    return Parts(camera, Map(SCALES) if world is None else world, seed)
