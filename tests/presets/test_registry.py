"""Methods by name, and the config that a user asks for."""

import tomllib
from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from stillroom import plugins
from stillroom.config import SlamConfig, to_toml, updated
from stillroom.config.kinds import DYNAMICS, ChainConfig
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.dynamics.chain import KeepAllConfig, KeepAllKeypointsConfig
from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.masked_keypoints import MaskedKeypointsConfig
from stillroom.dynamics.moving_consistency import MovingConsistencyConfig
from stillroom.dynamics.moving_objects import MovingObjectsConfig
from stillroom.dynamics.moving_probability import MovingProbabilityConfig
from stillroom.dynamics.multiview.multiview_sieve import MultiViewConfig
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.dynamics.projected.paper_ants import PaperAntsConfig
from stillroom.dynamics.segment_sieve import MovedSegmentsConfig
from stillroom.dynamics.semantic_flow import SemanticFlowConfig
from stillroom.errors import ConfigError
from stillroom.presets import registry
from stillroom.presets.method import Method
from stillroom.presets.registry import all_methods, configure, method
from stillroom.semantics.depth_clusters import DepthClustersConfig, NoClustersConfig
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.tracking.low_cost import LowCostConfig, NoLowCostConfig

GUEST = Method("guest", "from another package", SlamConfig(method="guest", seed=9))
NO_METHOD = 3
IMPOSTOR = Method("oc-slam", "takes a name that is taken", SlamConfig(method="oc-slam"))


