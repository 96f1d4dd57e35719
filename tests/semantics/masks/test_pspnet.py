"""PSPNet in the semantics socket: where its answer lies in the image, and what the shipped weights know."""

import subprocess
import sys
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest
from red_network import save_red_network

from stillroom.config import SlamConfig, with_overrides
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError, WeightsError
from stillroom.presets.registry import configure
from stillroom.semantics.masks.pspnet import SHIPPED, PspNetConfig
from stillroom.semantics.masks.refine import RefineConfig
from stillroom.semantics.masks.regions import RegionsConfig
from stillroom.testing.segmenter_contract import check_segmenter
from stillroom_train.pspnet.evaluate import called_person, overlap
from stillroom_train.pspnet.export.graph import Graph
from stillroom_train.pspnet.pictures.example import images_in, read_rgb
from stillroom_train.pspnet.pictures.gather import PERSON, held_out
from stillroom_train.pspnet.train import segmenting

NETWORK_ALONE = {"refine": RefineConfig(enabled=False), "regions": RegionsConfig(min_px=0, dilate_px=0)}


def save_red_pspnet(path: Path, corners: bool) -> Path:
    """A network that calls red a person, with the output of `stillroom export pspnet`: a fourth of the size."""
    graph = Graph(half=False)
    weight = np.zeros((21, 3, 1, 1), np.float32)
    weight[PERSON] = np.array([0.05, -0.05, 0.0]).reshape(3, 1, 1)
    # Corners: pixels 0, 4, 8 … as they are. Otherwise the mean of 4 × 4.
    kernel, stride = (1, 4) if corners else (4, 4)
    spread = np.repeat(np.repeat(weight / kernel**2, kernel, axis=2), kernel, axis=3)
    graph.add("Conv", ["image", graph.weight("w", spread)], "logits", kernel_shape=[kernel] * 2, strides=[stride] * 2)
    about = {"stride": "16" if corners else "8", "corners": "1" if corners else "0", "mean": "0 0 0", "std": "1 1 1"}
    path.write_bytes(graph.model("image", {"logits": 21}, about).SerializeToString())
    return path


