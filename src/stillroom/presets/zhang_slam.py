"""L. Zhang et al.: YOLO's boxes, and an object is dynamic when its own points say so.

Differs from the paper: its rule, its detector's thresholds and the parameters of its map were not to be had. The rule
is Stillroom's own (`dynamics/moving_objects.py`), and the boxes are YOLO-Fastest's, as `oc-slam` has them, of people
alone. Every image has keypoints of its own.
"""

from stillroom.config import SlamConfig
from stillroom.dense.octomap import OctoMapConfig
from stillroom.dynamics.moving_objects import MovingObjectsConfig
from stillroom.presets.method import Method
from stillroom.semantics.yolo_fastest import YoloFastestConfig

METHOD = Method(
    name="zhang-slam",
    summary="YOLO-Fastest boxes; an object whose own points move against the background is left out",
    config=SlamConfig(
        method="zhang-slam",
        semantics=YoloFastestConfig(),
        dynamics=MovingObjectsConfig(),
        dense=OctoMapConfig(),
    ),
    paper="L. Zhang, Wei, Shen, Wei, Zhu and Song, IEEE Access 6, 2018",
)
