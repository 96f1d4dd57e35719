"""A detector that sees keyframes only: which images reach it, and that nothing is detected twice."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError
from stillroom.presets.registry import configure, method
from stillroom.protocols import KeyframeSegmenter
from stillroom.semantics.detector import withhold
from stillroom.semantics.keyframe_boxes import KeyframeBoxes
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.system import build
from stillroom.testing.segmenter_contract import check_segmenter

BOX = Box(20.0, 10.0, 60.0, 100.0, "person", 0.9)


@dataclass
class Recorder:
    """A detector that finds one box in every image."""

    saw: list[int] = field(default_factory=list)

    def detect(self, image: RgbdImage) -> tuple[Box, ...]:
        self.saw.append(image.index)
        return (BOX,)


def plain(index: int) -> RgbdImage:
    return RgbdImage(index / 30.0, np.full((120, 160, 3), 90, np.uint8), np.ones((120, 160), np.float32), index)


def test_the_first_image_is_seen_at_once_and_only_once() -> None:
    detector = Recorder()
    segmenter, images = KeyframeBoxes(detector), [plain(index) for index in range(3)]
    found = [segmenter(image).boxes for image in images[:2]]
    assert found == [(BOX,), ()]
    assert segmenter.see(images[0]).boxes == (BOX,)
    assert detector.saw == [0]
    assert segmenter.see(images[1]).boxes == (BOX,)
    assert detector.saw == [0, 1]
    assert not segmenter(images[2]).has_any


def test_a_first_keyframe_that_is_not_the_first_image_is_seen() -> None:
    detector = Recorder()
    segmenter, images = KeyframeBoxes(detector), [plain(index) for index in range(2)]
    for image in images:
        segmenter(image)
    segmenter.see(images[1])
    assert detector.saw == [0, 1]


def test_classes_that_people_move_are_told_apart() -> None:
    known = KeyframeBoxes(Recorder(), named=("person",))(plain(0))
    assert (known.boxes, known.named) == ((), (BOX,))


def test_it_keeps_the_contract() -> None:
    check_segmenter(lambda: KeyframeBoxes(Recorder()), [plain(index) for index in range(4)])


def test_a_detector_can_be_withheld_at_keyframes_too() -> None:
    segmenter = withhold(KeyframeBoxes(Recorder()), [(2, 4)])
    assert isinstance(segmenter, KeyframeSegmenter)
    assert [bool(segmenter.see(plain(index)).boxes) for index in range(5)] == [True, True, False, False, True]


def test_it_is_a_choice_of_yolo_fastest_and_off_by_default() -> None:
    assert not isinstance(YoloFastestConfig().build(), KeyframeSegmenter)
    assert isinstance(YoloFastestConfig(sees="keyframes").build(), KeyframeBoxes)
    assert isinstance(method("detect-slam").config.semantics.build(), KeyframeBoxes)
    with pytest.raises(ConfigError, match=r"'semantics\.sees' is 'frames'; it must be one of images, keyframes"):
        configure("detect-slam", overrides=["semantics.sees=frames"])


def test_in_a_run_only_keyframes_reach_the_detector() -> None:
    dataset, detector = open_dataset("synthetic:walking,frames=24"), Recorder()
    system = build(replace(method("detect-slam").config), dataset.camera, KeyframeBoxes(detector))
    for image in dataset:
        system.process(image)
    system.close()
    assert detector.saw == [result.index for result in system.results if result.is_keyframe]
    assert 1 < len(detector.saw) < 24
