"""The contract of every `CameraStream`.

In a test of your own, with a stand-in for the device where there is none::

    from stillroom.testing.camera_contract import check_camera

    def test_my_camera():
        check_camera(lambda: MyCamera("..."))
"""

import threading
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from stillroom.data.image import Image
from stillroom.protocols import CameraStream
from stillroom.testing.dataset_contract import check_pixels


def check_camera(build: Callable[[], CameraStream], n_images: int = 5) -> list[Image]:
    """Check that a camera that works fulfils the contract.

    Args:
        build: Returns a camera, not entered yet.
        n_images: How many images are looked at, fewer where it ends before.

    Returns:
        These images, for further assertions.

    Raises:
        AssertionError: It does not; the message says which rule is broken, and where.
    """
    threads = set(threading.enumerate())
    stream = build()
    with stream as entered:
        assert entered is stream, "entering a camera must return the camera itself"
        _check_description(stream)
        images = _images(stream, n_images)
    left = set(threading.enumerate()) - threads
    assert not left, f"threads are left when the camera is left: {sorted(thread.name for thread in left)}"
    assert images, "a camera that works must deliver an image"
    for place, image in enumerate(images):
        check_pixels(stream.camera, place, image)
    assert [image.index for image in images] == list(range(len(images))), "images must be numbered from 0 as taken"
    times_s = np.array([image.timestamp_s for image in images])
    assert np.all(np.isfinite(times_s)), "a time is not finite"
    assert np.all(np.diff(times_s) > 0), "times must strictly increase"
    assert not any(
        np.shares_memory(a.rgb, b.rgb) or np.shares_memory(a.depth_m, b.depth_m) for a, b in pairwise(images)
    ), "two images share their memory; the next one would overwrite the one before"
    return images


def _check_description(stream: CameraStream) -> None:
    assert stream.name, "name is empty; the results folder is called by it"
    assert "/" not in stream.name, f"name '{stream.name}' has a slash; the results folder is called by it"
    assert stream.camera_source.strip(), "camera_source is empty; it must say where the calibration comes from"
    assert "\n" not in stream.camera_source, "camera_source has more than one line"
    assert stream.camera.width > 0, "the calibration must be known once the camera is entered"
    if stream.groundtruth_at_camera is not None:
        assert stream.groundtruth is not None, "groundtruth_at_camera without groundtruth; give it as groundtruth"


def _images(stream: CameraStream, n_images: int) -> list[Image]:
    """Return the first images; after the last one, None must come again and again."""
    images: list[Image] = []
    while len(images) < n_images:
        image = stream.next()
        if image is None:
            assert stream.next() is None, "an image came after the last one"
            break
        images.append(image)
    return images
