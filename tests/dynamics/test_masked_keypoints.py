"""Sieve 1 that drops keypoints on what may move."""

from dataclasses import replace

import numpy as np
import pytest
from small_world import SmallWorld, no_semantics, pose

from stillroom.config import SlamConfig, with_overrides
from stillroom.data.frame import Frame
from stillroom.data.semantics import Box, Semantics
from stillroom.datasets.open import open_dataset
from stillroom.dynamics.masked_keypoints import MaskedKeypoints, MaskedKeypointsConfig, drop_near
from stillroom.errors import ConfigError
from stillroom.geometry.pixels import Shape, element, grown, values_at
from stillroom.schedule import Done
from stillroom.system import build
from stillroom.testing.sieve_contract import TINY

FRAME, _ = SmallWorld.of(0, 60).look(pose())


def a_disc(radius_px: float = 80.0) -> Semantics:
    row, column = np.indices((480, 640))
    return Semantics(480, 640, (), np.hypot(row - 240, column - 320) <= radius_px)


def placed(raw_px: list[tuple[float, float]], is_static: list[bool] | None = None) -> Frame:
    n = len(raw_px)
    keypoints = replace(
        FRAME.keypoints,
        **{name: value[:n] for name, value in vars(FRAME.keypoints).items()} | {"raw_px": np.float32(raw_px)},
    )
    return Frame(FRAME.image, FRAME.camera, FRAME.scales, keypoints, np.array(is_static or [True] * n))


@pytest.mark.parametrize("border_px", [0, 3, 9])
def test_what_lies_on_the_mask_or_within_the_border_goes(border_px: int) -> None:
    sieve = MaskedKeypointsConfig(border_px, min_keypoints=0).build()
    offsets = [0.0, 79.0, 80.0 + border_px, 82.0 + border_px]
    frame = placed([(320 + x, 240) for x in offsets])
    assert sieve(frame, Done(a_disc())).is_static.tolist() == [False, False, False, True]
    assert frame.is_static.all(), "the frame that was given has changed"


def test_the_border_is_that_of_a_dilated_mask() -> None:
    rng = np.random.default_rng(0)
    mask = rng.random((480, 640)) < 0.005
    raw_px = rng.uniform((-5, -5), (645, 485), (3000, 2)).astype(np.float32)
    for border_px in (0, 2, 5):
        is_static = rng.random(3000) < 0.8
        expected = is_static & ~values_at(grown(mask, border_px, Shape.ELLIPSE), raw_px)
        drop_near(mask, raw_px, element(border_px, Shape.ELLIPSE), is_static)
        np.testing.assert_array_equal(is_static, expected)


def test_an_earlier_verdict_stays() -> None:
    sieve = MaskedKeypointsConfig(min_keypoints=0).build()
    frame = placed([(10, 10), (320, 240), (600, 20)], [False, True, True])
    assert sieve(frame, Done(a_disc())).is_static.tolist() == [False, False, True]


def test_boxes_count_where_there_is_no_mask() -> None:
    sieve = MaskedKeypointsConfig(border_px=0, min_keypoints=0).build()
    frame = placed([(100, 100), (300, 200)])
    boxes = Semantics(480, 640, (Box(250, 150, 350, 250, "person", 1.0),))
    assert sieve(frame, Done(boxes)).is_static.tolist() == [True, False]


def test_it_is_off_where_too_little_would_stay() -> None:
    everywhere = Done(Semantics(480, 640, (), np.ones((480, 640), np.bool_)))
    assert MaskedKeypoints(MaskedKeypointsConfig())(FRAME, everywhere).is_static.all()
    assert not MaskedKeypoints(MaskedKeypointsConfig(min_keypoints=0))(FRAME, everywhere).is_static.any()


def test_without_anything_movable_the_frame_is_as_it_was() -> None:
    assert MaskedKeypointsConfig().build()(FRAME, no_semantics()) is FRAME


def test_negative_values_are_refused() -> None:
    with pytest.raises(ConfigError, match="border_px' is -1"):
        MaskedKeypointsConfig(border_px=-1).build()


def test_a_system_with_it_makes_no_points_of_people() -> None:
    dataset = open_dataset(TINY)
    chosen = ["keypoints.kind=masked", "semantics.kind=truth", "semantics.masks=true"]
    system = build(with_overrides(SlamConfig(), chosen), dataset.camera)
    for place in range(11, 17):
        system.process(dataset.load(place))
    keyframes = system.map.alive_keyframes()
    assert len(keyframes) >= 1
    assert system.results[-1].n_static < system.results[-1].n_keypoints
    for keyframe in keyframes:
        rows = system.map.rows(keyframe)
        on_people = ~system.map.keypoints.is_static[rows]
        assert on_people.any()
        assert (system.map.keypoints.point[rows][on_people] < 0).all()
