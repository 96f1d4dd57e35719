"""SLAM on rendered sequences with either shutter, modelled or not."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest

from stillroom.bench.trial import Trial, attempt, poses_only
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.open import open_dataset
from stillroom.pipeline.options import RunOptions, RunOutcome
from stillroom.pipeline.results import run_figures
from stillroom.pipeline.run import run
from stillroom.pipeline.shutter import WithReadout
from stillroom.presets.registry import configure
from stillroom.system import build

TURNING = "synthetic:empty,path=rpy,frames=90"
READOUT_S = 0.03


@dataclass(frozen=True)
class Shutter:
    """What the camera has, and what the method takes it to have [s]."""

    true_s: float
    taken_s: float


class Taken(WithReadout):
    @property
    def groundtruth(self) -> Trajectory | None:  # type: ignore[override]
        return self.inner.groundtruth


@lru_cache
def trial(shutter: Shutter, modelled: bool = True) -> Trial:
    room = open_dataset(TURNING + (f",readout_ms={1e3 * shutter.true_s:g}" if shutter.true_s else ""))
    config = configure("orb-slam2", None, ("tracking.shutter=rolling",) if modelled else ())
    return attempt(Taken(room, shutter.taken_s), config, seed=0)


def ate_m(shutter: Shutter) -> float:
    found = trial(shutter)
    assert found.coverage == 1.0
    assert found.ate_m is not None
    return found.ate_m


def test_a_rolling_shutter_costs_much_and_modelling_it_mends_that() -> None:
    modelled, not_modelled = ate_m(Shutter(READOUT_S, READOUT_S)), ate_m(Shutter(READOUT_S, 0.0))
    assert modelled < 0.3 * not_modelled, "0.007 m in place of 0.066 when this was written"
    assert modelled < 2.0 * ate_m(Shutter(0.0, 0.0))


def ran(shutter: Shutter) -> RunOutcome:
    room = open_dataset(TURNING + (f",readout_ms={1e3 * shutter.true_s:g}" if shutter.true_s else ""))
    config = poses_only(configure("orb-slam2", None, ("tracking.shutter=rolling",)))
    return run(Taken(room, shutter.taken_s), config, RunOptions(root=None, pictures=0))


def test_a_shutter_that_is_not_there_costs_next_to_nothing() -> None:
    """The readout of a global camera, given as 30 ms: 0.0063 m for 0.0043 while it was modelled all the same."""
    outcome = ran(Shutter(0.0, READOUT_S))
    assert outcome.evaluation is not None
    found_m = outcome.evaluation.as_given.ate_se3_m.rmse
    assert found_m < 1.02 * ate_m(Shutter(0.0, 0.0))
    assert found_m == ate_m(Shutter(0.0, READOUT_S)), "the same again, to the last digit"
    assert [doubt.name for doubt in outcome.doubts] == ["shutter"]
    assert "its camera file says 30 ms: rows are read as one" in str(outcome.doubts[0])
    found = run_figures(outcome)["readout"]
    assert found["as_one"]
    assert abs(found["readout_s"]) < 3.0 * found["sigma_s"] < 0.01
    assert found["n_as_one"] > 70


def test_nothing_is_said_of_a_shutter_that_is_there() -> None:
    outcome = ran(Shutter(READOUT_S, READOUT_S))
    assert not outcome.doubts
    found = run_figures(outcome)["readout"]
    assert not found["as_one"]
    assert found["n_as_one"] == 0
    assert abs(found["readout_s"] - READOUT_S) < 0.004


def test_where_the_readout_is_nothing_the_global_shutter_is_kept_to_the_byte() -> None:
    room = open_dataset("synthetic:walking,frames=12,fps=15")
    trajectories = []
    for settings in ((), ("tracking.shutter=rolling",)):
        system = build(configure("orb-slam2", None, settings), room.camera)
        for image in room:
            system.process(image)
        system.close()
        trajectories.append(system.trajectory().T_world_cam)
    assert trajectories[0].tobytes() == trajectories[1].tobytes()


@pytest.mark.parametrize("taken_s", [pytest.param(0.0, marks=pytest.mark.slow), READOUT_S])
def test_the_same_input_gives_the_same_bytes(taken_s: float) -> None:
    once = trial(Shutter(READOUT_S, taken_s))
    room = open_dataset(f"{TURNING},readout_ms={1e3 * READOUT_S:g}")
    again = attempt(Taken(room, taken_s), configure("orb-slam2", None, ("tracking.shutter=rolling",)), seed=0)
    assert once.ate_m == again.ate_m
    assert np.isfinite(once.ate_m or np.nan)
