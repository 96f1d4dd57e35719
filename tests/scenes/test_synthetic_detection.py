"""The figures are people to a detector that was trained on photographs."""

import numpy as np
import pytest

from stillroom.data.semantics import Box
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom_scenes.config import open_synthetic

LARGE = 0.05
"""Share of the image from which on a figure must be found."""


def overlap(one: Box, other: Box) -> float:
    (a, b, c, d), (e, f, g, h) = one.xyxy_px, other.xyxy_px
    shared = max(0.0, min(c, g) - max(a, e)) * max(0.0, min(d, h) - max(b, f))
    return shared / (one.area_px + other.area_px - shared)


@pytest.mark.parametrize(
    ("variant", "spec"),
    [
        ("1.1", "synthetic:walking"),
        ("1.1-xl", "synthetic:walking"),
        ("1.1", "synthetic:standing,seed=1"),
        ("1.1", "synthetic:carried"),
        ("1.1", "synthetic:walking,room=workshop,seed=1"),
    ],
)
def test_nine_of_ten_figures_are_found_at_the_papers_threshold(variant: str, spec: str) -> None:
    detector = YoloFastestConfig(variant=variant).build_detector(0.80)
    room = open_synthetic(spec + ",cache=off")
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
