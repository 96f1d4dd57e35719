"""A network that sees keyframes only: which images reach it, and what becomes of what it finds."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Semantics, nothing
from stillroom.datasets.open import open_dataset
from stillroom.presets.registry import method
from stillroom.schedule import InOrder, LiveSchedule
from stillroom.system import System, build

FRAMES = 24


@dataclass
class LeftHalf:
    """A network that finds the left half of every keyframe potentially dynamic, and nothing in other images."""

    asked: list[int] = field(default_factory=list)
    saw: list[int] = field(default_factory=list)

    def __call__(self, image: RgbdImage) -> Semantics:
        self.asked.append(image.index)
        return nothing(image.height, image.width)

    def see(self, image: RgbdImage) -> Semantics:
        assert image.index in self.asked, "an image must be given before it is seen"
        self.saw.append(image.index)
        mask = np.zeros((image.height, image.width), dtype=np.bool_)
        mask[:, : image.width // 2] = True
        return Semantics(image.height, image.width, mask=mask)


def run(network: LeftHalf, live: bool) -> System:
    dataset = open_dataset(f"synthetic:walking,frames={FRAMES}")
    system = build(method("orb-slam2").config, dataset.camera, network, LiveSchedule() if live else InOrder())
    for image in dataset:
        system.process(image)
    system.close()
    return system


@pytest.mark.parametrize("live", [False, True])
def test_exactly_the_keyframes_reach_the_network(live: bool) -> None:
    network = LeftHalf()
    system = run(network, live)
    assert network.saw == [result.index for result in system.results if result.is_keyframe]
    assert 1 <= len(network.saw) < FRAMES
    assert network.asked == list(range(FRAMES))


def test_what_it_finds_in_a_keyframe_makes_no_points_and_keeps_no_matches() -> None:
    system = run(LeftHalf(), live=False)
    keypoints = system.map.keypoints
    for keyframe in system.map.alive_keyframes():
        rows = np.flatnonzero(keypoints.keyframe[: len(keypoints)] == keyframe)
        left = keypoints.px[rows, 0] < 318
        assert left.any()
        assert (system.map.points_of(int(keyframe))[left] < 0).all(), f"keyframe {keyframe} sees a masked point"
    assert len(system.map.alive_keyframes()) >= 1
