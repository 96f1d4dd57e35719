"""DynaSLAM's own numbers: the paper's, and those of its code (docs/reference.md#dynaslam)."""

from dataclasses import dataclass, field, replace

from stillroom.bounds import bounded
from stillroom.dynamics.multiview.geometry import GeometryConfig
from stillroom.dynamics.multiview.sieve import COMBINATIONS, GEOMETRY_FIRST, UNION, MultiViewConfig
from stillroom.dynamics.multiview.views import FARTHEST, NEAREST, KeyframesConfig

_VARIANCE_M2 = 0.001
_DIFFERENT_M = 0.2


def _paper() -> GeometryConfig:
    return GeometryConfig(
        keyframes=KeyframesConfig(least=5, choice=NEAREST, grid_px=0, apart_s=0.0),
        tau_m=0.4,
        tau_per_m=0.0,
        window_px=20,
        patch_px=20,
        patch_std_m=_VARIANCE_M2**0.5,
        patch_std_per_m=0.0,
        seen_through=False,
        growing_stride=1,
        mean_m=_DIFFERENT_M,
        mean_per_m=0.0,
        step_m=100.0,
        step_per_m=0.0,
        min_area_px=0,
    )


def _code() -> GeometryConfig:
    paper = _paper()
    keyframes = replace(paper.keyframes, choice=FARTHEST)
    return replace(paper, keyframes=keyframes, parallax_of_translations=True, tau_m=0.6)


@dataclass(frozen=True)
class PaperMultiViewConfig(MultiViewConfig):
    """The paper's numbers: the five keyframes nearest by distance and rotation, 30°, 0.4 m.

    Where the paper gives none (variance, region growing, dilation), its code's.
    """

    combination: str = bounded(GEOMETRY_FIRST, one_of=COMBINATIONS)
    dilation_px: int = bounded(15, least=0)
    test: GeometryConfig = field(default_factory=_paper)


@dataclass(frozen=True)
class CodeMultiViewConfig(MultiViewConfig):
    """The code's numbers: the five farthest of the last twenty keyframes, 30° from translations, 0.6 m, union."""

    combination: str = bounded(UNION, one_of=COMBINATIONS)
    dilation_px: int = bounded(15, least=0)
    test: GeometryConfig = field(default_factory=_code)
