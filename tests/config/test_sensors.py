"""What of a method works with a sensor, and the table of it in the docs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pytest

from stillroom.config.kinds import ChainConfig
from stillroom.config.sensors import fit_to_sensor, has_depth_image
from stillroom.config.tree import SlamConfig
from stillroom.data.sensor import Sensor
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.dynamics.chain import KeepAllConfig
from stillroom.dynamics.homography.homography_sieve import CompensatedHomographyConfig
from stillroom.dynamics.paper_epipolar import PaperEpipolarConfig
from stillroom.dynamics.whole_boxes import WholeBoxesConfig
from stillroom.errors import ConfigError
from stillroom.presets.method import Method
from stillroom.presets.registry import OWN, configure, works_with
from stillroom.semantics.depth_clusters import NoClustersConfig
from stillroom.storage.keeper import MapKeeperConfig

PAGE = Path(__file__).parents[2] / "docs" / "sensors.md"
REFUSED = {"dynaslam-g"}
SENSORS = [(Sensor.STEREO, False), (Sensor.STEREO, True), (Sensor.MONOCULAR, False)]


@pytest.mark.parametrize("preset", OWN, ids=lambda preset: preset.name)
def test_the_table_of_the_docs_is_what_the_function_gives(preset: Method) -> None:
    cells = [works_with(preset, sensor, dense) for sensor, dense in SENSORS]
    assert f"| `{preset.name}` | {' | '.join(cells)} |\n" in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("preset", OWN, ids=lambda preset: preset.name)
def test_with_rgbd_every_preset_is_the_same_object(preset: Method) -> None:
    config, left_out = fit_to_sensor(preset.config, Sensor.RGBD)
    assert config is preset.config
    assert left_out == ()


@pytest.mark.parametrize(
    "preset", [preset for preset in OWN if preset.name not in REFUSED], ids=lambda preset: preset.name
)
@pytest.mark.parametrize("sensor", [Sensor.STEREO, Sensor.MONOCULAR])
def test_what_is_left_needs_no_depth_image(preset: Method, sensor: Sensor) -> None:
    config, left_out = fit_to_sensor(preset.config, sensor)
    parts = [config.clusters, config.dense, config.dynamics, config.semantics, config.keypoints, config.low_cost]
    if isinstance(config.dynamics, ChainConfig):
        parts += [config.dynamics.first, config.dynamics.second]
    assert not any(getattr(part, "needs_depth_image", False) for part in parts)
    assert config.tracking.between_keyframes == "orb"
    assert fit_to_sensor(config, sensor) == (config, ()), "fitting twice changes nothing more"
    assert (config == preset.config) == (left_out == ())
    assert config.semantics == preset.config.semantics, "masks and boxes stay"


@pytest.mark.parametrize(
    ("name", "sieve"),
    [("oc-slam", WholeBoxesConfig), ("stillroom", WholeBoxesConfig), ("oc-slam-paper", PaperEpipolarConfig)],
)
def test_the_nearest_sieve_takes_the_place(name: str, sieve: type) -> None:
    config, left_out = fit_to_sensor(configure(name), Sensor.STEREO)
    assert isinstance(config.dynamics, sieve)
    assert isinstance(config.clusters, NoClustersConfig)
    assert isinstance(config.dense, NoDenseMapConfig)
    assert any("depth history" in text or "moving clusters" in text for text in left_out)


def test_of_a_chain_the_half_that_works_stays() -> None:
    config, left_out = fit_to_sensor(configure("pspnet-slam"), Sensor.STEREO)
    assert isinstance(config.dynamics, ChainConfig)
    assert isinstance(config.dynamics.first, CompensatedHomographyConfig)
    assert isinstance(config.dynamics.second, KeepAllConfig)
    assert "segments that move" in left_out


def test_without_keypoints_with_depth_masks_alone_decide() -> None:
    """The compensated homography finds no motion of the camera in space then, and would do nothing without a word."""
    config, left_out = fit_to_sensor(configure("pspnet-slam"), Sensor.MONOCULAR)
    assert isinstance(config.dynamics, ChainConfig)
    assert isinstance(config.dynamics.first, WholeBoxesConfig)
    assert any("the compensated homography" in text for text in left_out)
    assert not any("the compensated homography" in text for text in fit_to_sensor(config, Sensor.STEREO)[1])


@pytest.mark.parametrize("sensor", [Sensor.STEREO, Sensor.MONOCULAR])
def test_masks_that_alone_decide_are_those_that_are_exported(sensor: Sensor) -> None:
    config, _ = fit_to_sensor(configure("pspnet-slam-paper"), sensor)
    assert isinstance(config.dynamics, WholeBoxesConfig), "a sieve that keeps all says that no pixel moves"


def test_a_depth_image_of_the_pair_keeps_all() -> None:
    config = configure("oc-slam", overrides=["stereo.dense=sgbm"])
    assert has_depth_image(config, Sensor.STEREO)
    assert fit_to_sensor(config, Sensor.STEREO) == (config, ())
    assert not has_depth_image(config, Sensor.MONOCULAR)
    _, left_out = fit_to_sensor(config, Sensor.MONOCULAR)
    assert "the dense map" in left_out


@pytest.mark.parametrize("sensor", [Sensor.STEREO, Sensor.MONOCULAR])
def test_a_method_of_which_nothing_is_left_is_refused(sensor: Sensor) -> None:
    with pytest.raises(
        ConfigError, match=r"dynaslam-g: finds what moves in depth images alone, and a .* has no depth"
    ) as raised:
        fit_to_sensor(configure("dynaslam-g"), sensor)
    assert "\n" not in str(raised.value)
    assert ("stereo.dense=sgbm" in str(raised.value)) == (sensor is Sensor.STEREO)


def test_the_kinect_s_noise_and_metres_are_left_out() -> None:
    stereo, said = fit_to_sensor(configure("stillroom"), Sensor.STEREO)
    assert stereo.tracking.depth.right_sigma == 1.0
    assert stereo.mapping.bundle.right_sigma == stereo.mapping.looped_bundle.right_sigma == 1.0
    assert stereo.loops.bundle.right_sigma == 1.0
    assert stereo.trajectory.enabled
    assert any("structured light" in text for text in said)
    mono, said = fit_to_sensor(configure("stillroom"), Sensor.MONOCULAR)
    assert not mono.trajectory.enabled
    assert any("in metres" in text for text in said)


@dataclass(frozen=True)
class NeedyConfig:
    """A sieve of somebody else's that reads depth images."""

    needs_depth_image: ClassVar[bool] = True

    def build(self, parts: object) -> None:
        raise AssertionError("never built")


def test_a_part_from_outside_says_what_it_needs() -> None:
    masked = configure("pspnet-slam-paper")
    config, left_out = fit_to_sensor(replace(masked, dynamics=NeedyConfig()), Sensor.MONOCULAR)  # type: ignore[arg-type]
    assert isinstance(config.dynamics, KeepAllConfig)
    assert "the sieve NeedyConfig" in left_out
    alone = SlamConfig(dynamics=NeedyConfig())  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="finds what moves in depth images alone"):
        fit_to_sensor(alone, Sensor.MONOCULAR)


def test_pictures_of_keyframes_need_depth() -> None:
    asked = replace(configure("orb-slam2"), storage=MapKeeperConfig(images=True))
    config, left_out = fit_to_sensor(asked, Sensor.MONOCULAR)
    assert not config.storage.images
    assert left_out == ("images of keyframes in the map file",)
