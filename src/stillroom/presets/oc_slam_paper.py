"""OC-SLAM as printed, beside `oc-slam`, which is what we made of it.

Boxes of all classes from a confidence of 0.80 on, none carried over images that miss them (2.1); pairs that leave their
epipolar lines, in boxes (2.2); the Euclidean clusters of one image, of which one with most of its pairs failing goes
whole, with its box (2.4, 2.5); a dense map of all keyframes, from which the clusters that were judged to move are
removed by Kd-tree, and nothing else is (2.3, 2.6). Loops are off, as in the paper's evaluation, and no final bundle
adjustment follows.

Differs from the paper (docs/reference.md#oc-slam): where its text leaves something open or prints a slip, see
`dynamics/paper_epipolar.py` and `dynamics/paper_clusters.py`. YOLO-Fastest 1.1 is the published COCO network. Tracking
and mapping are this project's ORB-SLAM2 (`orb-slam2`), with its sub-maps.
"""

from stillroom.config import SlamConfig
from stillroom.dense.carving import KD_TREE, CarvingConfig
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dynamics.paper_clusters import PaperClustersConfig
from stillroom.loops.loop_closer import LoopsConfig
from stillroom.mapping.local_mapper import LocalMapperConfig
from stillroom.presets.method import Method
from stillroom.semantics.carried_boxes import CarryConfig
from stillroom.semantics.depth_clusters import DepthClustersConfig
from stillroom.semantics.yolo_fastest import EVERY_CLASS, YoloFastestConfig

METHOD = Method(
    name="oc-slam-paper",
    summary="OC-SLAM as printed: pairs off their epipolar lines; a cluster with most of its pairs, and its box, go",
    config=SlamConfig(
        method="oc-slam-paper",
        semantics=YoloFastestConfig(movable=EVERY_CLASS, carry=CarryConfig(enabled=False)),
        clusters=DepthClustersConfig(),
        dynamics=PaperClustersConfig(),
        mapping=LocalMapperConfig(max_final_keyframes=0, max_final_keyframes_looped=0),
        loops=LoopsConfig(enabled=False),
        dense=DenseMapperConfig(carving=CarvingConfig(rule=KD_TREE), fuse_every=0),
    ),
    paper="Wu, Deng, Li and Li, Frontiers in Energy Research 9:803631, 2021",
)
