"""DynaSLAM N+G: a network's masks, and multi-view geometry for what no class names.

Differs from the paper: the masks are the PSPNet's of `pspnet-slam`, by class and not by instance. Mask R-CNN takes
seconds an image on a CPU; it, or any network in an ONNX file, can be set instead (`semantics.kind = "onnx-instances"`,
`"onnx-masks"`; docs/add-a-segmenter.md has a recipe). The network sees every second image; flow and depth carry its
masks to the others. The thresholds of the geometry are our own; the
paper's and its code's are `--set dynamics.kind=multiview-paper` and `multiview-code`. Between keyframes most images
are tracked by optical flow, as in `oc-slam`. What moves is inpainted by `stillroom inpaint --method dynaslam`.
"""

from stillroom.config import SlamConfig
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dynamics.masked_keypoints import MaskedKeypointsConfig
from stillroom.dynamics.multiview.multiview_sieve import MultiViewConfig
from stillroom.presets.method import Method
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom.semantics.masks.regions import RegionsConfig
from stillroom.tracking.low_cost import LowCostConfig
from stillroom.tracking.tracker import TrackerConfig

DILATE_PX = 15
"""How far DynaSLAM dilates a mask (docs/reference.md#dynaslam: an ellipse of 31 pixels)."""

PAPER = "Bescos, Fácil, Civera and Neira, IEEE Robotics and Automation Letters 3(4), 2018"

METHOD = Method(
    name="dynaslam",
    summary="a network's masks, and multi-view geometry with region growing for other dynamic objects",
    config=SlamConfig(
        method="dynaslam",
        semantics=PspNetConfig(input="320x240", every=2, regions=RegionsConfig(dilate_px=DILATE_PX)),
        keypoints=MaskedKeypointsConfig(),
        low_cost=LowCostConfig(),
        dynamics=MultiViewConfig(),
        tracking=TrackerConfig(between_keyframes="flow"),
        dense=DenseMapperConfig(),
    ),
    paper=PAPER,
)
