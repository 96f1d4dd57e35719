"""The options of a synthetic sequence, and its one-line specification."""

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

from stillroom.data.sensor import Sensor
from stillroom.errors import ConfigError, DatasetError
from stillroom.geometry.camera import LONGEST_READOUT_S
from stillroom_scenes import PREFIX
from stillroom_scenes.camera_path import PATHS
from stillroom_scenes.eyes import parallel_eyes, turned_eyes
from stillroom_scenes.pair_room import PairRoom
from stillroom_scenes.render import World
from stillroom_scenes.room import CAMERA, DepthFault, SyntheticRoom
from stillroom_scenes.scene.layout import ROOMS
from stillroom_scenes.scene.people.choreography import FIGURES
from stillroom_scenes.worlds.corridor import corridor
from stillroom_scenes.worlds.rooms import MOST_ROOMS, building
from stillroom_scenes.worlds.single import single_room

KEYS = {"frames": "n_frames"}  # short names in a spec; the others are the fields'
WAYS = {"corridor": "round", "building": "tour"}  # the only path there
WALKERS = ("none", "walking")  # the only figures there
LATEST_MS = 500.0
NO_PAIR = "none"
EYES = {"rectified": parallel_eyes, "turned": turned_eyes}
"""The pairs of cameras."""
ONLY_PEOPLE = ("walking", "standing")
"""Figures without which the room is the same; what is carried or pushed must be somewhere."""


