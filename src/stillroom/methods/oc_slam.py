"""OC-SLAM: YOLO-Fastest's boxes, and in them an epipolar constraint on the matches.

Differs from the paper: the constraint is taken from the tracked pose and helped by depth, and what lies in a box counts
as moving until shown to be static (`dynamics/epipolar.py` says why). The paper's literal rule is
`--set dynamics.kind=paper-epipolar`. Clusters of the depth cloud and the dense map are not there yet.
"""

from stillroom.config import SlamConfig
from stillroom.dynamics.epipolar import EpipolarConfig
from stillroom.methods.method import Method
from stillroom.semantics.yolo_fastest import YoloFastestConfig

METHOD = Method(
    name="oc-slam",
    summary="YOLO-Fastest boxes; in them, matches must keep to their epipolar lines and their depth",
    config=SlamConfig(method="oc-slam", semantics=YoloFastestConfig(), dynamics=EpipolarConfig()),
    paper="Wu, Deng, Li and Li, Frontiers in Energy Research 9:803631, 2021",
)