def install(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    entry = EntryPoint("mine", f"{__name__}:{name}", registry.PLUGINS.group)
    monkeypatch.setattr(EntryPoint, "load", lambda self: globals()[self.attr])
    monkeypatch.setattr(plugins, "_installed", lambda search_path: EntryPoints([entry]))


BY_FLOW = replace(SlamConfig().tracking, between_keyframes="flow")


def test_the_presets_are_rows_of_the_table() -> None:
    orb_slam2, oc_slam = method("orb-slam2").config, method("oc-slam").config
    assert classes(orb_slam2, "semantics", "dynamics", "clusters") == [NothingConfig, KeepAllConfig, NoClustersConfig]
    assert classes(oc_slam, "semantics", "dynamics", "clusters") == [
        YoloFastestConfig,
        ClusterSieveConfig,
        DepthClustersConfig,
    ]
    assert isinstance(oc_slam.semantics, YoloFastestConfig)
    assert oc_slam.semantics.confidence == 0.80  # OC-SLAM 2.1
    # All else is ORB-SLAM2's.
    assert classes(orb_slam2, "dense") + classes(oc_slam, "dense") == [NoDenseMapConfig, DenseMapperConfig]
    assert oc_slam.tracking == BY_FLOW
    rest = {part: getattr(orb_slam2, part) for part in ("semantics", "clusters", "dynamics", "dense", "tracking")}
    assert replace(oc_slam, method="orb-slam2", **rest) == orb_slam2


def classes(config: SlamConfig, *parts: str) -> list[type]:
    return [type(getattr(config, part)) for part in parts]


def rest_of(config: SlamConfig, *own: str) -> SlamConfig:
    """Return a config with what is a preset's own replaced by ORB-SLAM2's."""
    plain = SlamConfig()
    return replace(config, method=plain.method, **{part: getattr(plain, part) for part in own})


MASKED = ("semantics", "keypoints", "low_cost", "dynamics", "dense", "tracking")


def test_pspnet_slam_is_masks_a_homography_and_segments_that_move() -> None:
    config = method("pspnet-slam").config
    assert classes(config, "semantics", "keypoints", "low_cost") == [
        PspNetConfig,
        MaskedKeypointsConfig,
        LowCostConfig,
    ]
    assert isinstance(config.dynamics, ChainConfig)
    assert isinstance(config.dynamics.first, CompensatedHomographyConfig)
    assert isinstance(config.dynamics.second, MovedSegmentsConfig)
    assert isinstance(config.clusters, DepthClustersConfig)
    assert config.clusters.leave_out_masked, "what is masked is the network's to find"
    assert config.dense == method("oc-slam").config.dense
    assert config.tracking == BY_FLOW
    assert rest_of(config, *MASKED, "clusters") == SlamConfig()


def test_pspnet_slam_paper_is_what_is_printed() -> None:
    config = method("pspnet-slam-paper").config
    assert classes(config, "semantics", "keypoints", "low_cost", "dynamics", "clusters", "dense") == [
        PspNetConfig,
        MaskedKeypointsConfig,
        LowCostConfig,
        PaperAntsConfig,
        NoClustersConfig,
        NoDenseMapConfig,
    ]
    semantics = config.semantics
    assert isinstance(semantics, PspNetConfig)
    assert (semantics.input, semantics.sees, semantics.model) == ("640x480", "keyframes", None)
    animals = {"bird", "cat", "cow", "dog", "horse", "sheep"}
    vehicles = {"aeroplane", "bicycle", "boat", "bus", "car", "motorbike", "train"}
    assert set(semantics.movable) == {"person"} | animals | vehicles
    assert len(semantics.movable) == 14
    assert config.dynamics == PaperAntsConfig()
    assert config.tracking == SlamConfig().tracking, "ORB in every frame"
    assert (config.mapping.max_final_keyframes, config.mapping.max_final_keyframes_looped) == (0, 0)
    assert not config.joining.enabled
    assert config.loops == SlamConfig().loops
    own = ("semantics", "keypoints", "low_cost", "dynamics", "mapping", "joining")
    assert rest_of(config, *own) == SlamConfig()


def test_dynaslam_is_masks_and_multi_view_geometry_and_each_alone() -> None:
    both, network, geometry = (method(name).config for name in ("dynaslam", "dynaslam-n", "dynaslam-g"))
    assert classes(both, "semantics", "dynamics", "low_cost") == [PspNetConfig, MultiViewConfig, LowCostConfig]
    assert both.semantics.regions.dilate_px == 15  # type: ignore[attr-defined] # docs/reference.md#dynaslam
    assert (network.semantics, network.keypoints) == (both.semantics, both.keypoints)
    assert classes(network, "low_cost") == [NoLowCostConfig]
    assert classes(geometry, "semantics", "keypoints") == [NothingConfig, KeepAllKeypointsConfig]
    assert geometry.low_cost == both.low_cost
    assert isinstance(both.dynamics, MultiViewConfig)
    assert network.dynamics == replace(both.dynamics, geometry=False)
    assert geometry.dynamics == replace(both.dynamics, network=False)
    for config in (both, network, geometry):
        assert config.tracking == BY_FLOW
        assert rest_of(config, *MASKED) == SlamConfig()


@pytest.mark.parametrize("kind", ["multiview", "multiview-paper", "multiview-code"])
def test_the_ants_can_be_chosen_wherever_the_multi_view_test_is_used(kind: str) -> None:
    chosen = [f"dynamics.kind={kind}", "dynamics.search=reverse-ants"]
    config, plain = configure("dynaslam", None, chosen), configure("dynaslam", None, chosen[:1])
    assert isinstance(plain.dynamics, MultiViewConfig)
    assert config.dynamics == replace(plain.dynamics, search="reverse-ants")
    with pytest.raises(ConfigError, match="must be one of all, reverse-ants"):
        configure("dynaslam", None, [chosen[0], "dynamics.search=some"])


def test_the_summaries_say_who_runs_the_colony() -> None:
    assert "serpentine" in method("pspnet-slam").summary
    assert "ants' path" in method("pspnet-slam-paper").summary


@pytest.mark.parametrize("kind", ["multiview-paper", "multiview-code"])
def test_the_numbers_of_dynaslams_paper_and_code_can_be_chosen(kind: str) -> None:
    config = configure("dynaslam", None, [f"dynamics.kind={kind}"])
    assert type(config.dynamics) is DYNAMICS.classes[kind]
    preset = method("dynaslam").config
    assert replace(config, dynamics=preset.dynamics) == preset


def test_the_sieves_of_a_chain_are_sockets_of_their_own() -> None:
    config = configure("pspnet-slam", None, ["dynamics.second.kind=keep-all", "dynamics.first.search=exhaustive"])
    preset = method("pspnet-slam").config.dynamics
    assert isinstance(preset, ChainConfig)
    assert isinstance(preset.first, CompensatedHomographyConfig)
    assert config.dynamics == ChainConfig(replace(preset.first, search="exhaustive"), KeepAllConfig())
    again = updated(SlamConfig(), tomllib.loads(to_toml(config)))
    assert again == config
    with pytest.raises(ConfigError, match=r"dynamics.second.kind is 'chains'.*did you mean"):
        configure("pspnet-slam", None, ["dynamics.second.kind=chains"])


def test_the_systems_of_pspnet_slams_table_have_the_numbers_of_their_papers() -> None:
    ds_slam, sof_slam, zhang_slam = (method(name).config for name in ("ds-slam", "sof-slam", "zhang-slam"))
    check = ds_slam.dynamics  # docs/reference.md#ds-slam
    assert isinstance(check, MovingConsistencyConfig)
    assert (check.corners, check.quality, check.apart_px, check.window_px, check.levels) == (1000, 0.01, 8, 22, 5)
    assert (check.edge_px, check.max_difference, check.inlier_px, check.line_px) == (5, 2120, 0.1, 1)
    assert isinstance(sof_slam.dynamics, SemanticFlowConfig)
    assert (sof_slam.dynamics.line_px, sof_slam.dynamics.judged) == (1, "every")  # docs/reference.md#sof-slam
    assert classes(zhang_slam, "semantics", "dynamics") == [YoloFastestConfig, MovingObjectsConfig]
    assert [config.semantics.every for config in (ds_slam, sof_slam)] == [1, 1]  # type: ignore[attr-defined]
    detect_slam = method("detect-slam").config  # docs/reference.md#detect-slam
    assert isinstance(detect_slam.semantics, YoloFastestConfig)
    assert detect_slam.semantics.sees == "keyframes"
    assert {"person", "dog", "car"} < set(detect_slam.semantics.movable)
    assert isinstance(detect_slam.dynamics, MovingProbabilityConfig)
    assert detect_slam.dynamics.gain == 0.3
    # All else is ORB-SLAM2's, keypoints for every image included; L. Zhang et al. and DS-SLAM have a dense map.
    for config in (ds_slam, detect_slam, sof_slam, zhang_slam):
        assert rest_of(config, "semantics", "dynamics", "dense") == SlamConfig()
    assert classes(detect_slam, "dense") + classes(sof_slam, "dense") == [NoDenseMapConfig, NoDenseMapConfig]


def test_a_preset_is_a_short_file() -> None:
    for file in (Path(registry.__file__).parent).glob("*.py"):
        if file.stem not in {"registry", "method", "__init__"}:
            assert file.read_text(encoding="utf-8").count("\n") <= 60


def test_an_installed_package_adds_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "GUEST")
    assert list(all_methods()) == [*(own.name for own in registry.OWN), "guest"]
    assert configure("guest").seed == 9


