"""SOF-SLAM: the mask chooses the points that give F; what is off its epipolar line is dynamic, whatever its label.

Differs from the paper: the labels are the PSPNet's of `pspnet-slam`, in place of SegNet's. Of the classes people are
called dynamic and chairs potentially dynamic, the two that are named in what is known of the paper; tables, sofas and
screens stay. Flow, RANSAC and what is done without a matrix are not given (`dynamics/semantic_flow.py`).
"""

from stillroom.config import SlamConfig
from stillroom.dynamics.semantic_flow import SemanticFlowConfig
from stillroom.presets.method import Method
from stillroom.semantics.masks.pspnet import PspNetConfig

METHOD = Method(
    name="sof-slam",
    summary="PSPNet labels choose the points that give F; what is off its epipolar line is dynamic",
    config=SlamConfig(
        method="sof-slam",
        semantics=PspNetConfig(input="320x240", named=("chair",)),
        dynamics=SemanticFlowConfig(),
    ),
    paper="Cui and Ma, IEEE Access 7, 2019",
)
