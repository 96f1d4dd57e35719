"""A data set of another package: noise before a wall, with a red square that moves. `noise:12` has 12 images."""

import numpy as np

from stillroom.data.image import RgbdImage
from stillroom.datasets.kind import DatasetKind, SequenceRequest
from stillroom.datasets.recording import Recording
from stillroom.errors import DatasetError
from stillroom.geometry.camera import Camera
from stillroom.protocols import Dataset

LIST_NAME = "noise.txt"
RED = (220, 20, 30)
SIDE_PX, STEP_PX = 8, 2


class Noise(Recording):
    camera = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
    camera_source = "made up"

    def __init__(self, name: str, n_frames: int) -> None:
        self.name = name
        self.timestamps_s = np.arange(n_frames) / 30.0

    def load(self, index: int) -> RgbdImage:
        if not 0 <= index < len(self):
            raise IndexError(f"{self.name}: no image {index}; there are {len(self)}, from 0")
        rgb = np.random.default_rng(index).integers(0, 100, (48, 64, 3), dtype=np.uint8)
        depth_m = np.full((48, 64), 2.0, dtype=np.float32)
        square = np.s_[10 : 10 + SIDE_PX, STEP_PX * index : STEP_PX * index + SIDE_PX]
        rgb[square], depth_m[square] = RED, 1.5
        return RgbdImage(float(self.timestamps_s[index]), rgb, depth_m, index)


def recognises(asked: SequenceRequest) -> bool:
    return asked.prefix == "noise" or (asked.folder is not None and (asked.folder / LIST_NAME).is_file())


def open_noise(asked: SequenceRequest, camera: str | None, fps: float | None) -> Dataset:
    text = asked.text.partition(":")[2] if asked.folder is None else (asked.folder / LIST_NAME).read_text()
    if not text.strip().isdecimal() or int(text) == 0:
        raise DatasetError(f"{asked.text}: '{text.strip()}' is no number of images; write it like noise:12")
    return Noise(asked.name or f"noise_{int(text)}", int(text))


KIND = DatasetKind("noise", "noise with a red square: noise:12", recognises, open_noise)
