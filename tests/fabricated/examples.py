"""Pictures to learn from, made up: people are red."""

import numpy as np

from stillroom_train.pspnet.pictures.example import PEOPLE, Example

PERSON = 15


def example(
    kind: str, rgb: np.ndarray, person: np.ndarray | None = None, soft: np.ndarray | None = None, knows_all: bool = True
) -> Example:
    """A picture; where nothing is said, nobody is in it and all is background."""
    height, width = rgb.shape[:2]
    if person is None:
        person = np.zeros((height, width), np.uint8)
    if soft is None:
        soft = np.zeros((height // 8, width // 8, 21), np.float16)
        soft[..., 0] = 1.0
    return Example("made up", kind, rgb, person, soft, knows_all)


def people_example(seed: int = 0) -> Example:
    """Somebody red before a blue wall; the teacher saw nobody."""
    lot = np.random.default_rng(seed)
    rgb = np.zeros((120, 160, 3), np.uint8)
    rgb[..., 2] = 255
    person = np.zeros((120, 160), np.uint8)
    left = int(lot.integers(30, 90))
    person[20:110, left : left + 40] = 255
    rgb[person > 0] = 255, 0, 0
    return example(PEOPLE, rgb, person)
