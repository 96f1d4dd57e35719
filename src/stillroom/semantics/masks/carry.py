"""Carry a mask from the image in which it is known to a later one: by dense flow, gated by depth.

NGD-SLAM's mask propagation answers the same question (docs/reference.md#ngd-slam): erode, follow one corner in each
cell of 15 px by flow, take what is within ±0.3 m of their median depth. Differs from it: dense inverse-search flow
(Kroeger et al., ECCV 2016) from image to image, with the border mended by depth at each step. It knows no corners, so
that plain clothes do; and the mask keeps its shape, also where people stand one behind another.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.semantics.masks.segments import HalfImage, Segments


@dataclass(frozen=True)
class MaskCarryConfig:
    """How masks are carried to the present.

    Attributes:
        depth_step_m: What changes its depth by more than this from an image to the next has become something else [m].
    """

    depth_step_m: float = bounded(0.30, above=0)


def carried(segments: Segments, earlier: HalfImage, now: HalfImage, config: MaskCarryConfig) -> Segments:
    """Return where what may move is now.

    Args:
        segments: Where it was in an earlier image.
        earlier: That image.
        now: The next image, of the same size.
        config: How far depth may change between them.
    """
    if not segments.has_any and segments.named is None:
        return segments
    flow_px = now.flow_to(earlier)
    rows, columns = np.indices(now.shape, dtype=np.float32)
    x, y = columns + flow_px[..., 0], rows + flow_px[..., 1]
    label = cv2.remap(segments.label, x, y, cv2.INTER_NEAREST, borderValue=0)
    likely = cv2.remap(segments.probability, x, y, cv2.INTER_LINEAR, borderValue=0)
    before_m = cv2.remap(earlier.depth_m, x, y, cv2.INTER_NEAREST, borderValue=0)
    known = (before_m > 0) & (now.depth_m > 0)
    other = known & (np.abs(now.depth_m - before_m) > config.depth_step_m)
    label[other] = 0
    named = segments.named
    if named is not None:
        named = np.asarray(cv2.remap(named, x, y, cv2.INTER_NEAREST, borderValue=0), dtype=np.uint8)
        named[other] = 0
    return Segments(np.asarray(label, dtype=np.uint8), np.asarray(likely, dtype=np.float32), named)
