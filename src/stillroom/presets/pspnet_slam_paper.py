"""PSPNet-SLAM as printed: masks of keyframes, one homography, DynaSLAM's test along the reverse ant colony's path.

ORB in every frame and low-cost tracking; no dense map, no merging of sub-maps, and no adjustment of the whole map at
the end, for the paper has none of these. What we made of the paper is `pspnet-slam`.

Differs from the paper:

- The network is the one that comes with Stillroom, PSPNet on MobileNetV2; the paper's on ResNet-50 is any file of
  `stillroom export pspnet --backbone resnet50`, set as `semantics.model`. Neither saw the paper's images in training.
- The paper does not say what masks become of between keyframes; flow and depth carry them, as in `pspnet-slam`.
- What the text leaves open of its geometry is said in `dynamics/projected/paper_ants.py`.
- It prints no values of R, ΔZ, the colony, and RANSAC's threshold; DynaSLAM's code gives those of the test that its
  paper does not (docs/reference.md#dynaslam).
"""

from stillroom.config import SlamConfig
from stillroom.dynamics.masked_keypoints import MaskedKeypointsConfig
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig
from stillroom.loops.joining import JoiningConfig
from stillroom.mapping.local_mapper import LocalMapperConfig
from stillroom.presets import pspnet_slam
from stillroom.presets.method import Method
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom.tracking.low_cost import LowCostConfig

MOVABLE = (
    "person", "aeroplane", "bicycle", "boat", "bus", "car", "motorbike", "train",
    "bird", "cat", "cow", "dog", "horse", "sheep",
)  # fmt: skip
"""People, vehicles and animals (III), of the classes of PASCAL VOC."""

METHOD = Method(
    name="pspnet-slam-paper",
    summary="as printed: masks of keyframes; features projected by a homography, DynaSLAM's test along the ants' path",
    config=SlamConfig(
        method="pspnet-slam-paper",
        semantics=PspNetConfig(input="640x480", sees="keyframes", movable=MOVABLE),
        keypoints=MaskedKeypointsConfig(),
        low_cost=LowCostConfig(),
        dynamics=PaperAntsConfig(),
        mapping=LocalMapperConfig(max_final_keyframes=0, max_final_keyframes_looped=0),
        joining=JoiningConfig(enabled=False),
    ),
    paper=pspnet_slam.METHOD.paper,
)
