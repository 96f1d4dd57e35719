"""OC-SLAM: YOLO-Fastest's boxes and the clusters of the depth cloud, and which of them are dynamic.

Differs from the paper, which is the preset `oc-slam-paper`:

* boxes are carried over images in which the detector misses them, and then continue at a confidence below 0.80;
* only persons have boxes; the detector's input has the proportions of the image, which is not stretched to a square;
* epipolar lines are taken from the tracked pose and the image that saw a point first, and a depth history of ten
  seconds decides where they cannot: what lies in a box is dynamic until it is shown to be static
  (`dynamics/epipolar_sieve.py`);
* a cluster is judged by depth as well as by its matches, over more than one image; large planes never move
  (`dynamics/cluster_sieve.py`);
* every cluster in a box is left out of the dense map, whether it moved or not, and free space is carved from it;
* loops are closed, the map is optimised a last time at the end, and between keyframes most images are tracked by
  optical flow (`tracking/flow_tracking.py`); `--set tracking.between_keyframes=orb` is ORB-SLAM2's way.

Boxes without clusters are `--set clusters.kind=nothing`.
"""

from stillroom.config import SlamConfig
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.presets.method import Method
from stillroom.semantics.depth_clusters import DepthClustersConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.tracking.tracker import TrackerConfig

LONGER_SIDE = 1.0
"""Of the detector's input, as a share of its file's: 320 × 256 pixels for images of 4:3 (benchmarks/README.md)."""

METHOD = Method(
    name="oc-slam",
    summary="YOLO-Fastest boxes and depth clusters; off its epipolar line, or in former free space: rejected",
    config=SlamConfig(
        method="oc-slam",
        semantics=YoloFastestConfig(longer_side=LONGER_SIDE),
        clusters=DepthClustersConfig(),
        dynamics=ClusterSieveConfig(),
        tracking=TrackerConfig(between_keyframes="flow"),
        dense=DenseMapperConfig(),
    ),
    paper="Wu, Deng, Li and Li, Frontiers in Energy Research 9:803631, 2021",
)
