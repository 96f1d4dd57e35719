"""The figures are people to a detector that was trained on photographs."""

import numpy as np
import pytest
from building import parts

from stillroom.data.semantics import Box
from stillroom.presets.registry import configure
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom_scenes.config import open_synthetic

OC_SLAM = configure("oc-slam")
LARGE = 0.05
"""Share of the image from which on a figure must be found."""


def overlap(one: Box, other: Box) -> float:
    (a, b, c, d), (e, f, g, h) = one.xyxy_px, other.xyxy_px
    shared = max(0.0, min(c, g) - max(a, e)) * max(0.0, min(d, h) - max(b, f))
    return shared / (one.area_px + other.area_px - shared)


@pytest.mark.parametrize(
    ("config", "spec"),
    [
        (YoloFastestConfig(), "synthetic:walking"),
        (YoloFastestConfig("1.1-xl"), "synthetic:walking"),
        (OC_SLAM.semantics, "synthetic:walking"),
        (YoloFastestConfig(), "synthetic:standing,seed=1"),
        (OC_SLAM.semantics, "synthetic:carried"),
        (OC_SLAM.semantics, "synthetic:walking,room=workshop,seed=1"),
    ],
)
def test_nine_of_ten_figures_are_found_at_the_papers_threshold(config: YoloFastestConfig, spec: str) -> None:
    room = open_synthetic(spec + ",cache=off")
    detector = config.build_detector(0.80, parts(room.camera))
    found = []
    for index in range(0, len(room), 9):
        image = room.load(index)
        assert image.truth is not None
        shown = np.bincount(room.truth(index).instance.ravel(), minlength=256) / image.rgb[..., 0].size
        people = [box for box in image.truth.boxes if box.label == "person" and shown[box.track_id] >= LARGE]
        boxes = detector.detect(image)
        found += [any(overlap(person, box) > 0.4 for box in boxes) for person in people]
    assert len(found) > 30
    assert np.mean(found) >= 0.9, f"{np.mean(found):.3f} of {len(found)}"