@pytest.mark.parametrize("corners", [True, False], ids=["corners", "parts"])
@pytest.mark.parametrize("size", ["640x480", "320x240"])
@pytest.mark.parametrize("image_px", [(480, 640), (240, 320), (360, 640)], ids=str)
def test_the_answer_lies_where_the_thing_is(corners: bool, size: str, image_px, tmp_path: Path) -> None:
    """A red ramp: its half-way line is known to a fraction of a pixel."""
    height, width = image_px
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[..., 0] = np.clip((np.arange(width) - 0.5 * width + 32) * 4, 0, 255)
    network = PspNetConfig(model=save_red_pspnet(tmp_path / "red.onnx", corners), input=size).build().reading.network
    told = network.probabilities(rgb, width // 2, height // 2)[0]
    assert told.shape == (height // 2, width // 2)
    # probability of one of 21 classes: e^s / (e^s + 20), s = 0.05 red
    true = np.exp(0.05 * rgb[0, :, 0].astype(np.float64))
    true = true / (true + 20.0)
    at = np.interp(2.0 * np.arange(width // 2) + 0.5, np.arange(width), true)
    column = int(np.searchsorted(told[height // 4], 0.5))
    expected = int(np.searchsorted(at, 0.5))
    assert abs(column - expected) <= (1 if size == "640x480" else 2)
    np.testing.assert_allclose(told[height // 4, 8:-8], at[8:-8], atol=0.12)
    assert np.ptp(told, axis=0).max() < 1e-3


@pytest.mark.parametrize("color", [(200, 190, 170), (120, 160, 200), (60, 60, 60)], ids=str)
def test_the_shipped_network_finds_nobody_on_a_wall(color: tuple[int, int, int]) -> None:
    """Lit from a side, with a sensor's noise."""
    light = np.linspace(0.7, 1.1, 640)[None, :, None] * np.array(color)
    noisy = np.repeat(light, 480, axis=0) + np.random.default_rng(0).normal(0.0, 3.0, (480, 640, 3))
    wall = RgbdImage(0.0, np.clip(noisy, 0, 255).astype(np.uint8), np.ones((480, 640), np.float32), 0)
    assert not configure("pspnet-slam").semantics.build()(wall).has_any


def test_it_plugs_in_by_name() -> None:
    config = with_overrides(SlamConfig(), ["semantics.kind=pspnet", "semantics.input=320x240", "semantics.every=3"])
    assert config.semantics == PspNetConfig(input="320x240", every=3)


@pytest.mark.parametrize(
    ("config", "says"),
    [
        (PspNetConfig(input="512x512"), "640x480"),
        (PspNetConfig(movable=("persn",)), "did you mean 'person'"),
        (PspNetConfig(every=0), "every' is 0"),
    ],
)
def test_wrong_values_are_told(config: PspNetConfig, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        config.build()


def test_another_network_is_told_where_it_plugs_in(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"semantics\.kind=onnx-masks"):
        PspNetConfig(model=save_red_network(tmp_path / "red.onnx")).build()
    with pytest.raises(WeightsError, match="no such network"):
        PspNetConfig(model=tmp_path / "absent.onnx").build()


def test_the_weights_come_with_the_package_and_a_card() -> None:
    weights = files("stillroom.semantics") / "weights"
    assert len((weights / SHIPPED).read_bytes()) < 10e6
    card = (weights / SHIPPED.replace(".onnx", ".md")).read_text(encoding="utf-8")
    for word in ("Apache-2.0", "research", "person_masks", "280", "held out", "Known failures"):
        assert word in card


def test_neither_torch_nor_onnx_is_needed() -> None:
    """What segments and tracks must not import what only trains, even where it is installed."""
    code = (
        "import sys; sys.modules['torch'] = None; sys.modules['onnx'] = None\n"
        "import numpy as np\n"
        "from stillroom.data.image import RgbdImage\n"
        "from stillroom.presets.registry import configure\n"
        "image = RgbdImage(0.0, np.zeros((240, 320, 3), np.uint8), np.ones((240, 320), np.float32))\n"
        "assert not configure('pspnet-slam').semantics.build()(image).has_any\n"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr


@pytest.fixture(scope="module")
def shipped() -> Callable:
    return segmenting(None, 640)


def test_people_who_were_held_out_are_found(shipped: Callable, person_masks: Path) -> None:
    found = overlap(shipped, held_out(person_masks))
    assert found.pictures == 74
    assert found.mean >= 0.87
    assert found.total >= 0.89


def test_an_empty_room_stays_empty(shipped: Callable, bonn: Path) -> None:
    frames = images_in(bonn / "rgb")[0:200:4]
    assert len(frames) == 50
    assert called_person(shipped, map(read_rgb, frames)) < 0.002


def test_a_cat_is_no_person(shipped: Callable) -> None:
    skimage = pytest.importorskip("skimage", reason="scikit-image is not installed; it brings the picture of a cat")
    cat = read_rgb(Path(skimage.__file__).parent / "data" / "chelsea.png")
    for seen in (cat, cat[:, ::-1].copy(), cv2.resize(cat, None, fx=0.5, fy=0.5), cat[:, :300].copy()):
        assert shipped(seen).mean() < 0.01


def test_the_contract_on_real_frames(bonn: Path) -> None:
    sequence = open_dataset(str(bonn))
    images = [sequence.load(place) for place in range(300, 304)]
    answers = check_segmenter(configure("pspnet-slam").semantics.build, images)
    assert all(0.2 < answer.mask.mean() < 0.7 for answer in answers)  # two people near the camera
    sharp = PspNetConfig(**NETWORK_ALONE).build()(images[0])
    assert (sharp.mask != answers[0].mask).mean() < 0.08
