"""Every preset runs as it comes, with its own networks, on a crowd and in a rendered room."""

from pathlib import Path

import pytest

from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.pipeline import RunOptions, RunOutcome, run
from stillroom.presets.method import Method
from stillroom.presets.registry import OWN
from stillroom.protocols import Dataset

NAMES = pytest.mark.parametrize("method", OWN, ids=lambda method: method.name)
CROWDED, LONG = "200:260", "160:340"
LITERAL = {"orb-slam2", "oc-slam-paper", "pspnet-slam-paper"}
"""Where nothing is rejected, or what the papers print is; they are honest baselines, and people mislead them."""


def tracked(method: Method, dataset: Dataset) -> RunOutcome:
    outcome = run(dataset, method.config, RunOptions(root=None, pictures=0))
    assert outcome.n_tracked == outcome.n_given == len(dataset), "a frame was lost"
    return outcome


def share_of_still_camera(outcome: RunOutcome) -> float:
    """The error as a share of that of a camera that never moved."""
    assert outcome.evaluation is not None
    given = outcome.evaluation.as_given
    return given.ate_se3_m.rmse / given.still_camera_m


@NAMES
def test_it_tracks_sixty_frames_of_a_real_crowd(method: Method, bonn: Path) -> None:
    outcome = tracked(method, select(open_dataset(str(bonn)), CROWDED))
    if method.name not in LITERAL:
        assert share_of_still_camera(outcome) < 0.25


@NAMES
def test_it_tracks_sixty_frames_of_a_rendered_room(method: Method) -> None:
    outcome = tracked(method, open_dataset("synthetic:walking,frames=60"))
    if method.name not in LITERAL:
        assert share_of_still_camera(outcome) < 0.5


@pytest.mark.slow
@NAMES
def test_it_tracks_a_hundred_and_eighty_frames_of_a_real_crowd(method: Method, bonn: Path) -> None:
    outcome = tracked(method, select(open_dataset(str(bonn)), LONG))
    if method.name not in LITERAL:
        assert share_of_still_camera(outcome) < 0.25


@pytest.mark.slow
@NAMES
def test_it_tracks_a_hundred_and_fifty_frames_of_a_rendered_room(method: Method) -> None:
    outcome = tracked(method, open_dataset("synthetic:walking,frames=150"))
    if method.name not in LITERAL:
        assert share_of_still_camera(outcome) < 0.5
