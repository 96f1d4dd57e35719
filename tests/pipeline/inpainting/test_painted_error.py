"""The PSNR of painted pixels."""

from pathlib import Path

import numpy as np
import pytest

from stillroom.datasets.open import open_dataset
from stillroom.datasets.selection import select
from stillroom.pipeline.inpainted_sequence import painted_error
from stillroom.testing.tiny_sequence import write_tiny_sequence

ROOM = "synthetic:walking,frames=12"


def test_it_is_that_of_the_painted_pixels_of_every_fifth_frame() -> None:
    error, empty = painted_error(open_dataset(ROOM)), open_dataset("synthetic:empty,frames=12")
    assert error is not None
    assert error.psnr_db is None
    rng = np.random.default_rng(0)
    differences = []
    for index in range(12):
        true = empty.load(index).rgb
        painted = np.clip(true.astype(int) + rng.integers(-9, 10, true.shape), 0, 255).astype(np.uint8)
        where = np.zeros(true.shape[:2], dtype=bool)
        where[50:90, 40 + index : 200] = True
        error.add(index, painted, where)
        if index in (0, 5, 10):
            differences.append((painted[where].astype(float) - true[where]).ravel())
    assert error.n_frames == 3
    assert error.n_pixels == sum(map(len, differences)) / 3
    rms = np.sqrt(np.mean(np.concatenate(differences) ** 2))
    assert error.psnr_db == pytest.approx(20 * np.log10(255 / rms))


def test_without_error_it_is_infinite_and_empty_frames_do_not_count() -> None:
    error = painted_error(select(open_dataset(ROOM), "3:9"))
    assert error is not None
    image = error.empty.load(5).rgb
    error.add(5, image, np.zeros(image.shape[:2], dtype=bool))
    assert error.n_frames == 0
    error.add(5, image, np.ones(image.shape[:2], dtype=bool))
    assert error.psnr_db == np.inf


@pytest.mark.parametrize("sequence", ["synthetic:carried", "synthetic:pushed", "synthetic:empty"])
def test_where_the_room_without_people_is_another_or_the_same_nothing_is_judged(sequence: str) -> None:
    assert painted_error(open_dataset(sequence)) is None


def test_where_the_truth_is_not_known_nothing_is_judged(tmp_path: Path) -> None:
    write_tiny_sequence(tmp_path)
    assert painted_error(open_dataset(str(tmp_path))) is None
