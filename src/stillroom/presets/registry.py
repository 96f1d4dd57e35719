"""All methods by name: Stillroom's own, and those that installed packages add.

A package adds a method by an entry point of the group `stillroom.methods` that names a `Method`::

    [project.entry-points."stillroom.methods"]
    my-slam = "my_package.my_slam:METHOD"
"""

from collections.abc import Iterable
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

from stillroom.bounds import check
from stillroom.config import SlamConfig, read_toml, updated, with_overrides
from stillroom.config.sensors import fit_to_sensor
from stillroom.data.sensor import Sensor
from stillroom.errors import ConfigError
from stillroom.plugins import PluginGroup
from stillroom.presets import (
    detect_slam,
    ds_slam,
    dynaslam,
    dynaslam_g,
    dynaslam_n,
    oc_slam,
    oc_slam_paper,
    orb_slam2,
    pspnet_slam,
    pspnet_slam_paper,
    sof_slam,
    stillroom,
    zhang_slam,
)
from stillroom.presets.method import Method

__all__ = ["DEFAULT", "OWN", "Method", "all_methods", "configure", "method", "works_with"]

PLUGINS: PluginGroup[Method] = PluginGroup(
    "stillroom.methods", "method", "a Method", lambda offered: isinstance(offered, Method)
)
OWN = (
    orb_slam2.METHOD,
    stillroom.METHOD,
    oc_slam.METHOD,
    oc_slam_paper.METHOD,
    pspnet_slam.METHOD,
    pspnet_slam_paper.METHOD,
    dynaslam.METHOD,
    dynaslam_n.METHOD,
    dynaslam_g.METHOD,
    ds_slam.METHOD,
    detect_slam.METHOD,
    sof_slam.METHOD,
    zhang_slam.METHOD,
)
DEFAULT = oc_slam.METHOD.name


def all_methods() -> dict[str, Method]:
    """Return every method by name, Stillroom's own first.

    Raises:
        ConfigError: What an installed package offers cannot be imported, is no method, or has a name that is taken.
    """
    return PLUGINS.all_with(OWN, lambda one: one.name)


def method(name: str) -> Method:
    """Return a method.

    Raises:
        ConfigError: There is none of this name.
    """
    known = all_methods()
    if name not in known:
        guess = get_close_matches(name.lower(), known, n=1, cutoff=0.0)[0]
        raise ConfigError(f"no method is called '{name}'; did you mean '{guess}'? known: {', '.join(known)}")
    return known[name]


def configure(
    name: str | None = None,
    file: Path | None = None,
    overrides: Iterable[str] = (),
    seed: int | None = None,
) -> SlamConfig:
    """Return the config that a user asks for: the preset, then the file, then single values, then the seed.

    Args:
        name: The method; where not given, the file's, else the default.
        file: A config file, whole or in part.
        overrides: `section.key=value`.
        seed: Seed of all random choices.

    Raises:
        ConfigError: A method, a key or a value is wrong, or the file is of another method than `name`.
    """
    values = {} if file is None else read_toml(file)
    named = values.get("method", name)
    if name is not None and named != name:
        raise ConfigError(f"{file}: is of the method '{named}', but '{name}' is asked for; leave one of them out")
    preset = method(DEFAULT if named is None else str(named))
    config = with_overrides(updated(preset.config, values, str(file)), overrides)
    if config.method != preset.name:
        raise ConfigError(f"method cannot be set to '{config.method}' by --set; choose it with --method")
    if seed is not None:
        config = replace(config, seed=seed)
    if config.seed < 0:
        raise ConfigError(f"seed is {config.seed}; it must be 0 or more")
    check(config)
    return config


def works_with(preset: Method, sensor: Sensor, dense: bool = False) -> str:
    """Return in words what of a preset works with a sensor, as the table of docs/sensors.md has it.

    Args:
        preset: The method.
        sensor: What kind of camera takes the images.
        dense: Whether a depth image is made of pairs (`stereo.dense`).

    Returns:
        "whole", "refused: …", or "without …": what is left out, with semicolons between.
    """
    stereo = replace(preset.config.stereo, dense="sgbm" if dense else "none")
    try:
        _, left_out = fit_to_sensor(replace(preset.config, stereo=stereo), sensor)
    except ConfigError:
        return "refused: nothing of it is left"
    return f"without {'; '.join(left_out)}" if left_out else "whole"