@dataclass(frozen=True)
class SyntheticConfig:
    """A synthetic sequence.

    Attributes:
        name: Name in results; "" makes a name from the options.
        n_frames: How many frames.
        fps: Frames per second [1/s].
        seed: Chooses textures, clothes, speeds, phases and noise.
        path: The camera's path: still, sway, rpy, halfsphere, loop; it ends where it started. In the corridor: round
            (once and a quarter further, where the frames are enough; for few frames the ring is smaller). In the
            building: tour (in and out of each room in order, back, and again, as long as there are frames).
        figures: The people: none, walking, standing (5 s, then walking), carried (a box), pushed (a chair). In the
            corridor and the building: none, walking.
        room: office, workshop, library; corridor (a ring), building (rooms on both sides of a corridor).
        rooms: How many rooms the building has.
        alike: Whether these are nine tenths alike; else each looks different.
        noise: Whether the sensor has noise, quantisation, holes and a limited range; if not, depth is exact to 0.2 mm.
        readout_ms: Time in which the rows of a colour image are read, a rolling shutter [ms]; 0: all at once. Depth is
            taken at once, in the middle of it.
        stated_readout_ms: What the calibration says of that time, right or wrong [ms]; −1: what is right.
        depth_scale: What the sensor says a metre is: with 1.03 all depth is 3 % too far, and the camera does not know.
        depth_late_ms: How late depth is stamped [ms]: each image has the depth of so much earlier.
        stereo: A pair of cameras in place of the RGB-D one: rectified, or turned (distorted, the right one by 1°;
            their images are rectified as they are read). none: no pair.
        cache: Whether frames are kept in the user's cache folder.
    """

    name: str = ""
    n_frames: int = 270
    fps: float = 30.0
    seed: int = 0
    path: str = "sway"
    figures: str = "walking"
    room: str = "office"
    rooms: int = 10
    alike: bool = True
    noise: bool = True
    readout_ms: float = 0.0
    stated_readout_ms: float = -1.0
    depth_scale: float = 1.0
    depth_late_ms: float = 0.0
    stereo: str = "none"
    cache: bool = True

    def build(self) -> SyntheticRoom:
        """Return the sequence.

        Raises:
            ConfigError: A value is impossible.
        """
        for key, choices in self._choices():
            if getattr(self, key) not in choices:
                raise ConfigError(f"synthetic: {key} is '{getattr(self, key)}'; {_advice(getattr(self, key), choices)}")
        if self.n_frames < 1:
            raise ConfigError(f"synthetic: frames is {self.n_frames}; a sequence has at least 1")
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise ConfigError(f"synthetic: fps is {self.fps}; it must be above 0")
        longest_ms = 1e3 * min(1.0 / self.fps, LONGEST_READOUT_S)
        if not 0.0 <= self.readout_ms <= longest_ms:
            raise ConfigError(
                f"synthetic: readout_ms is {self.readout_ms}; it must be 0 to {longest_ms:.3g}, the time of a frame"
            )
        if not (0.0 <= self.stated_readout_ms <= longest_ms or self.stated_readout_ms == -1.0):
            raise ConfigError(
                f"synthetic: stated_readout_ms is {self.stated_readout_ms}; it must be 0 to {longest_ms:.3g}, or -1"
            )
        if not 0.5 <= self.depth_scale <= 2.0:
            raise ConfigError(f"synthetic: depth_scale is {self.depth_scale}; it must be 0.5 to 2")
        if not abs(self.depth_late_ms) <= LATEST_MS:
            raise ConfigError(
                f"synthetic: depth_late_ms is {self.depth_late_ms}; it must be -{LATEST_MS:g} to {LATEST_MS:g}"
            )
        of_rgbd = self.readout_ms, self.stated_readout_ms, self.depth_scale, self.depth_late_ms
        if of_rgbd != (0.0, -1.0, 1.0, 0.0) and self.stereo in EYES:
            raise ConfigError(
                "synthetic: readout_ms, stated_readout_ms, depth_scale and depth_late_ms are for the RGB-D camera; "
                "leave them out of a stereo sequence"
            )
        if self.seed < 0:
            raise ConfigError(f"synthetic: seed is {self.seed}; it must be 0 or more")
        if not 1 <= self.rooms <= MOST_ROOMS:
            raise ConfigError(f"synthetic: rooms is {self.rooms}; a building has 1 to {MOST_ROOMS}")
        if "/" in self.name:
            raise ConfigError(f"synthetic: name is '{self.name}'; it must not have a slash")
        name = self.name or self._own_name()
        # Name, cache and what the calibration says do not change what a frame looks like.
        looks = repr(replace(self, name="", cache=True, stated_readout_ms=-1.0)) if self.cache else None
        common = self.n_frames, self.fps, self.seed, self.noise, looks
        if self.stereo in EYES:
            room: SyntheticRoom = PairRoom(name, self._world(), EYES[self.stereo](CAMERA), *common)
        else:
            depth = DepthFault(self.depth_scale, 1e-3 * self.depth_late_ms)
            stated_s = 1e-3 * (self.readout_ms if self.stated_readout_ms < 0.0 else self.stated_readout_ms)
            readout_s = 1e-3 * self.readout_ms
            room = SyntheticRoom(name, self._world(), *common, readout_s, depth, stated_readout_s=stated_s)
        if self.figures in ONLY_PEOPLE:
            room.empty = replace(self, name="", figures="none").build
        return room

    def _choices(self) -> tuple[tuple[str, Iterable[str]], ...]:
        """Return what each key may be."""
        rooms, stereo = ("room", (*ROOMS, *WAYS)), ("stereo", (NO_PAIR, *EYES))
        if self.room in WAYS:
            return rooms, stereo, ("path", (WAYS[self.room],)), ("figures", WALKERS)
        return rooms, stereo, ("path", PATHS), ("figures", FIGURES)

    def _world(self) -> World:
        if self.room == "corridor":
            return corridor(self.n_frames, self.fps, self.figures, self.seed)
        if self.room == "building":
            return building(self.rooms, self.alike, self.figures, self.seed)
        return single_room(self.room, self.path, self.figures, self.seed, self.n_frames / self.fps)

    def _own_name(self) -> str:
        rate = "" if self.fps == 30.0 else f"_{self.fps:g}fps"
        exact = "" if self.noise else "_exact"
        rolling = f"_readout{self.readout_ms:g}ms" if self.readout_ms else ""
        rolling += f"_stated{self.stated_readout_ms:g}ms" if self.stated_readout_ms >= 0.0 else ""
        rolling += f"_depth{self.depth_scale:g}" if self.depth_scale != 1.0 else ""
        rolling += f"_late{self.depth_late_ms:g}ms" if self.depth_late_ms else ""
        pair = "" if self.stereo == NO_PAIR else "_stereo" if self.stereo == "rectified" else f"_stereo_{self.stereo}"
        place = self.room
        if self.room == "building":
            place = f"building_{self.rooms}_{'alike' if self.alike else 'different'}"
        return (
            f"synthetic_{self.figures}_{self.path}_{place}_{self.n_frames}{rate}_seed{self.seed}{exact}{rolling}{pair}"
        )


