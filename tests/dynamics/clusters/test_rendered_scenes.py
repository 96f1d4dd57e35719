"""The whole of `oc-slam` on rendered scenes: what is said to move, and what the dense map keeps, held to the truth.

A detector that is told everything, or nothing at all: then clusters alone find what moves.
"""

from functools import lru_cache

import pytest
from masked_run import Count, MaskedRun, masked_run
from true_surfaces import FIGURES, STILL, THINGS, distances_m, share_in, surface, times_looked_through

SCENES = {
    "standing": ("synthetic:standing", "0:270:3"),
    "carried": ("synthetic:carried,frames=600", "60:600:3"),
    "pushed": ("synthetic:pushed,frames=600", "150:600:3"),
}
"""Ten images a second: from a while before something happens until it has settled."""

EVERYTHING, NOTHING = "truth", "nothing"
LEAST = {
    # Least precision and recall of moving pixels.
    ("standing", EVERYTHING): (0.94, 0.98),
    ("carried", EVERYTHING): (0.90, 0.98),
    ("pushed", EVERYTHING): (0.85, 0.98),
    ("standing", NOTHING): (0.90, 0.85),
    ("carried", NOTHING): (0.90, 0.94),
    ("pushed", NOTHING): (0.93, 0.90),
}


@lru_cache(maxsize=1)
def run_of(scene: str, detector: str) -> MaskedRun:
    run = masked_run(SCENES[scene][0], detector, SCENES[scene][1])
    assert len(run.images) == len(run.truths), "every image is tracked"
    return run


def slow(scene: str) -> object:
    return pytest.param(scene, marks=pytest.mark.slow)


@pytest.mark.parametrize("scene", ["standing", slow("carried"), slow("pushed")])
def test_whom_a_detector_sees_is_masked_and_little_else(scene: str) -> None:
    run = run_of(scene, EVERYTHING)
    holds(run.of_figures(), *LEAST[scene, EVERYTHING])
    # Nor are they in the map, though they stood for seconds.
    people_m, cloud = surface(run.room, run.truths[::10], FIGURES), run.cloud
    apart_m = people_m[distances_m(people_m, surface(run.room, run.truths[::5], STILL)) > 0.1]
    assert len(apart_m) > 2000
    assert share_in(cloud, apart_m) < 0.01


@pytest.mark.parametrize("scene", [slow("standing"), "carried", slow("pushed")])
def test_what_goes_is_found_though_no_class_names_it(scene: str) -> None:
    run = run_of(scene, NOTHING)
    holds(run.of_what_goes(), *LEAST[scene, NOTHING])
    if scene == "standing":
        # For five seconds they are furniture, then they are not.
        assert run.share_of(FIGURES, 1.0, 4.8) < 0.1
        assert run.share_of(FIGURES, 6.0, 9.0) > 0.65
        return
    # The thing itself: while it goes, and when it has come to rest.
    (thing,) = run.room.scene.objects
    handling = thing.handling
    assert run.share_of(THINGS, handling.taken_s + 1.0, handling.left_s - 1.0) > 0.85
    assert run.share_of(THINGS, handling.left_s + 3.0, 20.0) < 0.05
    is_where_it_was_left(run, handling.left_s)


def holds(found: Count, precision: float, recall: float) -> None:
    assert found.true > 500_000
    assert found.precision > precision
    assert found.recall > recall


def is_where_it_was_left(run: MaskedRun, left_s: float) -> None:
    """Hold the dense map against where the thing was at first and is in the end."""
    room, cloud = run.room, run.cloud
    still_m = surface(room, run.truths[::10], STILL)
    before_m, after_m = (surface(room, [run.truths[k]], THINGS) for k in (0, -1))
    before_m = before_m[(distances_m(before_m, still_m) > 0.08) & (distances_m(before_m, after_m) > 0.08)]
    late = [truth for truth, image in zip(run.truths, run.images, strict=True) if image.time_s > left_s]
    before_m = before_m[times_looked_through(room, late, before_m) >= 12]
    assert min(len(before_m), len(after_m)) > 200
    assert share_in(cloud, after_m) > 0.85
    assert share_in(cloud, before_m) < 0.02
