"""Detect-SLAM: a detector on keyframes only, and a moving probability that keypoints and map points hand on.

Differs from the paper: the boxes are those of the larger YOLO-Fastest, in place of SSD's; the threshold of their scores
is not given. What the propagation is made of is in `dynamics/moving_probability.py`. The map of objects (section 3.2),
and how it helps the detector (3.3), are left out. Every image has keypoints of its own, as in the paper.
"""

from stillroom.config import SlamConfig
from stillroom.dynamics.moving_probability import MovingProbabilityConfig
from stillroom.presets.method import Method
from stillroom.semantics.seen_images import KEYFRAMES
from stillroom.semantics.yolo_fastest import YoloFastestConfig

MOVABLE = ("person", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "car")
"""People, animals and cars (docs/reference.md#detect-slam)."""

METHOD = Method(
    name="detect-slam",
    summary="YOLO-Fastest boxes on keyframes; keypoints and map points hand on a moving probability",
    config=SlamConfig(
        method="detect-slam",
        semantics=YoloFastestConfig(variant="1.1-xl", confidence=0.5, movable=MOVABLE, sees=KEYFRAMES),
        dynamics=MovingProbabilityConfig(),
    ),
    paper="Zhong, Wang, Zhang, Chen and Wang, WACV 2018",
)
