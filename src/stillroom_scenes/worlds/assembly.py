"""Puts cells together to a building: each is built around its own origin and moved to where it belongs."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.geometry.arrays import F64
from stillroom_scenes.scene.atlas import AtlasBuilder
from stillroom_scenes.scene.patches import Patches, concatenate, moved
from stillroom_scenes.scene.people.choreography import Cast
from stillroom_scenes.scene.people.figures import build_people
from stillroom_scenes.scene.people.script import Script
from stillroom_scenes.worlds.building import BuildingScene
from stillroom_scenes.worlds.plan import Cell, Opening, Plan
from stillroom_scenes.worlds.shell import Shell

TOUCHING_M = 1e-6


@dataclass
class Assembly:
    """A building in the making.

    Attributes:
        atlas: Takes all textures.
    """

    atlas: AtlasBuilder = field(default_factory=AtlasBuilder)
    _cells: list[Cell] = field(default_factory=list)
    _patches: list[Patches] = field(default_factory=list)
    _openings: list[Opening] = field(default_factory=list)

    def add(self, name: str, shell: Shell, patches: Patches, T_world_local: F64) -> int:
        """Add a cell, given in its local frame, and return its number."""
        self._cells.append(shell.cell(name, T_world_local))
        self._patches.append(moved(patches, T_world_local))
        return len(self._cells) - 1

    def join(self, one: int, other: int) -> None:
        """Note that one can see from a cell to another, all along the border that they share."""
        a, b = self._cells[one], self._cells[other]
        low = np.maximum(a.low_m, b.low_m)
        high = np.minimum(a.high_m, b.high_m)
        gap = high - low
        assert abs(gap.min()) < TOUCHING_M < gap.max(), f"{a.name} and {b.name} have no border in common"
        self._openings.append(Opening((one, other), (low[0], low[1]), (high[0], high[1])))

    def build(self, scripts: tuple[Script, ...], seed: int) -> BuildingScene:
        """Return the building with figures that follow scripts."""
        people, objects = build_people(Cast(scripts), seed, self.atlas)
        plan = Plan(tuple(self._cells), tuple(self._openings))
        still = tuple(self._patches)
        return BuildingScene(self.atlas.build(), concatenate(list(still)), people, objects, plan, still)
