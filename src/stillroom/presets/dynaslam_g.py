"""DynaSLAM G: multi-view geometry alone, without a network."""

from dataclasses import replace

from stillroom.dynamics.chain import KeepAllKeypointsConfig
from stillroom.dynamics.multiview.multiview_sieve import MultiViewConfig
from stillroom.presets import dynaslam
from stillroom.presets.method import Method
from stillroom.semantics.no_segmenter import NothingConfig

METHOD = Method(
    name="dynaslam-g",
    summary="DynaSLAM's multi-view geometry alone",
    config=replace(
        dynaslam.METHOD.config,
        method="dynaslam-g",
        semantics=NothingConfig(),
        keypoints=KeepAllKeypointsConfig(),
        dynamics=MultiViewConfig(network=False),
    ),
    paper=dynaslam.PAPER,
)
