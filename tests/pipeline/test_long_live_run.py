"""An hour and a half of a camera that goes back and forth: memory does not grow, and no thread is left."""

import threading
from pathlib import Path

import numpy as np
import pytest

from stillroom.config import SlamConfig
from stillroom.data.image import RgbdImage
from stillroom.data.result import FrameSummary
from stillroom.datasets.recording import DatasetView
from stillroom.evaluation.timing import PROCESS_STATUS
from stillroom.geometry.arrays import F64, I64
from stillroom.pipeline import RunOptions, run
from stillroom.presets.registry import configure
from stillroom.protocols import Dataset
from stillroom.schedule import LiveSchedule
from stillroom.semantics.truth import TrueSemanticsConfig

N_FRAMES = 60_000
BYTES_A_FRAME = 2_500
"""What is kept of every frame: its summary, the times of its stages and its delay."""
SLACK_MB = 40.0

pytestmark = pytest.mark.slow


class BackAndForth(DatasetView):
    """A sequence that is played forth and back again and again."""

    def __init__(self, inner: Dataset, n_frames: int) -> None:
        super().__init__(inner)
        self._images = [inner.load(place) for place in range(len(inner))]
        self._n_frames = n_frames

    def __len__(self) -> int:
        return self._n_frames

    @property
    def timestamps_s(self) -> F64:
        return np.arange(self._n_frames) / 30.0

    @property
    def numbers(self) -> I64:
        return np.arange(self._n_frames)

    @property
    def groundtruth(self) -> None:
        return None

    groundtruth_at_camera = groundtruth

    def load(self, index: int) -> RgbdImage:
        last = len(self._images) - 1
        place = last - abs(index % (2 * last) - last)
        image = self._images[place]
        return RgbdImage(index / 30.0, image.rgb, image.depth_m, index, truth=image.truth)


class Watching:
    """Reads the memory of the process now and then."""

    def __init__(self) -> None:
        self.mb: list[float] = []
        self._n_done = 0

    def start(self, n_frames: int | None) -> None:
        pass

    def frame(self, result: FrameSummary | None) -> None:
        self._n_done += 1
        if self._n_done % (N_FRAMES // 60) == 0:
            lines = PROCESS_STATUS.read_text(encoding="ascii").splitlines()
            self.mb += [int(line.split()[1]) * 1024e-6 for line in lines if line.startswith("VmRSS:")]

    def finish(self) -> None:
        pass


@pytest.mark.skipif(not PROCESS_STATUS.exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("method", ["oc-slam"])
def test_memory_is_flat(method: str, room: Dataset, tmp_path: Path) -> None:
    config: SlamConfig = configure(method, overrides=["semantics.kind=truth", "dense.max_memory_mb=64"])
    assert isinstance(config.semantics, TrueSemanticsConfig)
    watching = Watching()
    options = RunOptions(folder=tmp_path / "out", pictures=0, schedule=LiveSchedule(), speed=0.0)
    outcome = run(BackAndForth(room, N_FRAMES), config, options, watching)
    assert outcome.n_tracked == N_FRAMES
    third = len(watching.mb) // 3
    allowed_mb = SLACK_MB + BYTES_A_FRAME * N_FRAMES * 2 / 3 * 1e-6
    assert watching.mb[-1] - max(watching.mb[third - 2 : third]) < allowed_mb, watching.mb
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("stillroom-")]
