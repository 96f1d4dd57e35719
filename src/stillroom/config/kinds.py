"""The parts that a socket (interface) of the configuration can hold, by name.

A part of your own needs no entry here: `kind = "my_package.my_module:MyConfig"` finds its config class by import, and
an entry point of the groups `stillroom.segmenters` and `stillroom.sieves` (match sieves) gives it a name of its own.
"""

import dataclasses
import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib.metadata import EntryPoint
from typing import Any, Protocol

from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.dense.octomap import OctoMapConfig
from stillroom.dynamics.chain import Chain, KeepAllConfig, KeepAllKeypointsConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.dynamics.epipolar_sieve import EpipolarConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.masked_keypoints import MaskedKeypointsConfig
from stillroom.dynamics.moving_consistency import MovingConsistencyConfig
from stillroom.dynamics.moving_objects import MovingObjectsConfig
from stillroom.dynamics.moving_probability import MovingProbabilityConfig
from stillroom.dynamics.multiview.multiview_sieve import CodeMultiViewConfig, MultiViewConfig, PaperMultiViewConfig
from stillroom.dynamics.paper_clusters import PaperClustersConfig
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig
from stillroom.dynamics.segment_sieve import MovedSegmentsConfig
from stillroom.dynamics.semantic_flow import SemanticFlowConfig
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.errors import ConfigError
from stillroom.plugins import PluginGroup
from stillroom.protocols import Clusterer, DenseMapping, KeypointSieve, MatchSieve, Parts, QuickTracking, Segmenter
from stillroom.semantics.depth_clusters import DepthClustersConfig, NoClustersConfig
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.semantics.masks.onnx_instances import OnnxInstancesConfig
from stillroom.semantics.masks.onnx_masks import OnnxMasksConfig
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.semantics.onnx.onnx_boxes import OnnxBoxesConfig
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.tracking.low_cost import LowCostConfig, NoLowCostConfig

KIND = "kind"
"""The key of a section that chooses the part."""
MUST_BE = "a dataclass with a build method"
SINGLE_SIEVES: Mapping[str, type[Any]] = {
    "keep-all": KeepAllConfig,
    "whole-boxes": WholeBoxesConfig,
    "paper-epipolar": PaperEpipolarConfig,
    "paper-clusters": PaperClustersConfig,
    "epipolar": EpipolarConfig,
    "clusters": ClusterSieveConfig,
    "multiview": MultiViewConfig,
    "multiview-paper": PaperMultiViewConfig,
    "multiview-code": CodeMultiViewConfig,
    "compensated-homography": CompensatedHomographyConfig,
    "paper-ants": PaperAntsConfig,
    "moved-segments": MovedSegmentsConfig,
    "moving-consistency": MovingConsistencyConfig,
    "moving-probability": MovingProbabilityConfig,
    "semantic-flow": SemanticFlowConfig,
    "moving-objects": MovingObjectsConfig,
}


class SegmenterConfig(Protocol):
    """The config of a segmenter, which finds what is potentially dynamic; a frozen dataclass."""

    def build(self, parts: Parts) -> Segmenter:
        """Return the segmenter."""


class ClustererConfig(Protocol):
    """The config of a part that clusters the depth cloud of an image; a frozen dataclass."""

    def build(self, parts: Parts) -> Clusterer:
        """Return the clusterer; the seed initialises its random generator."""


class KeypointSieveConfig(Protocol):
    """The config of a keypoint sieve, which chooses the keypoints for tracking; a frozen dataclass."""

    def build(self, parts: Parts) -> KeypointSieve:
        """Return the sieve; the seed initialises its random generator."""


class DenseMappingConfig(Protocol):
    """The config of a part that makes a dense map; a frozen dataclass."""

    def build(self, parts: Parts) -> DenseMapping:
        """Return the dense map of the map's keyframes; the clock may time its stages."""


class MatchSieveConfig(Protocol):
    """The config of a match sieve, which finds what is dynamic; a frozen dataclass."""

    def build(self, parts: Parts) -> MatchSieve:
        """Return the sieve; the seed initialises its random generator."""


class QuickTrackingConfig(Protocol):
    """The config of a part that finds a quick pose before tracking proper; a frozen dataclass."""

    def build(self, parts: Parts, sieve: MatchSieve) -> QuickTracking:
        """Return the part; it calls the sieve with the pose that it finds."""


def _is_part(found: object) -> bool:
    return isinstance(found, type) and dataclasses.is_dataclass(found) and hasattr(found, "build")


