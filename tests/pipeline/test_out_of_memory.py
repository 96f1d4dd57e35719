"""Memory that gives out in a kernel, whichever call it is: one line, and all that was finished is written."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher
from rgbd_folder import write_rgbd_folder

from stillroom.cli.main import main
from stillroom.data.trajectory import Trajectory, read_tum
from stillroom.datasets.open import open_dataset
from stillroom.storage import load_map
from stillroom.storage.check import check_map

N_FRAMES = 5
OPTIONS = ("--method", "orb-slam2", "--pictures", "0", "--set", "keyframes.share=1", "--set", "keyframes.min_gap=0")


class Memory:
    """Counts the kernels that Python calls; some calls find no memory.

    Attributes:
        n_called: How many were called.
    """

    def __init__(self, first: float, last: float) -> None:
        self.first, self.last, self.n_called = first, last, 0

    @contextmanager
    def limited(self) -> Iterator["Memory"]:
        """Let the calls `first` to `last` fail, counted from 1."""
        honest = CPUDispatcher.__call__

        def called(kernel: Any, *given: Any, **named: Any) -> Any:
            self.n_called += 1
            if self.first <= self.n_called <= self.last:
                raise MemoryError("Allocation failed (probably too large).")
            return honest(kernel, *given, **named)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(CPUDispatcher, "__call__", called)
            yield self


def run(room: Path, folder: Path) -> int:
    with pytest.raises(SystemExit) as left:
        main(["run", str(room), *OPTIONS, "--map", str(folder / "room.stillmap"), "--out", str(folder / "out")])
    return int(left.value.code or 0)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "room"
    write_rgbd_folder(open_dataset(f"synthetic:empty,frames={N_FRAMES},fps=10"), folder)
    return folder


@pytest.fixture(scope="module")
def n_calls(room: Path, tmp_path_factory: pytest.TempPathFactory) -> int:
    """How many kernels a run calls that has all the memory it asks for."""
    assert run(room, tmp_path_factory.mktemp("first")) == 0  # calls more: what is made once is made now
    folder = tmp_path_factory.mktemp("whole")
    with Memory(np.inf, np.inf).limited() as memory:
        assert run(room, folder) == 0
    assert len(read_tum(folder / "out" / "trajectory.tum")) == N_FRAMES
    assert len(load_map(folder / "room.stillmap").world.keyframes) == N_FRAMES
    return memory.n_called


def assert_true(trajectory: Trajectory, n: int, room: Path) -> None:
    """A map that was left half changed must not have moved the frames that were done."""
    truth = read_tum(room / "groundtruth.txt").T_world_cam[:n]
    assert len(trajectory) == n
    aligned = truth[0] @ np.linalg.inv(trajectory.T_world_cam[0]) @ trajectory.T_world_cam
    assert np.abs(aligned[:, :3, 3] - truth[:, :3, 3]).max() < 0.05


@pytest.mark.parametrize("goes_on", [True, False], ids=["no more memory", "one call"])
@pytest.mark.parametrize("part", np.linspace(0.0, 1.0, 6).tolist())
def test_whichever_kernel_finds_none(
    part: float, goes_on: bool, room: Path, n_calls: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = 1 + round(part * (n_calls - 1))
    with Memory(first, np.inf if goes_on else first).limited():
        code = run(room, tmp_path)
    said = capsys.readouterr().err
    errors = [line for line in said.splitlines() if line.startswith("error: ")]
    assert code == 1
    assert "Traceback" not in said
    assert len(errors) == 1
    assert errors[0].endswith("[see troubleshooting: out-of-memory]")
    n_shown = said.count(f"/{N_FRAMES} ")  # frames that were done
    path = tmp_path / "room.stillmap"
    assert path.exists() == (n_shown > 0)  # an empty map would be in the way of the next try
    if n_shown > 0:
        assert check_map(path) == []
        # Every frame becomes a keyframe; that of the frame which was not finished may have been committed.
        assert len(load_map(path).world.keyframes) in (n_shown, n_shown + 1)
        assert_true(read_tum(tmp_path / "out" / "trajectory.tum"), n_shown, room)
        assert (tmp_path / "out" / "metrics.json").exists()
