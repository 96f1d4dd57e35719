"""The recipe of docs/add-a-segmenter.md: masks of instances in a folder, and DynaSLAM with them."""

import contextlib
import json
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from rgbd_folder import write_rgbd_folder

from stillroom.cli.main import main
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.semantics.mask_files import MaskFilesConfig

PAGE = (Path(__file__).parents[2] / "docs" / "add-a-segmenter.md").read_text(encoding="utf-8")
N_FRAMES = 30
PERSON, CHAIR = 1, 62  # COCO's ids


class Tensor:
    """As much of torch's as the program needs."""

    def __init__(self, values: Any) -> None:
        self.values = np.asarray(values)

    def __getitem__(self, key: Any) -> "Tensor":
        return Tensor(self.values[key])

    def __len__(self) -> int:
        return len(self.values)

    def __float__(self) -> float:
        return float(self.values)

    def __int__(self) -> int:
        return int(self.values)

    def __truediv__(self, by: float) -> "Tensor":
        return Tensor(self.values / by)

    def permute(self, *axes: int) -> "Tensor":
        return Tensor(self.values.transpose(axes))

    def numpy(self) -> Any:
        return self.values


class StandIn:
    """A network that finds an object of each colour of the first column, the first one most surely."""

    LABELS, SCORES = (PERSON, CHAIR, PERSON, PERSON), (0.9, 0.8, 0.7, 0.4)

    def eval(self) -> "StandIn":
        return self

    def __call__(self, images: list[Tensor]) -> list[dict[str, Tensor]]:
        (image,) = images
        assert image.values.shape == (3, 24, 32)
        assert 0.9 < image.values.max() <= 1.0
        masks = np.zeros((4, 1, 24, 32), np.float32)
        masks[0, 0, 2:12, 4:14], masks[1, 0, 0:5, 20:30] = 0.9, 0.9
        masks[2, 0, 6:20, 4:24], masks[3, 0, 20:, :] = 0.6, 0.9
        return [{"labels": Tensor(self.LABELS), "scores": Tensor(self.SCORES), "masks": Tensor(masks)}]


def test_the_program_writes_what_mask_files_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The network is a stand-in: what torchvision's returns, of two people and a chair."""
    torch, detection = ModuleType("torch"), ModuleType("torchvision.models.detection")
    torch.from_numpy, torch.inference_mode = Tensor, contextlib.nullcontext  # type: ignore[attr-defined]
    detection.maskrcnn_resnet50_fpn = lambda weights: StandIn()  # type: ignore[attr-defined]
    names = {"torch": torch, "torchvision": ModuleType("torchvision"), "torchvision.models": ModuleType("models")}
    for name, module in (names | {"torchvision.models.detection": detection}).items():
        monkeypatch.setitem(sys.modules, name, module)
    program = re.search(r'```python title="write_instances.py"\n(.*?)```', PAGE, re.DOTALL)
    assert program is not None
    (tmp_path / "rgb").mkdir()
    for index in range(2):
        cv2.imwrite(str(tmp_path / "rgb" / f"{index + 0.5:.6f}.png"), np.full((24, 32, 3), 250, np.uint8))
    monkeypatch.setattr(sys, "argv", ["write_instances.py", str(tmp_path / "rgb"), str(tmp_path / "masks")])
    exec(compile(program[1], "write_instances.py", "exec"), {"__name__": "__main__"})
    written = sorted((tmp_path / "masks").iterdir())
    assert [path.name for path in written] == ["0.500000.png", "1.500000.png"]
    numbers = cv2.imread(str(written[0]), cv2.IMREAD_UNCHANGED)
    assert numbers.dtype == np.uint16
    expected = np.zeros((24, 32), int)
    expected[6:20, 4:24], expected[2:12, 4:14] = 3, 1
    assert np.array_equal(numbers, expected)
    image = RgbdImage(0.5, np.zeros((24, 32, 3), np.uint8), np.zeros((24, 32), np.float32), 0)
    told = MaskFilesConfig(tmp_path / "masks", instances=True).build()(image)
    assert [one.area_px for one in told.instances] == [np.count_nonzero(expected == k) for k in (1, 3)]


def command(part: str) -> list[str]:
    """The words of the page's command with a part."""
    lines = re.sub(r"\\\n *", "", PAGE).splitlines()
    (found,) = [line for line in lines if line.startswith("stillroom run") and part in line]
    return shlex.split(found)[1:]


def test_dynaslam_runs_with_the_masks_of_the_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's command, on masks of the rendered truth, an object a figure."""
    room = open_dataset(f"synthetic:walking,frames={N_FRAMES},fps=10")
    monkeypatch.chdir(tmp_path)
    write_rgbd_folder(room, tmp_path / "SEQUENCE")
    (tmp_path / "my_masks").mkdir()
    n_objects = 0
    for place, path in enumerate(sorted((tmp_path / "SEQUENCE" / "rgb").iterdir())):
        truth = room.truth(place)
        numbers = np.where(truth.moving, truth.instance, 0).astype(np.uint16)
        n_objects = max(n_objects, len(np.unique(numbers)) - 1)
        cv2.imwrite(str(tmp_path / "my_masks" / path.name), numbers)
    assert n_objects >= 2
    with pytest.raises(SystemExit) as left:
        main([*command("semantics.instances=true"), "--pictures", "0", "--out", "results"])
    assert not left.value.code
    metrics = json.loads((tmp_path / "results" / "metrics.json").read_text())
    assert metrics["n_tracked"] == N_FRAMES
    assert metrics["as_given"]["ate_se3_m"]["rmse"] < 0.01
