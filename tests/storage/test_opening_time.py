"""A map of the size that a run of 560 frames leaves is there at once, places included."""

import time
from pathlib import Path

import numpy as np
from building import parts
from small_world import CAMERA, SmallMap, SmallWorld, pose

from stillroom.features.places.place_index import PlacesConfig
from stillroom.features.places.vocabulary import load_vocabulary
from stillroom.storage import StoredMap, load_map, save_map

N_KEYFRAMES = 80
"""More than the Bonn stretch leaves with any of the methods."""


def test_a_map_opens_in_less_than_a_second(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    small = SmallMap(SmallWorld.of(0, n=1300))
    for _ in range(N_KEYFRAMES):
        small.add(pose(*rng.uniform(-0.3, 0.3, 3)))
        small.world.points_m[rng.integers(0, 1300, 60)] += 0.05
        small.id_of[rng.integers(0, 1300, 60)] = -1  # seen as something new
    assert small.map.keyframes.n_rows.mean() > 800
    path = tmp_path / "room.stillmap"
    save_map(path, StoredMap(small.map, CAMERA))
    load_vocabulary(None)
    PlacesConfig().build(parts(world=small.map)).remember(0)  # kernels are compiled or read
    start_s = time.process_time()
    world = load_map(path).world
    PlacesConfig().build(parts(world=world)).remember_all()
    assert time.process_time() - start_s < 1.0
    assert len(world.points) > 4000