def test_a_wrong_entry_point_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "NO_METHOD")
    with pytest.raises(ConfigError, match=r"entry point 'mine'.*is a int; it must be a Method"):
        all_methods()
    install(monkeypatch, "IMPOSTOR")
    with pytest.raises(ConfigError, match="a method 'oc-slam' already"):
        all_methods()


def test_an_unknown_method_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"'ocslam'; did you mean 'oc-slam'\? known: orb-slam2, stillroom, oc-slam"):
        method("ocslam")


def test_preset_then_file_then_overrides_then_seed(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('seed = 3\n[tracking]\nmin_inliers = 40\nmin_matches = 41\n[dynamics]\nkind = "paper-epipolar"\n')
    config = configure("oc-slam", file, ["tracking.min_inliers=50"], seed=7)
    assert config.method == "oc-slam"
    assert (config.tracking.min_inliers, config.tracking.min_matches, config.seed) == (50, 41, 7)
    assert config.dynamics == PaperEpipolarConfig()
    assert config.semantics == method("oc-slam").config.semantics
    assert configure("oc-slam", file).seed == 3


def test_the_default_method_and_the_file_s(tmp_path: Path) -> None:
    assert configure().method == "stillroom"
    file = tmp_path / "config.toml"
    whole = replace(method("orb-slam2").config, seed=11)
    file.write_text(to_toml(whole), encoding="utf-8")
    assert configure(None, file) == whole
    assert configure("orb-slam2", file) == whole
    with pytest.raises(ConfigError, match="is of the method 'orb-slam2', but 'oc-slam' is asked for"):
        configure("oc-slam", file)


def test_the_method_is_no_value_and_the_seed_not_negative() -> None:
    with pytest.raises(ConfigError, match="choose it with --method"):
        configure("oc-slam", None, ["method=orb-slam2"])
    with pytest.raises(ConfigError, match="seed is -1"):
        configure("oc-slam", seed=-1)
