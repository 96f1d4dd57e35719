"""The dense map of rendered rooms in which figures stand, walk and move things, with true poses."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import pytest
from building import parts
from posed_keyframes import PosedKeyframes
from true_surfaces import FIGURES, REACH_M, STILL, THINGS, distances_m, share_in, surface, times_looked_through

from stillroom.data.dense_cloud import DenseCloud
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.dense.dense_mapper import DenseMapperConfig
from stillroom.dense.octomap import OctoMapConfig
from stillroom.presets.registry import configure
from stillroom_scenes.room import FrameTruth, SyntheticRoom

STEP = 5
FULL = configure("oc-slam").dense
WITHOUT = configure("oc-slam", overrides=["dense.carving.removal=false"]).dense
FAR_M = 7.0


@dataclass(eq=False)
class Filmed:
    """Every fifth frame of a rendered sequence, with its truth."""

    room: SyntheticRoom
    images: list[RgbdImage] = field(default_factory=list)
    truths: list[FrameTruth] = field(default_factory=list)

    @staticmethod
    def of(spec: str) -> "Filmed":
        filmed = Filmed(open_dataset(spec))
        for index in range(0, len(filmed.room), STEP):
            filmed.images.append(filmed.room.load(index))
            filmed.truths.append(filmed.room.truth(index))
        return filmed

    def map(self, config: DenseMapperConfig | OctoMapConfig, masks_from_s: float = 0.0) -> DenseCloud:
        """Map it, each frame a keyframe. Before a time, nothing is known to move."""
        mapper = config.build(parts(self.room.camera, PosedKeyframes(np.array([t.T_world_cam for t in self.truths]))))
        for k, (image, truth) in enumerate(zip(self.images, self.truths, strict=True)):
            mapper.integrate(k, image, truth.moving if image.timestamp_s >= masks_from_s else None)
        return mapper.cloud()

    def surface(self, time_s: float, instances: range) -> np.ndarray:
        """Points (N, 3) [m, world] of instances that are truly seen at a time, thinned to 2 cm."""
        return surface(self.room, [self.truths[round(time_s * 30 / STEP)]], instances)

    @lru_cache(maxsize=8)  # noqa: B019 # the films live as long as the tests
    def still_surface(self, reach_m: float = REACH_M) -> np.ndarray:
        """Points (N, 3) [m, world] of the still room that any of the frames truly sees, thinned to 2 cm."""
        return surface(self.room, self.truths[::4], STILL, reach_m)

    def times_looked_through(self, points_m: np.ndarray, from_s: float) -> np.ndarray:
        """Count the frames from a time on that truly see something more than 15 cm behind points (N, 3), (N,)."""
        return times_looked_through(self.room, self.truths[round(from_s * 30 / STEP) :], points_m)


@pytest.fixture(scope="module")
def standing() -> Filmed:
    return Filmed.of("synthetic:standing")


@pytest.fixture(scope="module")
def pushed() -> Filmed:
    return Filmed.of("synthetic:pushed")


def test_the_room_is_exact_and_whole_and_nobody_is_in_it(standing: Filmed) -> None:
    cloud, still_m = standing.map(FULL), standing.still_surface()
    assert len(still_m) > 50_000
    error_m = distances_m(cloud.positions_m, standing.still_surface(FAR_M))
    assert np.median(error_m) < 0.01
    assert np.mean(error_m > 0.05) < 0.005
    assert share_in(cloud, still_m, 0.05) > 0.97


def test_who_stood_for_five_seconds_unknown_leaves_no_statue(standing: Filmed) -> None:
    stood_m, still_m = standing.surface(3.0, FIGURES), standing.still_surface()
    stood_m = stood_m[distances_m(stood_m, still_m) > 0.08]
    assert len(stood_m) > 2000
    # Until they walk off, nobody knows that they can: they are fused as furniture is.
    late = standing.map(FULL, masks_from_s=5.2)
    assert share_in(standing.map(WITHOUT, masks_from_s=5.2), stood_m) > 0.9
    assert share_in(late, stood_m) < 0.01
    assert np.mean(distances_m(late.positions_m, standing.still_surface(FAR_M)) > 0.05) < 0.005
    assert share_in(late, still_m, 0.05) > 0.97


@pytest.mark.slow
def test_misses_free_the_voxels_of_who_stood_for_five_seconds(standing: Filmed) -> None:
    stood_m, still_m = standing.surface(3.0, FIGURES), standing.still_surface()
    stood_m = stood_m[distances_m(stood_m, still_m) > 0.08]
    last_s = 5.2
    n = int(last_s * 30 / STEP)
    until_then = Filmed(standing.room, standing.images[:n], standing.truths[:n])
    assert share_in(until_then.map(OctoMapConfig(), masks_from_s=last_s), stood_m) > 0.9
    late = standing.map(OctoMapConfig(), masks_from_s=last_s)
    assert share_in(late, stood_m) < 0.01
    assert np.mean(distances_m(late.positions_m, standing.still_surface(FAR_M)) > 0.10) < 0.02
    assert share_in(late, still_m, 0.05) > 0.97


@pytest.mark.parametrize("masks_from_s", [0.0, 1e9])
def test_a_pushed_chair_is_where_it_was_left_not_where_it_was(pushed: Filmed, masks_from_s: float) -> None:
    end_s = (len(pushed.truths) - 1) * STEP / 30
    still_m = pushed.still_surface()
    before_m, after_m = pushed.surface(0.0, THINGS), pushed.surface(end_s, THINGS)
    before_m = before_m[(distances_m(before_m, still_m) > 0.08) & (distances_m(before_m, after_m) > 0.08)]
    before_m = before_m[pushed.times_looked_through(before_m, 8.0) >= 12]
    assert min(len(before_m), len(after_m)) > 1000
    without, cloud = pushed.map(WITHOUT), pushed.map(FULL, masks_from_s)
    assert share_in(without, before_m) > 0.9
    assert share_in(cloud, before_m) < 0.02
    assert share_in(cloud, after_m) > 0.85
