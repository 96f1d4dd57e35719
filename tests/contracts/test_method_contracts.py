"""Every method of Stillroom fulfils the contract, on the synthetic room and on real frames."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillroom.config import SlamConfig, with_overrides
from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.evaluation.trajectory_errors import ate
from stillroom.presets.method import Method
from stillroom.presets.registry import OWN
from stillroom.protocols import Dataset, Segmenter
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.testing.method_contract import check_method


@pytest.fixture(scope="module")
def room() -> Dataset:
    return open_dataset("synthetic:walking,frames=30")


def stand_in(method: Method) -> Callable[[], Segmenter]:
    """The renderer's boxes for a method that has a detector, its masks for one with masks: no weights are needed."""
    if isinstance(method.config.semantics, NothingConfig):
        return NothingConfig().build
    return TrueSemanticsConfig(masks=not isinstance(method.config.semantics, YoloFastestConfig)).build


@pytest.mark.parametrize("method", OWN, ids=lambda method: method.name)
def test_method_keeps_its_promises_in_the_synthetic_room(method: Method, room: Dataset) -> None:
    system = check_method(method, room, stand_in(method))
    assert all(result.T_world_cam is not None for result in system.results)
    assert room.groundtruth is not None
    error = ate(system.trajectory(), room.groundtruth)
    # In one second in which hardly anything is hidden, any of them tracks well.
    assert error.se3_m.rmse < 0.25 * error.still_camera_m


@pytest.mark.parametrize("method", OWN, ids=lambda method: method.name)
def test_method_keeps_its_promises_on_real_frames(method: Method, bonn: Path) -> None:
    overrides, chosen = list[str](), "230:255"
    if not isinstance(method.config.semantics, NothingConfig | YoloFastestConfig):
        # A network that is slow and late, as in a live run.
        overrides, chosen = ["semantics.every=3", "semantics.latency_frames=5"], "230:245"
    config = with_overrides(method.config, overrides)
    check_method(replace(method, config=config), select(open_dataset(str(bonn)), chosen))


def good(room: Dataset) -> Method:
    return Method("orb-slam2", "a method", SlamConfig())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda method: replace(method, name="other"), "'other' has a config of 'orb-slam2'"),
        (lambda method: replace(method, summary="two\nlines"), "more than one line"),
        (lambda method: replace(method, summary=""), "no summary"),
    ],
)
def test_the_contract_sees_a_wrong_description(room: Dataset, spoil: Callable[[Method], Method], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_method(spoil(good(room)), room)


def test_the_contract_sees_chance(room: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pose that depends on random numbers drawn elsewhere breaks it."""
    from stillroom.system import System

    honest, generator = System.process, np.random.default_rng()

    def process(system: System, image: object) -> object:
        result = honest(system, image)  # type: ignore[arg-type]
        if result.T_world_cam is not None:
            result.T_world_cam[0, 3] += generator.normal(0.0, 1e-12)
        return result

    monkeypatch.setattr(System, "process", process)
    with pytest.raises(AssertionError, match="same input and seed"):
        check_method(good(room), select(room, ":8"))
