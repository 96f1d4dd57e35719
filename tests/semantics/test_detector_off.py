"""Silencing a detector, the truth, and the segmenter of a still world."""

import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Semantics
from stillroom.errors import ConfigError
from stillroom.semantics.carried_boxes import CarryConfig
from stillroom.semantics.detector import withhold
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.semantics.truth import TrueSemanticsConfig

BOX = Box(20.0, 10.0, 60.0, 100.0, "person", 1.0)
RANGES = [(2, 4), (6, 7)]


def still(index, truth=True):
    rgb = np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    known = Semantics(120, 160, (BOX,), np.ones((120, 160), np.bool_))
    return RgbdImage(index / 30, rgb, np.ones((120, 160), np.float32), index, truth=known if truth else None)


def answers(segmenter):
    return [segmenter(still(index)) for index in range(8)]


def test_boxes_are_withheld_in_the_ranges_only():
    told = answers(withhold(TrueSemanticsConfig().build(), RANGES))
    assert [len(answer.boxes) for answer in told] == [1, 1, 0, 0, 1, 1, 0, 1]
    assert told[0].boxes == (BOX,)
    assert told[0].mask is None, "a detector tells boxes"


def test_masks_are_withheld_in_the_ranges_only():
    told = answers(withhold(TrueSemanticsConfig(masks=True).build(), RANGES))
    assert [answer.has_any for answer in told] == [True, True, False, False, True, True, False, True]
    assert told[0].mask is not None
    assert (told[2].height, told[2].width) == (120, 160)


def test_boxes_are_carried_on_while_the_detector_is_withheld():
    told = answers(withhold(TrueSemanticsConfig(carry=CarryConfig()).build(), RANGES))
    assert [box.carried for answer in told for box in answer.boxes] == [0, 0, 1, 2, 0, 0, 1, 0]


def test_no_range_withholds_nothing():
    assert all(answer.boxes == (BOX,) for answer in answers(withhold(TrueSemanticsConfig().build(), [])))


def test_withholding_takes_nothing_from_the_first_segmenter():
    first = TrueSemanticsConfig(carry=CarryConfig()).build()
    withhold(first, [(0, 100)])
    assert first(still(0)).boxes


@pytest.mark.parametrize("masks", [True, False])
def test_truth_needs_rendered_images(masks):
    with pytest.raises(ConfigError, match=r"image 3 has no ground truth.*rendered sequences only") as caught:
        TrueSemanticsConfig(masks=masks).build()(still(3, truth=False))
    assert "\n" not in str(caught.value)


def test_nothing_says_nothing():
    assert not any(answer.has_any for answer in answers(NothingConfig().build()))
