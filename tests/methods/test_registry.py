"""Methods by name, and the config that a user asks for."""

from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from stillroom.config import SlamConfig, to_toml
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.nothing import NoDenseMapConfig
from stillroom.dynamics.clusters.sieve import ClusterSieveConfig
from stillroom.dynamics.keep_all import KeepAllConfig
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.errors import ConfigError
from stillroom.methods import registry
from stillroom.methods.method import Method
from stillroom.methods.registry import all_methods, configure, method
from stillroom.semantics.depth_clusters import DepthClustersConfig, NoClustersConfig
from stillroom.semantics.nothing import NothingConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig

GUEST = Method("guest", "from another package", SlamConfig(method="guest", seed=9))
NO_METHOD = 3
IMPOSTOR = Method("oc-slam", "takes a name that is taken", SlamConfig(method="oc-slam"))


def install(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    entry = EntryPoint("mine", f"{__name__}:{name}", registry.GROUP)
    monkeypatch.setattr(EntryPoint, "load", lambda self: globals()[self.attr])
    monkeypatch.setattr(registry, "entry_points", lambda group: EntryPoints([entry]).select(group=group))


def test_the_presets_are_rows_of_the_table() -> None:
    orb_slam2, oc_slam = method("orb-slam2").config, method("oc-slam").config
    assert (orb_slam2.semantics, orb_slam2.dynamics) == (NothingConfig(), KeepAllConfig())
    assert (oc_slam.semantics, oc_slam.dynamics) == (YoloFastestConfig(), ClusterSieveConfig())
    assert (orb_slam2.clusters, oc_slam.clusters) == (NoClustersConfig(), DepthClustersConfig())
    assert isinstance(oc_slam.semantics, YoloFastestConfig)
    assert oc_slam.semantics.confidence == 0.80  # OC-SLAM 2.1
    # All else is ORB-SLAM2's.
    assert (orb_slam2.dense, oc_slam.dense) == (NoDenseMapConfig(), DenseMapperConfig())
    rest = {part: getattr(orb_slam2, part) for part in ("semantics", "clusters", "dynamics", "dense")}
    assert replace(oc_slam, method="orb-slam2", **rest) == orb_slam2


def test_a_preset_is_a_short_file() -> None:
    for file in (Path(registry.__file__).parent).glob("*.py"):
        if file.stem not in {"registry", "method", "__init__"}:
            assert file.read_text(encoding="utf-8").count("\n") <= 60


def test_an_installed_package_adds_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "GUEST")
    assert list(all_methods()) == ["orb-slam2", "oc-slam", "guest"]
    assert configure("guest").seed == 9


def test_a_wrong_entry_point_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "NO_METHOD")
    with pytest.raises(ConfigError, match=r"entry point 'mine'.*is a int; it must be a Method"):
        all_methods()
    install(monkeypatch, "IMPOSTOR")
    with pytest.raises(ConfigError, match="a method 'oc-slam' already"):
        all_methods()


def test_an_unknown_method_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"'ocslam'; did you mean 'oc-slam'\? known: orb-slam2, oc-slam"):
        method("ocslam")


def test_preset_then_file_then_overrides_then_seed(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('seed = 3\n[tracking]\nmin_inliers = 40\nmin_matches = 41\n[dynamics]\nkind = "paper-epipolar"\n')
    config = configure("oc-slam", file, ["tracking.min_inliers=50"], seed=7)
    assert config.method == "oc-slam"
    assert (config.tracking.min_inliers, config.tracking.min_matches, config.seed) == (50, 41, 7)
    assert config.dynamics == PaperEpipolarConfig()
    assert config.semantics == YoloFastestConfig()
    assert configure("oc-slam", file).seed == 3


def test_the_default_method_and_the_file_s(tmp_path: Path) -> None:
    assert configure().method == "oc-slam"
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
