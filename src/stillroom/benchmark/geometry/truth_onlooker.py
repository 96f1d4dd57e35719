"""Looks on at a run on a rendered sequence, and counts what of the moving things was found."""

from dataclasses import dataclass

import numpy as np

from stillroom.data.result import FrameResult, Tracked
from stillroom.data.semantics import Semantics
from stillroom.geometry.arrays import Bool
from stillroom.geometry.growing import Shape, grown
from stillroom.geometry.pixels import values_at
from stillroom.protocols import RenderedDataset

CLEAR_PX = 6
"""Keypoints this near to something that moves count neither as moving nor as static."""


@dataclass
class Count:
    """How many there were, and how many of them were said to move."""

    n: int = 0
    said: int = 0

    def add(self, said: Bool) -> None:
        """Count some (N,)."""
        self.n += len(said)
        self.said += int(np.count_nonzero(said))

    @property
    def share(self) -> float | None:
        """Share of them that was said to move; None where there were none."""
        return self.said / self.n if self.n else None


class MovingThings:
    """What moves in a rendered sequence, rendered once for all runs on it."""

    def __init__(self, room: RenderedDataset) -> None:
        """Take the sequence, whole."""
        self._room = room
        self._packed: dict[int, tuple[bytes, bytes]] = {}
        self._shape = room.camera.height, room.camera.width

    def at(self, index: int) -> tuple[Bool, Bool]:
        """Return the pixels (H, W) of all that moves in an image, and of handled objects that do."""
        if index not in self._packed:
            truth = self._room.truth(index)
            handled = truth.moving & self._room.handled(truth.instance)
            self._packed[index] = np.packbits(truth.moving).tobytes(), np.packbits(handled).tobytes()
        moving, handled = (self._unpacked(packed) for packed in self._packed[index])
        return moving, handled

    def _unpacked(self, packed: bytes) -> Bool:
        height, width = self._shape
        bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=height * width)
        return bits.reshape(height, width).view(np.bool_)


class TruthOnlooker:
    """Holds the verdicts of a run against what truly moves.

    Attributes:
        moving, handled, static: Keypoints on all that moves, on handled objects while they move, and clear of both.
        handled_pixels, static_pixels: Pixels with a depth, likewise.
    """

    def __init__(self, things: MovingThings) -> None:
        """Start counting."""
        self._things = things
        self.moving, self.handled, self.static = Count(), Count(), Count()
        self.handled_pixels, self.static_pixels = Count(), Count()

    def on_frame(self, tracked: Tracked, semantics: Semantics, result: FrameResult) -> None:
        """Count a tracked image."""
        if tracked.T_world_cam is None:
            return
        frame = tracked.frame
        moving, handled = self._things.at(frame.image.index)
        clear = ~grown(moving, CLEAR_PX, Shape.SQUARE)
        said = ~tracked.is_static
        for count, where in ((self.moving, moving), (self.handled, handled), (self.static, clear)):
            count.add(said[values_at(where, frame.keypoints.raw_px)])
        known = frame.image.depth_m > 0
        self.handled_pixels.add(tracked.motion.moving[handled & known])
        self.static_pixels.add(tracked.motion.moving[clear & known])

    def close(self) -> None:
        """Nothing is left open."""
