"""DS-SLAM: a person whom enough points leave their epipolar lines on goes whole; who stands still is tracked.

Differs from the paper: the masks are the PSPNet's of `pspnet-slam`, in place of SegNet's, and their borders are refined
by depth. How many points are enough is not said (`dynamics/moving_consistency.py`). Every image has keypoints of its
own, as in the paper.
"""

from stillroom.config import SlamConfig
from stillroom.dense.octomap import OctoMapConfig
from stillroom.dynamics.moving_consistency import MovingConsistencyConfig
from stillroom.presets.method import Method
from stillroom.semantics.masks.pspnet import PspNetConfig

METHOD = Method(
    name="ds-slam",
    summary="PSPNet masks of people; one on whom enough points leave their epipolar lines goes whole",
    config=SlamConfig(
        method="ds-slam",
        semantics=PspNetConfig(input="320x240"),
        dynamics=MovingConsistencyConfig(),
        dense=OctoMapConfig(),
    ),
    paper="Yu, Liu, Liu, Xie, Yang, Wei and Fei, IROS 2018",
)
