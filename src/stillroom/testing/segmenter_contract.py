"""The contract of every `Segmenter`.

In a test of your own::

    from stillroom.testing.segmenter_contract import check_segmenter

    def test_my_segmenter():
        check_segmenter(MySegmenter, images)  # anything that builds a fresh one, and a few consecutive images
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stillroom.data.image import Image
from stillroom.data.semantics import Box, Instance, Semantics
from stillroom.protocols import Segmenter


def check_segmenter(build: Callable[[], Segmenter], images: Sequence[Image]) -> list[Semantics]:
    """Check that a segmenter fulfils the contract.

    Args:
        build: Returns a new segmenter.
        images: Consecutive images of one size, in order; some of them should contain detections.

    Returns:
        Its results for the images, for further assertions.

    Raises:
        AssertionError: It does not; the message says which rule is broken, and where.
    """
    assert images, "no images to try it on"
    segmenter = build()
    answers: list[Semantics] = []
    copies: list[Semantics] = []
    for image in images:
        answers.append(_ask(segmenter, image))
        copies.append(_copied(answers[-1]))
    for image, answer, copy in zip(images, answers, copies, strict=True):
        _check_same(answer, copy, f"image {image.index}: the answer changed after it was given")
    fresh = build()
    for image, copy in zip(images, copies, strict=True):
        _check_same(_ask(fresh, image), copy, f"image {image.index}: a fresh segmenter answers otherwise")
    # A black image in the middle of a run, then normal ones.
    last = images[-1]
    for step, dark in enumerate((last.black(), last), start=1):
        _ask(segmenter, dark.at(last.index + step, last.timestamp_s + step / 30.0))
    _ask(build(), images[0].black())
    return answers


def _ask(segmenter: Segmenter, image: Image) -> Semantics:
    before = {name: channel.copy() for name, channel in image.channels.items()}
    answer = segmenter(image)
    where = f"image {image.index}"
    for name, channel in image.channels.items():
        assert np.array_equal(channel, before[name]), f"{where}: the segmenter changed {name} of the image it was given"
    assert isinstance(answer, Semantics), f"{where}: the answer is a {type(answer).__name__}, not Semantics"
    size = (image.height, image.width)
    assert (answer.height, answer.width) == size, f"{where}: semantics of {(answer.height, answer.width)}, not {size}"
    if answer.mask is not None:
        assert answer.mask.dtype == np.bool_, f"{where}: the mask is {answer.mask.dtype}, not bool"
        assert answer.mask.shape == size, f"{where}: the mask is {answer.mask.shape}, the image {size}"
    for box in (*answer.boxes, *answer.named):
        _check_box(box, image, where)
    for instance in answer.instances:
        _check_instance(instance, answer, image, where)
    return answer


def _check_box(box: Box, image: Image, where: str) -> None:
    x0, y0, x1, y1 = box.xyxy_px
    assert np.all(np.isfinite(box.xyxy_px)), f"{where}: an edge of {box} is not finite"
    assert x0 <= x1, f"{where}: {box} is turned inside out"
    assert y0 <= y1, f"{where}: {box} is turned inside out"
    in_image = x0 >= 0 and y0 >= 0 and x1 <= image.width - 1 and y1 <= image.height - 1
    assert in_image, f"{where}: {box} reaches beyond the image of {image.width}×{image.height}"
    assert isinstance(box.label, str), f"{where}: the label of {box} is no text"
    assert box.label, f"{where}: {box} has no label"
    assert 0.0 <= box.confidence <= 1.0, f"{where}: the confidence of {box} is not within 0 and 1"
    assert box.carried >= 0, f"{where}: {box} was last seen in the future"


def _check_instance(instance: Instance, answer: Semantics, image: Image, where: str) -> None:
    size = (image.height, image.width)
    assert isinstance(instance, Instance), f"{where}: an instance is a {type(instance).__name__}, not Instance"
    assert (instance.height, instance.width) == size, f"{where}: {instance} is of another image size than {size}"
    assert instance.pixels.dtype == np.bool_, f"{where}: the pixels of {instance} are {instance.pixels.dtype}, not bool"
    assert instance.pixels.ndim == 2, f"{where}: the pixels of {instance} are of shape {instance.pixels.shape}"
    _check_box(instance.box, image, where)
    pixels = instance.pixels
    is_tight = all(line.any() for line in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]))
    assert is_tight, f"{where}: {instance} is not cropped to its pixels, or has none; make it with Instance.of"
    if answer.mask is not None:
        covered = answer.mask[instance.window] | ~instance.pixels
        assert covered.all(), f"{where}: {instance} reaches beyond the mask, which must cover all instances"


def _check_same(answer: Semantics, expected: Semantics, problem: str) -> None:
    assert answer.boxes == expected.boxes, f"{problem}: boxes {answer.boxes} and {expected.boxes}"
    assert answer.named == expected.named, f"{problem}: named {answer.named} and {expected.named}"
    ours, theirs = ([_told(instance) for instance in said.instances] for said in (answer, expected))
    assert ours == theirs, f"{problem}: other instances, {answer.instances} and {expected.instances}"
    assert (answer.mask is None) == (expected.mask is None), f"{problem}: now a mask, now none"
    if answer.mask is not None and expected.mask is not None:
        assert np.array_equal(answer.mask, expected.mask), f"{problem}: another mask"


def _copied(answer: Semantics) -> Semantics:
    mask = None if answer.mask is None else answer.mask.copy()
    instances = tuple(replace(instance, pixels=instance.pixels.copy()) for instance in answer.instances)
    named = tuple(answer.named)
    return Semantics(answer.height, answer.width, tuple(answer.boxes), mask, named=named, instances=instances)


def _told(instance: Instance) -> tuple[object, ...]:
    """Return the fields of an instance, such that two can be compared."""
    return instance.label, instance.score, instance.track_id, instance.x_px, instance.y_px, instance.pixels.tolist()
