"""Whole runs through rendered buildings: a ring of corridors that closes, and rooms that only look the same."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from stillroom.data.result import TrackingState
from stillroom.data.sensor import Sensor
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.open import open_dataset
from stillroom.evaluation.trajectory_errors import ate
from stillroom.geometry import se3
from stillroom.loops.loop_closer import LoopCloser
from stillroom.loops.verification import Loop
from stillroom.presets.registry import configure
from stillroom.system import System, build


@dataclass
class Walk:
    """A run, and what its loops were worth.

    Attributes:
        claims_off_m: How far each loop that was tried was from the truth [m].
        ate_before_m, ate_after_m: Error of all frames so far, just before and after each of them was tried.
        verdicts: Whether each was kept.
    """

    system: System
    truth: Trajectory
    claims_off_m: list[float] = field(default_factory=list)
    ate_before_m: list[float] = field(default_factory=list)
    ate_after_m: list[float] = field(default_factory=list)
    verdicts: list[bool] = field(default_factory=list)

    def ate_m(self) -> float:
        return ate(self.system.trajectory(), self.truth).judged_m.rmse

    def claim_off_m(self, loop: Loop) -> float:
        """How far a keyframe is from where the loop says, as seen from the candidate."""
        table = self.system.map.keyframes
        there, here = (
            self.truth.T_world_cam[np.abs(self.truth.timestamps_s - table.timestamp_s[k]).argmin()]
            for k in (loop.candidate, loop.keyframe)
        )
        claimed = se3.inverse(table.T_world_cam[loop.candidate]) @ loop.T_world_cam
        return float(np.linalg.norm((se3.inverse(se3.inverse(there) @ here) @ claimed)[:3, 3]))


def walk(
    spec: str, method: str, monkeypatch: pytest.MonkeyPatch, *overrides: str, sensor: Sensor = Sensor.RGBD
) -> Walk:
    """Track a sequence to its end, and watch each loop while it is being closed."""
    sequence = open_dataset(spec, sensor=sensor)
    assert sequence.groundtruth is not None
    system = build(configure(method, overrides=overrides), sequence.camera, sensor=sensor)
    seen = Walk(system, sequence.groundtruth)
    correct = LoopCloser.correct

    def watched(closer: LoopCloser, loop: Loop) -> bool:
        seen.claims_off_m.append(seen.claim_off_m(loop))
        seen.ate_before_m.append(seen.ate_m())
        seen.verdicts.append(correct(closer, loop))
        seen.ate_after_m.append(seen.ate_m())
        return seen.verdicts[-1]

    monkeypatch.setattr(LoopCloser, "correct", watched)
    for index in range(len(sequence)):
        system.process(sequence.load(index))
    system.close()
    states = [result.state for result in system.results]
    assert set(states[states.index(TrackingState.OK) :]) == {TrackingState.OK}
    assert states[0] is TrackingState.OK or not sensor.is_metric, "a single camera waits for a second view"
    return seen


@pytest.mark.slow
def test_a_ring_of_corridors_closes_with_a_single_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over Sim(3): the scale has drifted too, by a per cent or two round the ring."""
    rejecting = "semantics.kind=truth", "dynamics.kind=whole-boxes"
    spec = "synthetic:corridor,frames=600"
    seen = walk(spec, "orb-slam2", monkeypatch, *rejecting, sensor=Sensor.MONOCULAR)
    assert any(seen.verdicts)
    first = seen.verdicts.index(True)
    assert seen.ate_after_m[first] < seen.ate_before_m[first] / 1.5
    assert seen.ate_m() < 0.03
    assert not seen.system.trajectory().is_metric


def test_a_ring_of_corridors_closes_and_divides_the_error_by_three(monkeypatch: pytest.MonkeyPatch) -> None:
    """26 m round, with walking figures in boxes that are thrown away: no network is needed for that."""
    rejecting = "semantics.kind=truth", "dynamics.kind=whole-boxes"
    seen = walk("synthetic:corridor,frames=600", "orb-slam2", monkeypatch, *rejecting)
    assert any(seen.verdicts)
    assert max(seen.claims_off_m) < 0.05
    first = seen.verdicts.index(True)
    assert seen.ate_after_m[first] < seen.ate_before_m[first] / 3.0
    assert seen.ate_m() < 0.02


def check_nothing_false(seen: Walk) -> None:
    """Rooms that look the same stay apart, and true loops do no harm."""
    assert [off for off, kept in zip(seen.claims_off_m, seen.verdicts, strict=True) if kept and off > 0.1] == []
    for before, after in zip(seen.ate_before_m, seen.ate_after_m, strict=True):
        assert after < before + 0.01


@pytest.mark.slow
def test_rooms_that_look_the_same_are_not_taken_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = walk("synthetic:building,frames=600", "orb-slam2", monkeypatch)
    check_nothing_false(seen)
    assert seen.ate_m() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("method", "share"), [("orb-slam2", 0.6), ("oc-slam", 1.0 / 3.0)])
def test_a_loop_of_66_m_takes_away_most_of_the_error(
    method: str, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`orb-slam2` is carried along by a figure who walks past: its map has that step wherever its adjustment starts."""
    spec = "synthetic:corridor,frames=1500"
    without = walk(spec, method, monkeypatch, "dense.kind=nothing", "loops.enabled=false").ate_m()
    seen = walk(spec, method, monkeypatch, "dense.kind=nothing")
    assert max(seen.claims_off_m) < 0.1
    assert any(seen.verdicts)
    assert seen.ate_m() <= share * without


@pytest.mark.slow
def test_no_two_of_ten_rooms_that_look_the_same_are_taken_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole tour, 144 m, and into the first room again."""
    seen = walk("synthetic:building,frames=3200", "oc-slam", monkeypatch, "dense.kind=nothing")
    check_nothing_false(seen)
    assert any(seen.verdicts), "the first room was seen twice"


@pytest.mark.slow
def test_without_odometry_every_look_alike_is_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second line of defence alone: rooms are taken for one, the map is bent, and put back."""
    anything_goes = "loops.drift_m=1000", "loops.drift_rad=10"
    seen = walk("synthetic:building,frames=600", "orb-slam2", monkeypatch, *anything_goes)
    assert len(seen.claims_off_m) >= 3
    assert not any(seen.verdicts)
    assert seen.ate_before_m == seen.ate_after_m
    assert seen.ate_m() < 0.1
