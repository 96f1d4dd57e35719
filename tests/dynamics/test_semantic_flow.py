"""SOF-SLAM's rule: labels choose what draws the lines, and what is off its line is dynamic, whatever its label."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from building import parts
from sliding_tiles import HEIGHT, WIDTH, Patch, TwoImages, frame_of

from stillroom.data.frame import Frame
from stillroom.data.semantics import Semantics
from stillroom.dynamics.semantic_flow import SemanticFlow, SemanticFlowConfig

WALKS, STANDS = Patch(100, 120, dx=4, dy=6), Patch(400, 120)
RIM_PX = 12
"""Flow errs where two things meet."""


def labelled(people: Sequence[Patch] = (), chairs: Sequence[Patch] = ()) -> Semantics:
    mask = np.any([np.zeros((HEIGHT, WIDTH), np.bool_), *(thing.mask() for thing in people)], axis=0)
    return Semantics(HEIGHT, WIDTH, mask=mask, named=tuple(thing.chair for thing in chairs))


def sieve(**changes: object) -> SemanticFlow:
    return replace(SemanticFlowConfig(), **changes).build(parts())


def share(is_static: np.ndarray, thing: Patch, frame: Frame) -> float:
    """The share of the keypoints well within a thing that are static."""
    return float(is_static[thing.on(frame, RIM_PX)].mean())


def elsewhere(frame: Frame, *things: Patch) -> np.ndarray:
    near = [replace(t, x=t.x - 30, y=t.y - 30, width=t.width + 60, height=t.height + 60).on(frame) for t in things]
    return ~np.any(near, axis=0)


def test_geometry_decides_on_people_and_chairs_alike() -> None:
    for people, chairs in (([WALKS, STANDS], []), ([], [WALKS, STANDS]), ([STANDS], [WALKS]), ([WALKS], [STANDS])):
        show = TwoImages([WALKS, STANDS], labelled(people, chairs))
        is_static = show.ask(sieve()).is_static
        assert share(is_static, WALKS, show.now) == 0.0
        assert share(is_static, STANDS, show.now) == 1.0
        assert is_static[elsewhere(show.now, WALKS, STANDS)].mean() > 0.9


def test_lines_come_from_what_is_static_by_its_label() -> None:
    """A crowd goes up as one and fills most of the image: it must not draw the lines."""
    crowd = Patch(120, 7, 500, 473, dy=7)
    show = TwoImages([crowd], labelled([crowd]))
    is_static = show.ask(sieve()).is_static
    assert share(is_static, crowd, show.now) == 0.0
    left = show.now.keypoints.raw_px[:, 0] < 80
    assert is_static[left].mean() > 0.9
    # Without labels the crowd does draw them, and the room is what moves.
    misled = TwoImages([crowd]).ask(sieve()).is_static
    assert misled[crowd.on(show.now, RIM_PX)].mean() > 0.5


@pytest.mark.parametrize(("judged", "stays"), [("every", 0.0), ("labelled", 1.0)])
def test_what_has_no_label_is_judged_where_every_keypoint_is(judged: str, stays: float) -> None:
    show = TwoImages([WALKS, STANDS], labelled([STANDS]))
    assert share(show.ask(sieve(judged=judged)).is_static, WALKS, show.now) == stays


@pytest.mark.parametrize(("line_px", "stays"), [(1.5, 0.0), (2.5, 1.0)])
def test_off_the_line_is_further_than_so_many_pixels(line_px: float, stays: float) -> None:
    slow = Patch(100, 120, dy=2)
    show = TwoImages([slow], labelled([slow]))
    assert share(show.ask(sieve(line_px=line_px)).is_static, slow, show.now) == pytest.approx(stays, abs=0.05)


def test_without_lines_the_prior_decides() -> None:
    show = TwoImages([WALKS, STANDS], labelled([WALKS], [STANDS]))
    for motion in (show.ask(sieve(), with_last=False), _plain(show).ask(sieve())):
        np.testing.assert_array_equal(motion.is_static, ~WALKS.on(show.now))


def _plain(show: TwoImages) -> TwoImages:
    """The same where nothing can be seen that would draw lines."""
    blind = replace(show)
    everything = Patch(0, 0, WIDTH, HEIGHT)
    blind.semantics = replace(show.semantics, named=(everything.chair,))
    return blind


def test_on_the_mask_what_is_not_found_again_is_dynamic() -> None:
    """Who just came into the image stands where nothing was before."""
    came = Patch(0, 120, dx=200)
    show = TwoImages([], labelled([came]))
    now = show.now.image.gray.copy()
    now[came.window] = 128  # a plain shirt, on which flow finds no hold
    show.now = frame_of(now, 5)
    found = show.ask(sieve()).is_static[came.on(show.now, RIM_PX)]
    assert not found.any()


def test_pixels_are_the_mask_and_the_chairs_that_move() -> None:
    show = TwoImages([WALKS, STANDS], labelled([], [WALKS, STANDS]))
    np.testing.assert_array_equal(show.ask(sieve()).moving, WALKS.mask())
    show = TwoImages([WALKS, STANDS], labelled([STANDS], [WALKS]))
    np.testing.assert_array_equal(show.ask(sieve()).moving, WALKS.mask() | STANDS.mask())


def test_other_keypoints_of_the_same_image_are_judged_anew() -> None:
    show = TwoImages([WALKS], labelled([WALKS]))
    asked = sieve()
    first = show.ask(asked).is_static
    few = {name: getattr(show.now.keypoints, name)[::2] for name in vars(show.now.keypoints)}
    show.now = replace(
        show.now, keypoints=replace(show.now.keypoints, **few), is_static=np.ones(len(few["px"]), np.bool_)
    )
    np.testing.assert_array_equal(show.ask(asked).is_static, first[::2])
