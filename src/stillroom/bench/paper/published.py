"""What the papers print, from `published.toml`, and which of our presets stands for which of their systems."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from stillroom.errors import ConfigError

FILE = Path(__file__).with_name("published.toml")
RMSE, MEAN, MEDIAN = range(3)
"""Places in a cell of printed errors; PSPNet-SLAM prints the first alone."""

PSPNET_NAMES = {
    "ds-slam": "DS-SLAM",
    "detect-slam": "Detect-SLAM",
    "zhang-slam": "L.Zhang et al",
    "sof-slam": "SOF-SLAM",
    "pspnet-slam-paper": "PSPNet-SLAM",
    "pspnet-slam": "PSPNet-SLAM",
}
OC_NAMES = {"orb-slam2": "ORB-SLAM2", "oc-slam-paper": "OC-SLAM", "oc-slam": "OC-SLAM"}


@dataclass(frozen=True)
class Misprint:
    """What is printed and cannot be meant.

    Attributes:
        system, sequence: Whose cell it is.
        printed: What stands there.
        why: Why that cannot be, or what is meant.
    """

    system: str
    sequence: str
    printed: str
    why: str

    def sentence(self) -> str:
        """Return it as a note below a table."""
        return f"* a misprint: {self.system} on {self.sequence}, {self.printed}: {self.why}"


@dataclass(frozen=True)
class PrintedTime:
    """A time that a paper prints [ms], what takes it, and where that is said."""

    system: str
    ms: float
    of: str
    source: str


@dataclass(frozen=True)
class Paper:
    """A paper's tables, and how we make them.

    Attributes:
        name: As typed, `oc-slam` or `pspnet-slam`.
        cite: The paper.
        systems: Our presets in the order of the rows, the baseline first.
        proposed: Those of them that are the paper's own system, as printed and what we made of it.
        names: What the paper calls them; the others it does not print.
        sequences: Its sequences, without `freiburg3_`.
        errors_m: By system and sequence, RMSE of the ATE [m], and mean and median where they are printed.
        gains_percent: Likewise the improvements over ORB-SLAM2 [%], where they are printed.
        geometry_ms: By sequence, the geometry of an image in DynaSLAM and in PSPNet-SLAM [ms].
        sources: Where in the paper errors and times of geometry stand.
        misprints: What cannot be meant.
        times: Times of a frame that are printed.
        both_loops: Whether each system is run with and without loop closing.
    """

    name: str
    cite: str
    systems: tuple[str, ...]
    proposed: tuple[str, ...]
    names: Mapping[str, str]
    sequences: tuple[str, ...]
    errors_m: Mapping[str, Mapping[str, tuple[float, ...]]]
    gains_percent: Mapping[str, Mapping[str, tuple[float, ...]]]
    geometry_ms: Mapping[str, tuple[float, ...]]
    sources: tuple[str, str]
    misprints: tuple[Misprint, ...]
    times: tuple[PrintedTime, ...]
    both_loops: bool

    @property
    def baseline(self) -> str:
        """The preset that the others are compared with."""
        return self.systems[0]

    def printed_m(self, system: str, sequence: str | None) -> tuple[float, ...] | None:
        """Return the printed errors of a preset's system on one of the paper's sequences [m]; None for no such cell."""
        return None if sequence is None else self.errors_m.get(self.names.get(system, ""), {}).get(sequence)

    def printed_gains(self, system: str, sequence: str | None) -> tuple[float, ...] | None:
        """Return the printed improvements likewise [%]."""
        return None if sequence is None else self.gains_percent.get(self.names.get(system, ""), {}).get(sequence)


PAPERS = ("oc-slam", "pspnet-slam")


@cache
def paper(name: str) -> Paper:
    """Return what is known of a paper.

    Raises:
        ConfigError: There is none of this name.
    """
    if name not in PAPERS:
        raise ConfigError(f"'{name}': no such paper; there are {' and '.join(PAPERS)}")
    data = tomllib.loads(FILE.read_text(encoding="utf-8"))
    own, is_oc = data[name], name == "oc-slam"
    proposed = (f"{name}-paper", name)
    others = () if is_oc else ("dynaslam", "ds-slam", "detect-slam", "zhang-slam", "sof-slam")
    return Paper(
        name=name,
        cite=own["cite"],
        systems=("orb-slam2", *others, *proposed),
        proposed=proposed,
        names=OC_NAMES if is_oc else PSPNET_NAMES,
        sequences=tuple(own["sequences"]),
        errors_m=_cells(own["errors_m"]),
        gains_percent=_cells(own.get("gains_percent", {})),
        geometry_ms={sequence: tuple(cells) for sequence, cells in own.get("geometry_ms", {}).items()},
        sources=(own["errors_source"], own.get("geometry_source", "")),
        misprints=tuple(Misprint(**slip) for slip in own.get("misprints", ())),
        times=tuple(PrintedTime(**one) for one in data["times"]),
        both_loops=is_oc,
    )


def _cells(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, tuple[float, ...]]]:
    return {system: {sequence: tuple(cell) for sequence, cell in row.items()} for system, row in rows.items()}
