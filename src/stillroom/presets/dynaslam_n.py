"""DynaSLAM N: the network alone; what it masks is dynamic, all else is static."""

from dataclasses import replace

from stillroom.dynamics.multiview.multiview_sieve import MultiViewConfig
from stillroom.presets import dynaslam
from stillroom.presets.method import Method
from stillroom.tracking.low_cost import NoLowCostConfig

METHOD = Method(
    name="dynaslam-n",
    summary="DynaSLAM's network alone",
    config=replace(
        dynaslam.METHOD.config,
        method="dynaslam-n",
        low_cost=NoLowCostConfig(),
        dynamics=MultiViewConfig(geometry=False),
    ),
    paper=dynaslam.PAPER,
)
