"""Images of keyframes: depth comes back exactly, without what moved."""

from pathlib import Path

import numpy as np
import pytest
from random_map import EventfulLife, session
from small_world import CAMERA

from stillroom.data.image import RgbdImage
from stillroom.errors import MapError
from stillroom.storage.pictures import Pictures, compress, restore
from stillroom.storage.reader import count_images, keyframe_images
from stillroom.storage.writer import MapWriter


def picture(seed: int = 0, index: int = 7) -> RgbdImage:
    """An image with depth in whole units, as a sensor gives it."""
    rng = np.random.default_rng(seed)
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[:, :, 0], rgb[:, :, 2] = np.arange(64) * 3, 200
    units = rng.integers(0, 40000, (48, 64)).astype(np.uint16)
    units[:5] = 0
    return RgbdImage(12.5, rgb, (units / 5000.0).astype(np.float32), index)


def test_depth_is_exact_and_colours_are_close() -> None:
    image, moving = picture(), np.zeros((48, 64), np.bool_)
    again = restore(compress(3, image, moving, 5000.0), 7, 12.5, 5000.0)
    assert np.array_equal(again.depth_m, image.depth_m)
    assert again.depth_m.dtype == np.float32
    assert np.abs(again.rgb.astype(int) - image.rgb.astype(int)).mean() < 3
    assert (again.index, again.timestamp_s) == (7, 12.5)


def test_what_moves_has_no_depth() -> None:
    image, moving = picture(), np.zeros((48, 64), np.bool_)
    moving[10:20, 30:40] = True
    again = restore(compress(3, image, moving, 5000.0), 7, 12.5, 5000.0)
    assert not again.depth_m[moving].any()
    assert np.array_equal(again.depth_m[~moving], image.depth_m[~moving])


def test_depth_beyond_sixteen_bits_is_unknown_not_wrong() -> None:
    depth_m = np.full((4, 5), 2.0, np.float32)
    depth_m[1, 2] = 14.0
    image = RgbdImage(0.0, np.zeros((4, 5, 3), np.uint8), depth_m, 0)
    again = restore(compress(0, image, np.zeros((4, 5), np.bool_), 5000.0), 0, 0.0, 5000.0)
    assert again.depth_m[1, 2] == 0
    assert (again.depth_m == 2.0).sum() == 19


def test_pictures_that_cannot_be_decoded_are_said() -> None:
    with pytest.raises(MapError, match="images of keyframe 4 cannot be decoded"):
        restore(Pictures(4, b"no png", b"no jpeg"), 0, 0.0, 5000.0)


def test_a_file_gives_the_images_of_its_keyframes(tmp_path: Path) -> None:
    life, path = EventfulLife(0), tmp_path / "room.stillmap"
    none_moves = np.zeros((48, 64), np.bool_)
    with MapWriter.create(path, life.world, CAMERA) as writer:
        writer.begin(session())
        writer.commit()
        assert len(life.world.keyframes) == 5
        for keyframe in (2, 0):
            life.add_keyframe()
            writer.commit(pictures=compress(keyframe, picture(keyframe), none_moves, CAMERA.depth_factor))
    assert count_images(path) == 2
    found = dict(keyframe_images(path))
    assert list(found) == [0, 2]
    for keyframe, image in found.items():
        assert np.array_equal(image.depth_m, picture(keyframe).depth_m)
        assert image.timestamp_s == life.world.keyframes.timestamp_s[keyframe]
        assert image.index == life.world.keyframes.image_index[keyframe]
