"""DS-SLAM's rule: a segment with enough points off their epipolar lines goes whole, another stays whole."""

from dataclasses import replace

import numpy as np
import pytest
from building import parts
from sliding_tiles import HEIGHT, WIDTH, Patch, TwoImages, frame_of, texture

from stillroom.data.semantics import Instance, Semantics
from stillroom.dynamics.moving_consistency import MovingConsistency, MovingConsistencyConfig, count_on, differences
from stillroom.errors import ConfigError

WALKS, STANDS = Patch(100, 120, dx=4, dy=6), Patch(400, 120)
"""The camera goes to the right: one who stands slides with the tiles; here by nothing, as if far away."""


def masked(*things: Patch) -> Semantics:
    together = np.any([thing.mask() for thing in things], axis=0)
    return Semantics(HEIGHT, WIDTH, mask=together)


ENOUGH = 25
"""More than flow errs by at the rims of tiles, fewer than a walker has points."""


def sieve(min_outliers: int = ENOUGH, **changes: object) -> MovingConsistency:
    return replace(MovingConsistencyConfig(min_outliers=min_outliers), **changes).build(parts())


def test_who_walks_goes_whole_and_who_stands_stays_whole() -> None:
    show = TwoImages([WALKS, STANDS], masked(WALKS, STANDS))
    motion = show.ask(sieve())
    np.testing.assert_array_equal(motion.is_static, ~WALKS.on(show.now))
    # The map is made without anybody, moving or not.
    np.testing.assert_array_equal(motion.moving, show.semantics.movable)


def test_in_the_code_all_persons_go_when_one_walks() -> None:
    show = TwoImages([WALKS, STANDS], masked(WALKS, STANDS))
    motion = show.ask(sieve(segments="all"))
    np.testing.assert_array_equal(motion.is_static, ~(WALKS.on(show.now) | STANDS.on(show.now)))


def test_nobody_goes_when_nobody_walks() -> None:
    show = TwoImages([STANDS], masked(STANDS))
    assert show.ask(sieve(segments="all")).is_static.all()


def test_who_walks_along_the_lines_is_not_found() -> None:
    """The rule's blind side: lines are level here, and so is the walk."""
    sideways = replace(WALKS, dx=9, dy=0)
    assert TwoImages([sideways], masked(sideways)).ask(sieve()).is_static.all()


def test_what_is_not_masked_stays_even_where_it_moves() -> None:
    show = TwoImages([WALKS, STANDS], masked(STANDS))
    assert show.ask(sieve()).is_static.all()


def test_without_a_mask_nothing_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MovingConsistency, "_outliers_px", lambda *images: pytest.fail("points were followed"))
    motion = TwoImages([WALKS]).ask(sieve())
    assert motion.is_static.all()
    assert not motion.moving.any()


@pytest.mark.parametrize(("n", "moves"), [(2, False), (3, True)])
def test_so_many_outliers_are_enough(n: int, moves: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    at = np.array([[WALKS.x + 5.0 * k, WALKS.y + 50.0] for k in range(n)], dtype=np.float32)
    elsewhere = np.array([[320.0, 20.0], [330.0, 20.0], [340.0, 20.0]], dtype=np.float32)
    monkeypatch.setattr(MovingConsistency, "_outliers_px", lambda *images: np.concatenate((at, elsewhere)))
    show = TwoImages([WALKS], masked(WALKS))
    assert (~show.ask(sieve(min_outliers=3)).is_static).any() == moves


def test_without_a_last_image_everybody_moves() -> None:
    show = TwoImages([STANDS], masked(STANDS))
    np.testing.assert_array_equal(show.ask(sieve(), with_last=False).is_static, ~STANDS.on(show.now))


def test_a_plain_image_draws_no_lines_and_everybody_moves() -> None:
    show = TwoImages([STANDS], masked(STANDS))
    plain = np.full((HEIGHT, WIDTH), 90, dtype=np.uint8)
    show.last, show.now = frame_of(plain, 4), frame_of(plain, 5)
    np.testing.assert_array_equal(show.ask(sieve()).is_static, ~STANDS.on(show.now))


def test_a_segment_reaches_so_far_beyond_its_pixels() -> None:
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[100:200, 300:400] = mask[0:5, 0:5] = True
    thing = Instance.of(mask[90:], "person")  # a window whose corner is not that of the image
    thing = Instance.of(np.where(np.arange(HEIGHT)[:, None] > 50, mask, False), "person")
    edge = [[285, 150], [284, 150], [399 + 15, 199 + 15], [399 + 16, 199], [350, 84], [350, 85], [2, 2]]
    near = [True, False, True, False, False, True, False]
    for point, counts in zip(edge, near, strict=True):
        assert count_on(thing, np.array([point], dtype=np.float32), 15) == counts, point
    assert count_on(thing, np.array(edge, dtype=np.float32), 15) == sum(near)
    corner = Instance.of(np.where(np.arange(HEIGHT)[:, None] < 50, mask, False), "person")
    assert count_on(corner, np.array([[0, 0], [19, 19], [20, 0], [-1, -1]], dtype=np.float32), 15) == 3


def test_differences_are_summed_over_nine_pixels() -> None:
    first, second = texture(1), texture(2)
    first_px, second_px = np.array([[10.4, 20.6], [300, 200]], np.float32), np.array([[50, 60], [7.7, 9]], np.float32)
    expected = []
    for (x1, y1), (x2, y2) in zip(np.rint(first_px).astype(int), np.rint(second_px).astype(int), strict=True):
        one = first[y1 - 1 : y1 + 2, x1 - 1 : x1 + 2].astype(int)
        expected.append(np.abs(one - second[y2 - 1 : y2 + 2, x2 - 1 : x2 + 2]).sum())
    np.testing.assert_array_equal(differences(first, second, first_px, second_px), expected)


@pytest.mark.parametrize(("allowed", "stays"), [(8, False), (9, True)])
def test_points_that_look_different_are_dropped(allowed: int, stays: bool) -> None:
    """A lamp makes each of nine pixels brighter by one; where no points are left nothing draws lines."""
    show = TwoImages([STANDS], masked(STANDS))
    darker, brighter = (np.clip(gray, 0, 254) for gray in (show.last.image.gray, show.now.image.gray))
    show.last, show.now = frame_of(darker, 4), frame_of(brighter + np.uint8(1), 5)
    assert show.ask(sieve(max_difference=allowed)).is_static.all() == stays


def test_settings_are_checked() -> None:
    with pytest.raises(ConfigError, match=r"'segments' is 'some'; it must be one of own, all"):
        sieve(segments="some")
