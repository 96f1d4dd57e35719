"""The command line in this process, and a sequence on disk to damage."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_once import made_once

from stillroom.cli.main import main
from stillroom.data.trajectory import Trajectory
from stillroom.datasets.camera_file import write_camera
from stillroom.datasets.open import open_dataset

N_FRAMES = 24


@dataclass(frozen=True)
class Said:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def errors(self) -> list[str]:
        return [line for line in self.err.splitlines() if line.startswith("error: ")]

    @property
    def warnings(self) -> list[str]:
        return [line for line in self.err.splitlines() if line.startswith("warning: ")]


Command = Callable[..., Said]


@pytest.fixture
def stillroom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return what runs a command in an empty folder."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")

    def run(*arguments: object) -> Said:
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Said(int(left.value.code or 0), said.out, said.err)

    return run


@pytest.fixture(scope="session")
def _recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of an empty room, in the TUM layout."""
    return made_once(tmp_path_factory, "recorded", _record)


def _record(folder: Path) -> None:
    room = open_dataset("synthetic:empty")
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    lists: dict[str, list[str]] = {"rgb": [], "depth": []}
    for place in range(N_FRAMES):
        image = room.load(place)
        units = np.rint(image.depth_m * room.camera.depth_factor).astype(np.uint16)
        for name, pixels in (("rgb", cv2.cvtColor(image.rgb, cv2.COLOR_RGB2BGR)), ("depth", units)):
            file = f"{name}/{place:04d}.png"
            cv2.imwrite(str(folder / file), pixels)
            lists[name].append(f"{image.timestamp_s:.6f} {file}\n")
    for name, lines in lists.items():
        (folder / f"{name}.txt").write_text("".join(lines), encoding="utf-8")
    assert room.groundtruth is not None
    Trajectory(room.groundtruth.timestamps_s[:N_FRAMES], room.groundtruth.T_world_cam[:N_FRAMES]).write_tum(
        folder / "groundtruth.txt"
    )
    write_camera(room.camera, folder / "camera.toml")


@pytest.fixture
def recorded(_recorded: Path, tmp_path: Path) -> Path:
    """A copy of that sequence, to damage."""
    return shutil.copytree(_recorded, tmp_path / "room")
