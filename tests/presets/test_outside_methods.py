"""Methods that a package outside would add: they need no change to the core, keep its contracts, and work."""

import inspect
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import ds_slam
import moving_points
import numpy as np
import pytest

from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dynamics import whole_boxes
from stillroom.pipeline import RunOptions, RunOutcome, run
from stillroom.presets.method import Method
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.testing.sieve_contract import check_sieve
from stillroom.testing.sieve_jumps import check_follows_jumps

METHODS = {"ds-slam": ds_slam.METHOD, "moving points": moving_points.METHOD}
CROWDED = "200:260"


def source_lines(module: ModuleType) -> int:
    return len(inspect.getsource(module).splitlines())


@pytest.fixture(scope="module")
def crowd(bonn: Path) -> Dataset:
    return select(open_dataset(str(bonn)), CROWDED)


@pytest.fixture(scope="module")
def static(crowd: Dataset) -> RunOutcome:
    """The same images under the belief that nothing moves."""
    return run(crowd, configure("orb-slam2", seed=1), RunOptions(root=None, pictures=0))


@pytest.fixture(scope="module", params=METHODS)
def outcome(request: pytest.FixtureRequest, crowd: Dataset) -> RunOutcome:
    method = METHODS[request.param]
    return run(crowd, replace(method.config, seed=1), RunOptions(root=None, pictures=0))


def test_they_track_every_frame_and_take_three_quarters_of_the_error(outcome: RunOutcome, static: RunOutcome) -> None:
    assert outcome.n_tracked == outcome.n_given == 60
    assert outcome.evaluation is not None
    assert static.evaluation is not None
    error_m = outcome.evaluation.as_given.ate_se3_m.rmse
    assert error_m <= 0.25 * static.evaluation.as_given.ate_se3_m.rmse
    assert error_m < 0.012


@pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
def test_their_sieves_keep_the_contract(method: Method) -> None:
    answers = check_sieve(method.config.dynamics.build)
    assert not all(answer.motion.is_static.all() for answer in answers)
    assert check_follows_jumps(method.config.dynamics.build) > 0


def test_a_sieve_reads_back_what_it_wrote_beside_the_maps_points(outcome: RunOutcome) -> None:
    world = outcome.system.map
    if outcome.method != moving_points.METHOD.name:
        assert moving_points.COLUMN not in world.points.views, "nobody pays for another sieve's column"
        return
    p_moving = world.points.column(moving_points.COLUMN)
    assert len(p_moving) == len(world.points)
    assert ((p_moving >= 0.0) & (p_moving <= 1.0)).all()
    newest = int(world.alive_keyframes()[-1])
    made = world.points_of(newest)
    made = made[made >= 0]
    made = made[world.points.first_keyframe[made] == newest]
    old = np.flatnonzero(world.points.is_alive & (world.points.first_keyframe < newest))
    assert 0.0 < p_moving[old].max() < 1.0, "updated in several images"
    assert set(p_moving[made]) <= set(p_moving[old]), "handed on from neighbours when the keyframe was made"


def test_they_are_as_short_as_their_ideas() -> None:
    assert source_lines(ds_slam) <= 80
    assert source_lines(moving_points) <= 80
    assert source_lines(whole_boxes) <= 25
