"""Gaps, kidnaps and strange places on real sequences: the whole system loses the camera and finds it again.

The short versions stand for the long ones, which are `slow`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillroom.config import SlamConfig
from stillroom.data.map import submaps
from stillroom.data.result import FrameResult, Recovery, TrackingState
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.dense.no_dense_map import NoDenseMapConfig
from stillroom.evaluation.trajectory_errors import ate
from stillroom.presets.registry import configure, method
from stillroom.protocols import Dataset
from stillroom.system import System, build
from stillroom.tracking.relocalizer import RelocalizerConfig

WITHIN = 10
"""Frames after a gap in which the camera must be back."""


def oc_slam(seed: int = 0) -> SlamConfig:
    """`oc-slam` without the dense map, which has no say in poses."""
    return replace(method("oc-slam").config, dense=NoDenseMapConfig(), seed=seed)


def tracked(dataset: Dataset, config: SlamConfig) -> System:
    system = build(config, dataset.camera)
    for i in range(len(dataset)):
        system.process(dataset.load(i))
    system.close()
    return system


def first_back(system: System, after: int) -> FrameResult:
    """The first frame from number `after` on that has a pose in the main piece of the map."""
    return next(r for r in system.results if r.index >= after and r.T_world_cam is not None and r.submap == 0)


def check(dataset: Dataset, system: System, after: int, max_lost: int, max_m: float) -> None:
    assert first_back(system, after).index < after + WITHIN
    assert system.apart() == []
    trajectory = system.trajectory()
    assert len(trajectory) >= len(dataset) - max_lost
    assert ate(trajectory, dataset.groundtruth).se3_m.rmse <= max_m


class TestKidnap:
    """fr1 turns by 89° between frames 45 and 84: to a place seen before, of which the last frame shows nothing."""

    def check(self, freiburg1: Path, seed: int) -> None:
        dataset = select(open_dataset(str(freiburg1)), drop=["46:84"])
        system = tracked(dataset, configure("orb-slam2", seed=seed))
        back = first_back(system, 84)
        assert back.recovery is Recovery.PLACE
        check(dataset, system, 84, WITHIN, 0.03)

    def test_the_place_is_recognised(self, freiburg1: Path) -> None:
        self.check(freiburg1, 0)

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", [1, 2, 3, 4])
    def test_the_place_is_recognised_whatever_the_seed(self, freiburg1: Path, seed: int) -> None:
        self.check(freiburg1, seed)


class TestGaps:
    """Frames 250 to 329 of the Bonn stretch are missing (10 cm, 21°); or 400 to 439 are black."""

    def test_the_camera_is_back_soon_after_a_gap(self, bonn: Path) -> None:
        dataset = select(open_dataset(str(bonn)), frames="236:345", drop=["250:330"])
        check(dataset, tracked(dataset, oc_slam()), 330, WITHIN, 0.03)

    def test_the_camera_is_back_soon_after_the_dark(self, bonn: Path) -> None:
        # The room was seen without people first, as in the whole stretch.
        dataset = select(open_dataset(str(bonn)), frames=":455", drop=["50:385"], blackout=["400:440"])
        system = tracked(dataset, oc_slam())
        check(dataset, system, 440, 40 + WITHIN, 0.03)
        assert first_back(system, 440).recovery is Recovery.PLACE

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", [0, 1, 2])
    @pytest.mark.parametrize(
        ("gap", "after"), [({"drop": ["250:330"]}, 330), ({"blackout": ["400:440"]}, 440)], ids=["dropped", "black"]
    )
    def test_the_whole_stretch(self, bonn: Path, gap: dict[str, list[str]], after: int, seed: int) -> None:
        dataset = select(open_dataset(str(bonn)), **gap)
        system = tracked(dataset, oc_slam(seed))
        check(dataset, system, after, 40 + WITHIN if "blackout" in gap else WITHIN, 0.03)


class TestStrangePlace:
    """Thirty frames of fr1 are shown to a map of the Bonn room."""

    def check(self, bonn: Path, freiburg1: Path, config: SlamConfig, every: int, last: int) -> None:
        room, strange = open_dataset(str(bonn)), open_dataset(str(freiburg1))
        system = build(config, room.camera)
        for i in range(0, last, every):
            system.process(room.load(i))
        n_known, end_s = len(system.results), system.results[-1].timestamp_s
        n_poses = len(system.trajectory())
        for k in range(30):
            image = strange.load(5 * k)
            system.process(replace(image, index=10_000 + k, timestamp_s=end_s + 1.0 + k / 30.0, truth=None))
        system.close()
        shown = system.results[n_known:]
        assert all(r.T_world_cam is None or r.submap != 0 for r in shown)
        # They have a piece of their own, which nothing joins and which the trajectory leaves out.
        begun = [r for r in shown if r.recovery is Recovery.NEW_SUBMAP]
        assert len(begun) >= 1
        assert {r.index for r in system.apart()} == {r.index for r in shown if r.T_world_cam is not None}
        assert submaps.unjoined(system.map).tolist()[0] == 0
        assert len(system.trajectory()) == n_poses

    def test_none_is_accepted(self, bonn: Path, freiburg1: Path) -> None:
        self.check(bonn, freiburg1, configure("orb-slam2"), 2, 100)

    @pytest.mark.slow
    def test_none_is_accepted_by_the_whole_map(self, bonn: Path, freiburg1: Path) -> None:
        self.check(bonn, freiburg1, oc_slam(), 1, 560)


class TestSubmaps:
    """Relocalization is switched off, so that a lost camera must begin again; joining then has to find the place."""

    @pytest.mark.parametrize("gap", [{"drop": ["46:84"]}, {"blackout": ["40:43"]}], ids=["kidnapped", "blinded"])
    def test_a_new_piece_is_begun_and_joined(self, freiburg1: Path, gap: dict[str, list[str]]) -> None:
        dataset = select(open_dataset(str(freiburg1)), frames=":110", **gap)
        system = tracked(
            dataset, replace(configure("orb-slam2"), recovery=RelocalizerConfig(n_places=0, n_keyframes=0, patience=2))
        )
        lost = [r.index for r in system.results if r.state is TrackingState.LOST]
        assert 2 <= len(lost) <= 5
        assert [r.recovery for r in system.results].count(Recovery.NEW_SUBMAP) == 1
        assert len(system.joiner.joined) == 1
        assert submaps.unjoined(system.map).tolist() == [0]
        assert system.apart() == []
        assert len(system.trajectory()) == len(dataset) - len(lost)
        assert ate(system.trajectory(), dataset.groundtruth).se3_m.rmse < 0.035
        assert np.abs(system.map.keyframes.T_world_cam[:, :3, 3]).max() < 50

    def test_without_patience_nothing_is_begun(self, freiburg1: Path) -> None:
        dataset = select(open_dataset(str(freiburg1)), frames=":40", blackout=["12:16"])
        system = tracked(
            dataset, replace(configure("orb-slam2"), recovery=RelocalizerConfig(n_places=0, n_keyframes=0, patience=0))
        )
        assert [r.state for r in system.results[12:]] == [TrackingState.LOST] * (len(dataset) - 12)
        assert system.map.n_submaps == 1
