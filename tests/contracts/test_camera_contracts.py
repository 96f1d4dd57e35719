"""The contract of cameras notices when one does not keep it. Those of the house are in `tests/cameras/`."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np
import pytest

from stillroom.cameras.replay import ReplayCamera
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.protocols import CameraStream
from stillroom.testing.camera_contract import check_camera
from stillroom.testing.tiny_sequence import write_tiny_sequence


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    write_tiny_sequence(tmp_path / "tiny")
    return tmp_path / "tiny"


def test_fewer_images_than_asked_for_are_enough(tiny: Path) -> None:
    assert len(check_camera(lambda: ReplayCamera(open_dataset(str(tiny))), 99)) == 6


class Changed(ReplayCamera):
    """A camera whose images are changed on their way."""

    def __init__(self, folder: Path, change: Callable[[RgbdImage], RgbdImage | None]) -> None:
        super().__init__(open_dataset(str(folder)))
        self._change = change

    def next(self) -> RgbdImage | None:
        image = super().next()
        return None if image is None else self._change(image)


BUFFER = np.zeros((48, 64, 3), dtype=np.uint8)


def in_one_buffer(image: RgbdImage) -> RgbdImage:
    BUFFER[:] = image.rgb
    return replace(image, rgb=BUFFER)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda image: None, "must deliver an image"),
        (lambda image: replace(image, index=image.index + 1), "numbered from 0 as taken"),
        (lambda image: replace(image, timestamp_s=-image.timestamp_s), "times must strictly increase"),
        (lambda image: replace(image, timestamp_s=np.nan), "time is not finite"),
        (lambda image: replace(image, depth_m=image.depth_m * 1000), "median depth"),
        (lambda image: replace(image, depth_m=image.depth_m.astype(np.float64)), "depth_m is float64"),
        (lambda image: replace(image, rgb=image.rgb[::-1]), "not contiguous"),
        (lambda image: replace(image, rgb=image.rgb[:-1].copy()), "rgb is"),
        (in_one_buffer, "share their memory"),
    ],
)
def test_bad_images_are_noticed(tiny: Path, change: Callable[[RgbdImage], RgbdImage | None], rule: str) -> None:
    with pytest.raises(AssertionError, match=rule):
        check_camera(lambda: Changed(tiny, change))


class LeavesThread(ReplayCamera):
    """A camera whose thread goes on when it is left."""

    end = threading.Event()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        threading.Thread(target=self.end.wait, name="forgotten").start()


def test_a_thread_that_is_left_is_noticed(tiny: Path) -> None:
    try:
        with pytest.raises(AssertionError, match=r"threads are left .*forgotten"):
            check_camera(lambda: LeavesThread(open_dataset(str(tiny))))
    finally:
        LeavesThread.end.set()


class Nameless(ReplayCamera):
    name = ""  # type: ignore[assignment]


class Endless(ReplayCamera):
    """A camera that goes on after its end."""

    def next(self) -> RgbdImage | None:
        image = super().next()
        if image is None:
            self.__enter__()
        return image


@pytest.mark.parametrize(("camera", "rule"), [(Nameless, "name is empty"), (Endless, "after the last one")])
def test_bad_behaviour_is_noticed(tiny: Path, camera: type[ReplayCamera], rule: str) -> None:
    def build() -> CameraStream:
        return camera(open_dataset(str(tiny)))

    with pytest.raises(AssertionError, match=rule):
        check_camera(build, 99)
