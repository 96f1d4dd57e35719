"""PSPNet-SLAM: a network's masks, an optimally compensated homography, and the reverse ant colony's search.

What we made of the paper; what it prints is `pspnet-slam-paper`.

Differs from the paper: a homography alone cannot explain a room with depth, so the camera's motion in space, which
depth gives, may explain a point as well (`dynamics/homography/homography_sieve.py`). The homography alone decides,
between neighbouring images, with `--set dynamics.first.test.use_depth=false --set dynamics.first.earlier_s=0 --set
dynamics.second.kind=keep-all`. What is not movable by its class is dynamic when its segment moves against the scene;
the paper says no more than that (`dynamics/segment_sieve.py`). The path is a serpentine, which goes through the same
nodes as the ants' and costs nothing; `--set dynamics.first.ants.path.kind=ants` is the colony's. The network sees every
second image; flow and depth carry its masks to the others (the paper's sees keyframes only). Between keyframes most
images are tracked by optical flow, as in `oc-slam`.
"""

from stillroom.config import SlamConfig
from stillroom.config.kinds import ChainConfig
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.masked_keypoints import MaskedKeypointsConfig
from stillroom.dynamics.segment_sieve import MovedSegmentsConfig
from stillroom.presets.method import Method
from stillroom.semantics.depth_clusters import DepthClustersConfig
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom.tracking.low_cost import LowCostConfig
from stillroom.tracking.tracker import TrackerConfig

METHOD = Method(
    name="pspnet-slam",
    summary="PSPNet's masks; what a compensated homography does not explain, along a serpentine; segments that move",
    config=SlamConfig(
        method="pspnet-slam",
        semantics=PspNetConfig(input="320x240", every=2, named=("chair", "tvmonitor", "bottle")),
        clusters=DepthClustersConfig(leave_out_masked=True),
        keypoints=MaskedKeypointsConfig(),
        low_cost=LowCostConfig(),
        dynamics=ChainConfig(CompensatedHomographyConfig(), MovedSegmentsConfig()),
        tracking=TrackerConfig(between_keyframes="flow"),
        dense=DenseMapperConfig(),
    ),
    paper="Long, Zhang and Zhao, IEEE Access 8, 2020",
)
