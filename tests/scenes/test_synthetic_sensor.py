"""The sensor's faults: as large as they claim, where they claim, and off when asked."""

import numpy as np

from stillroom.geometry.arrays import F32, U16
from stillroom_scenes import sensor
from stillroom_scenes.config import open_synthetic


def measured(depth_m: F32, seed: int = 0, index: int = 0) -> U16:
    tables = sensor.NoiseTables(seed)
    places = tables.places(index, *depth_m.shape)
    with np.errstate(divide="ignore"):
        inverse = np.where(depth_m > 0, 1.0 / depth_m, 0.0).astype(np.float32)
    units = np.empty(depth_m.shape, dtype=np.uint16)
    sensor.measured_units(inverse, tables.normal, places[1:], 5000.0, units)
    return units


def flat(depth_m: float) -> F32:
    return np.full((200, 640), depth_m, dtype=np.float32)


def test_noise_and_steps_grow_with_depth_as_stated() -> None:
    for depth_m in (0.6, 1.0, 2.0, 3.5, 5.0, 7.0):
        units = measured(flat(depth_m))[:, 1:-1]
        known_m = units[units > 0] / 5000.0
        assert known_m.size > 0.99 * units.size
        step_m = depth_m**2 / (sensor.PROJECTOR_PX_M * sensor.DISPARITY_STEPS)
        expected_m = np.sqrt((0.0012 + 0.0019 * (depth_m - 0.4) ** 2) ** 2 + step_m**2 / 12)
        # A step wider than the noise may round everything to one value.
        assert known_m.std() < 1.25 * expected_m + 1e-4, depth_m
        assert known_m.std() > 0.75 * expected_m or step_m > 2 * sensor.sigma_m(depth_m), depth_m
        assert abs(known_m.mean() - depth_m) < 0.5 * step_m + 0.1 * expected_m + 2e-4, depth_m


def test_disparity_comes_in_eighths_of_a_pixel() -> None:
    ramp = np.tile(np.linspace(1.0, 4.0, 640, dtype=np.float32), (100, 1))
    units = measured(ramp)
    disparity = sensor.PROJECTOR_PX_M / (units[units > 0] / 5000.0)
    off_steps = np.abs(8 * disparity - np.rint(8 * disparity))
    # 0.2 mm of depth is the finest that the file can say.
    assert np.percentile(off_steps, 99) < 8 * sensor.PROJECTOR_PX_M * 1.1e-4


def test_out_of_range_is_unknown() -> None:
    for depth_m in (0.3, 8.6, 0.0):
        assert not measured(flat(depth_m)).any()
    assert measured(flat(0.45)).astype(bool).mean() > 0.98


def test_a_near_object_throws_a_shadow_to_its_left_as_wide_as_the_disparities_differ() -> None:
    scene = flat(3.0)
    scene[:, 300:400] = 1.5
    known = measured(scene)[5:-5] > 0
    width = sensor.PROJECTOR_PX_M * (1 / 1.5 - 1 / 3.0)
    left, right = ~known[:, 250:300], ~known[:, 402:450]
    assert right.mean() < 0.02
    assert abs(left.sum(axis=1).mean() - width) < 3
    assert left[:, -int(width - 3) :].mean() > 0.98


def test_edges_and_grazing_surfaces_lose_the_pattern() -> None:
    grazing = np.tile((2.0 * 1.03 ** np.arange(40)).astype(np.float32), (100, 1))
    assert (measured(grazing)[:, 1:-1] > 0).mean() < 0.5
    sloped = np.tile((2.0 * 1.005 ** np.arange(40)).astype(np.float32), (100, 1))
    assert (measured(sloped)[:, 1:-1] > 0).mean() > 0.98


def test_a_walking_frame_has_as_many_holes_as_a_real_one() -> None:
    room = open_synthetic("synthetic:walking,frames=120,cache=off")
    shares = [float((room.load(k).depth_m == 0).mean()) for k in range(0, 120, 15)]
    assert 0.01 < np.mean(shares) < 0.25, shares


def test_measured_depth_follows_the_exact_one() -> None:
    room = open_synthetic("synthetic:walking,frames=60,cache=off")
    image, truth = room.load(40), room.truth(40)
    known = image.depth_m > 0
    off_m = image.depth_m[known] - truth.depth_m[known]
    sigma_m = 0.0012 + 0.0019 * (truth.depth_m[known] - 0.4) ** 2
    step_m = truth.depth_m[known] ** 2 / (sensor.PROJECTOR_PX_M * sensor.DISPARITY_STEPS)
    score = off_m / np.sqrt(sigma_m**2 + step_m**2 / 12)
    assert 0.85 < score.std() < 1.15
    assert abs(score.mean()) < 0.05


def test_colour_noise_has_the_stated_deviation_and_no_bias() -> None:
    noisy = open_synthetic("synthetic:empty,path=still,frames=9,cache=off")
    clean = open_synthetic("synthetic:empty,path=still,frames=9,noise=off,cache=off")
    exact = clean.load(0).rgb.astype(int)
    inside = (exact > 15) & (exact < 240)
    off = noisy.load(4).rgb.astype(int) - exact
    assert abs(off[inside].mean()) < 0.05
    assert abs(off[inside].std() - sensor.COLOUR_SIGMA) < 0.1
    shifted = (off[:, 1:] * off[:, :-1])[inside[:, 1:] & inside[:, :-1]].mean()
    assert abs(shifted) < 0.1, "noise of neighbours is correlated"


def test_without_noise_depth_is_exact_to_the_files_grain() -> None:
    room = open_synthetic("synthetic:walking,frames=60,noise=off,cache=off")
    image, truth = room.load(20), room.truth(20)
    np.testing.assert_allclose(image.depth_m, truth.depth_m, atol=1.01e-4)
