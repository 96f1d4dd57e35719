"""Two images of tiles that slide sideways, each as far as its depth has it: all epipolar lines are level.

The camera goes to the right by 4 cm before tiles at three depths, in no order over the image, so that one fundamental
matrix alone explains them: what goes up or down is off its line by that much, what goes sideways stays on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from asked import ask
from small_world import CAMERA, SCALES

from stillroom.data.frame import Frame, Keypoints
from stillroom.data.image import RgbdImage
from stillroom.data.map import Map
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.protocols import MatchSieve
from stillroom.schedule import Done

HEIGHT, WIDTH, TILE = 480, 640, 160
SHIFTS_PX = (3, 6, 10)
STEP_PX = 12
"""Distance of keypoints."""


@lru_cache
def texture(seed: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Return something with corners everywhere (H, W) uint8."""
    noise = np.random.default_rng(seed).integers(0, 256, (height // 5 + 2, width // 5 + 2), dtype=np.uint8)
    large = cv2.resize(noise, None, fx=5, fy=5, interpolation=cv2.INTER_CUBIC)[:height, :width]
    return cv2.GaussianBlur(large, (0, 0), 1.0)


@dataclass(frozen=True)
class Patch:
    """A flat thing with a pattern of its own: where it is in the present image, and how far it came since the last."""

    x: int
    y: int
    width: int = 120
    height: int = 240
    dx: int = 0
    dy: int = 0

    @property
    def window(self) -> tuple[slice, slice]:
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    @property
    def box(self) -> Box:
        return Box(self.x, self.y, self.x + self.width - 1, self.y + self.height - 1, "person", 0.9)

    @property
    def chair(self) -> Box:
        return Box(*self.box.xyxy_px, "chair", 0.9)

    def mask(self) -> np.ndarray:
        pixels = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
        pixels[self.window] = True
        return pixels

    def on(self, frame: Frame, rim_px: int = 0) -> np.ndarray:
        """Which keypoints (N,) lie on it, and not near its rim, one after the other."""
        y, x = self.window
        inside = [
            x.start + rim_px <= u < x.stop - rim_px and y.start + rim_px <= v < y.stop - rim_px
            for u, v in frame.keypoints.raw_px.tolist()
        ]
        return np.array(inside)


def pictures(things: Sequence[Patch]) -> tuple[np.ndarray, np.ndarray]:
    """Return the last image and the present one (H, W) uint8."""
    last = texture(1).copy()
    rng = np.random.default_rng(2)
    now = texture(3).copy()
    for y in range(0, HEIGHT, TILE):
        for x in range(0, WIDTH, TILE):
            shift = int(rng.choice(SHIFTS_PX))
            tile = last[y : y + TILE, x : x + TILE - 10]
            now[y : y + TILE, x + shift : x + shift + tile.shape[1]] = tile[:, : WIDTH - x - shift]
    for k, thing in enumerate(things):
        own = texture(10 + k)[: thing.height, : thing.width]
        now[thing.window] = own
        last[thing.y - thing.dy :, thing.x - thing.dx :][: thing.height, : thing.width] = own
    return last, now


def frame_of(gray: np.ndarray, index: int, depth_m: np.ndarray | None = None) -> Frame:
    """Return a frame with a keypoint every so many pixels, of random descriptors that are the same each time."""
    row, column = np.mgrid[20 : HEIGHT - 20 : STEP_PX, 20 : WIDTH - 20 : STEP_PX]
    px = np.stack((column.ravel(), row.ravel()), axis=1).astype(np.float32)
    n = len(px)
    deep = np.full((HEIGHT, WIDTH), 2.0, np.float32) if depth_m is None else depth_m
    depth = deep[row.ravel(), column.ravel()]
    keypoints = Keypoints(
        px=px,
        raw_px=px,
        octave=np.zeros(n, np.int32),
        angle_rad=np.zeros(n, np.float32),
        descriptors=np.random.default_rng(7).integers(0, 256, (n, 32), dtype=np.uint8),
        depth_m=depth,
        right_px=CAMERA.right_coordinate(px[:, 0], depth),
    )
    image = RgbdImage(index / 30.0, np.repeat(gray[:, :, None], 3, axis=2), deep, index)
    return Frame(image, CAMERA, SCALES, keypoints, np.ones(n, dtype=np.bool_))


@dataclass
class TwoImages:
    """A sieve that is shown the last image and then the present one; what is said of the latter counts."""

    things: Sequence[Patch]
    semantics: Semantics = field(default_factory=lambda: Semantics(HEIGHT, WIDTH))
    depth_m: np.ndarray | None = None

    def __post_init__(self) -> None:
        last, now = pictures(self.things)
        self.last, self.now = frame_of(last, 4, self.depth_m), frame_of(now, 5, self.depth_m)

    def ask(
        self,
        sieve: MatchSieve,
        matches: Matches | None = None,
        world: Map | None = None,
        stage: Stage = Stage.LOCAL_MAP,
        with_last: bool = True,
    ) -> Motion:
        world, here = world or Map(SCALES), np.eye(4)
        unmatched = Matches.of(np.full(len(self.now), -1, dtype=np.int32))
        if with_last:
            ask(sieve, Stage.LOCAL_MAP, self.last, unmatched, Done(self.semantics), here, world)
        return ask(sieve, stage, self.now, matches or unmatched, Done(self.semantics), here, world)