PRESETS = {
    "walking": SyntheticConfig(),
    "standing": SyntheticConfig(figures="standing", n_frames=360),
    "carried": SyntheticConfig(figures="carried", n_frames=420),
    "pushed": SyntheticConfig(figures="pushed", n_frames=420),
    "empty": SyntheticConfig(figures="none"),
    "loop": SyntheticConfig(figures="none", path="loop", n_frames=720),
    "corridor": SyntheticConfig(room="corridor", path="round", n_frames=1500),
    "building": SyntheticConfig(room="building", path="tour", figures="none", n_frames=2700),
    "rooms": SyntheticConfig(room="building", path="tour", rooms=6, alike=False, n_frames=10_000),
}


def open_synthetic(spec: str, sensor: Sensor | None = None) -> SyntheticRoom:
    """Open a rendered sequence from one line: `synthetic:walking,frames=300,seed=3,path=loop`.

    Args:
        spec: `synthetic:` and a preset, `key=value` pairs, or both, with commas between.
        sensor: The sensor asked for: a stereo one is a rectified pair, where the line names no pair.

    Raises:
        DatasetError: There is no such preset.
        ConfigError: A key or value is wrong; the message names the nearest.
    """
    config = parse_spec(spec)
    if sensor is Sensor.STEREO and config.stereo == NO_PAIR:
        config = replace(config, stereo="rectified")
    return config.build()


def parse_spec(spec: str) -> SyntheticConfig:
    """Return what a one-line spec asks for; errors as `open_synthetic`."""
    words = [word.strip() for word in spec.removeprefix(f"{PREFIX}:").removeprefix(PREFIX).split(",")]
    config = PRESETS["walking"]
    if words and "=" not in words[0] and words[0]:
        if words[0] not in PRESETS:
            raise DatasetError(f"{spec}: no synthetic sequence '{words[0]}'; {_advice(words[0], PRESETS)}")
        config = PRESETS[words[0]]
        words = words[1:]
    for word in filter(None, words):
        key, equals, value = (part.strip() for part in word.partition("="))
        if not equals:
            raise ConfigError(f"{spec}: '{word}' is not of the form key=value")
        config = _with(config, spec, key, value)
    return config


def _with(config: SyntheticConfig, spec: str, key: str, value: str) -> SyntheticConfig:
    types = {field.name: str(field.type) for field in fields(SyntheticConfig)}
    short = {field: name for name, field in KEYS.items()}
    names = [short.get(name, name) for name in types]
    field = KEYS.get(key, key)
    if key not in names and field not in types:
        raise ConfigError(f"{spec}: unknown key '{key}'; {_advice(key, names)}")
    choice: dict[str, Any] = {field: _value(types[field], spec, key, value)}
    return replace(config, **choice)


def _value(kind: str, spec: str, key: str, text: str) -> bool | int | float | str:
    if "bool" in kind:
        words = {
            "true": True,
            "on": True,
            "yes": True,
            "1": True,
            "false": False,
            "off": False,
            "no": False,
            "0": False,
        }
        if text.lower() not in words:
            raise ConfigError(f"{spec}: {key} is '{text}'; it must be on or off")
        return words[text.lower()]
    try:
        if "int" in kind:
            return int(text)
        if "float" in kind:
            return float(text)
    except ValueError:
        raise ConfigError(f"{spec}: {key} is '{text}'; it must be {_kind_of(kind)}") from None
    return text


def _kind_of(kind: str) -> str:
    return "a whole number" if "int" in kind else "a number"


def _advice(word: str, choices: Iterable[str]) -> str:
    known = list(choices)
    near = difflib.get_close_matches(word, known, 1, 0.5)
    listed = ", ".join(known)
    return f"did you mean '{near[0]}'? (there are {listed})" if near else f"there are {listed}"
