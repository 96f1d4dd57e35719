"""A map of the size that a run of 560 frames leaves is there at once, places included: opened a table at a time."""

from pathlib import Path

import numpy as np
from building import parts
from counted_lines import n_lines
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.data.map import Map
from stillroom.features.places.place_index import PlacesConfig
from stillroom.features.places.vocabulary import load_vocabulary
from stillroom.storage import StoredMap, load_map, save_map

N_KEYFRAMES = 80
"""More than the Bonn stretch leaves with any of the methods."""
N_KEYPOINTS = 800
"""Fewer than they have, in the mean."""


def saved(path: Path, n_keyframes: int) -> Path:
    rng = np.random.default_rng(0)
    small = SmallMap(SmallWorld.of(0, n=1300))
    for _ in range(n_keyframes):
        small.add(pose(*rng.uniform(-0.3, 0.3, 3)))
        small.world.points_m[rng.integers(0, 1300, 60)] += 0.05
        small.id_of[rng.integers(0, 1300, 60)] = -1  # seen as something new
    assert small.map.keyframes.n_rows.mean() > N_KEYPOINTS
    save_map(path, StoredMap(small.map, CAMERA))
    return path


def test_a_map_opens_without_a_line_for_each_keypoint(tmp_path: Path) -> None:
    load_vocabulary(None)
    lines = []
    for n_keyframes in (2, 2, N_KEYFRAMES):  # the first makes what all of them share
        path = saved(tmp_path / f"{len(lines)}.stillmap", n_keyframes)
        worlds: list[Map] = []

        def opened(path: Path = path, worlds: list[Map] = worlds) -> None:
            worlds.append(load_map(path).world)
            PlacesConfig().build(parts(world=worlds[0])).remember_all()

        lines.append(n_lines(opened))
    assert len(worlds[0].points) > 4000
    # What there is takes a thousand lines a keyframe; a loop over keypoints would take as many more, or twice that.
    assert (lines[2] - lines[1]) / (N_KEYFRAMES - 2) < 1.5 * N_KEYPOINTS, lines