SEGMENTERS: PluginGroup[type[Any]] = PluginGroup("stillroom.segmenters", "segmenter", MUST_BE, _is_part)
SIEVES: PluginGroup[type[Any]] = PluginGroup("stillroom.sieves", "match sieve", MUST_BE, _is_part)


@dataclass(frozen=True)
class Kinds:
    """The parts that fit one section.

    Attributes:
        section: Name of the section.
        classes: Config class by kind: Stillroom's own.
        group: Where installed packages add others; an entry point's name is the kind, its value the config class.
    """

    section: str
    classes: Mapping[str, type[Any]]
    group: PluginGroup[type[Any]] | None = None

    def names(self) -> list[str]:
        """Return all kinds, Stillroom's own first.

        Raises:
            ConfigError: An installed package takes a name that is taken.
        """
        return [*self.classes, *self._installed()]

    def find(self, kind: str) -> type[Any]:
        """Return the config class of a kind, or of `module:Class`.

        Raises:
            ConfigError: There is none, or an installed package offers an unusable object.
        """
        installed = self._installed()
        if kind in self.classes:
            return self.classes[kind]
        if kind in installed and self.group is not None:
            return self.group.load(installed[kind])
        if ":" in kind:
            return self._imported(kind)
        known = [*self.classes, *installed]
        guess = get_close_matches(kind, known, n=1, cutoff=0.0)[0]
        raise ConfigError(f"{self.section}.{KIND} is '{kind}'; did you mean '{guess}'? known: {', '.join(known)}")

    def name_of(self, config: object) -> str:
        """Return the kind of a config.

        Raises:
            ConfigError: An installed package takes a name that is taken, or one whose module is loaded offers an
                unusable object.
        """
        own = type(config)
        for kind, known in self.classes.items():
            if known is own:
                return kind
        if self.group is not None:
            for kind, entry in self._installed().items():
                # The class is there, so the module that offers it is loaded; no other is worth importing for this.
                if entry.module in sys.modules and self.group.load(entry) is own:
                    return kind
        return f"{own.__module__}:{own.__qualname__}"

    def _installed(self) -> dict[str, EntryPoint]:
        return {} if self.group is None else self.group.by_entry_name(self.classes)

    def _imported(self, kind: str) -> type[Any]:
        module, _, name = kind.partition(":")
        try:
            found = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ConfigError(f"{self.section}.{KIND} is '{kind}', which cannot be imported ({error})") from error
        if not _is_part(found):
            raise ConfigError(f"{self.section}.{KIND} is '{kind}'; it must be {MUST_BE}")
        part: type[Any] = found
        return part


SEMANTICS = Kinds(
    "semantics",
    {
        "nothing": NothingConfig,
        "yolo-fastest": YoloFastestConfig,
        "onnx-boxes": OnnxBoxesConfig,
        "onnx-masks": OnnxMasksConfig,
        "onnx-instances": OnnxInstancesConfig,
        "pspnet": PspNetConfig,
        "mask-files": MaskFilesConfig,
        "truth": TrueSemanticsConfig,
    },
    SEGMENTERS,
)

CLUSTERS = Kinds("clusters", {"nothing": NoClustersConfig, "depth": DepthClustersConfig})

KEYPOINTS = Kinds("keypoints", {"keep-all": KeepAllKeypointsConfig, "masked": MaskedKeypointsConfig})

LOW_COST = Kinds("low_cost", {"nothing": NoLowCostConfig, "projection": LowCostConfig})

DENSE = Kinds("dense", {"nothing": NoDenseMapConfig, "voxels": DenseMapperConfig, "octomap": OctoMapConfig})


@dataclass(frozen=True)
class ChainConfig:
    """Two sieves in one socket: what either of them finds dynamic is dynamic.

    Attributes:
        first: The first; `kind` chooses the part.
        second: The other one; with `kind = "keep-all"` it adds nothing.
    """

    first: MatchSieveConfig = field(
        default_factory=CompensatedHomographyConfig, metadata={"kinds": Kinds("dynamics.first", SINGLE_SIEVES, SIEVES)}
    )
    second: MatchSieveConfig = field(
        default_factory=MovedSegmentsConfig, metadata={"kinds": Kinds("dynamics.second", SINGLE_SIEVES, SIEVES)}
    )

    def build(self, parts: Parts) -> MatchSieve:
        """Return the chain."""
        return Chain([self.first.build(parts), self.second.build(parts)], parts.world)


DYNAMICS = Kinds("dynamics", {**SINGLE_SIEVES, "chain": ChainConfig}, SIEVES)
