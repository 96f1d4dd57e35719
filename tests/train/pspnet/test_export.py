"""ONNX files against torch, for any size; and what the writer spares."""

from pathlib import Path

import numpy as np
import pytest
from random_network import random_weights, run_onnx

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.export.network_file import onnx_model, write_onnx
from stillroom_train.pspnet.export.slim import slim
from stillroom_train.pspnet.networks.registry import architecture

NO_TORCH = "torch is not installed; pip install 'stillroom[train]' to compare with it"


def run_torch(backbone: str, weights: dict[str, F32], image: F32) -> F32:
    torch = pytest.importorskip("torch", reason=NO_TORCH)
    from stillroom_train.pspnet.networks.torch_network import enlarged, torch_network

    network = torch_network(architecture(backbone))
    state = network.state_dict()
    state.update({name: torch.from_numpy(value.copy()) for name, value in weights.items()})
    network.load_state_dict(state)
    network.eval()
    with torch.no_grad():
        scores, auxiliary = network(torch.from_numpy(image))
        assert auxiliary is None
        return enlarged(scores, architecture(backbone)).numpy()


@pytest.mark.parametrize(
    ("backbone", "size"),
    [
        ("mobilenetv2", (97, 129)),
        ("mobilenetv2", (161, 65)),
        pytest.param("resnet50", (72, 104), marks=pytest.mark.slow),
    ],
)
def test_the_file_says_what_torch_says(backbone: str, size: tuple[int, int]) -> None:
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, *size)).astype(np.float32)
    weights = random_weights(backbone)
    expected = run_torch(backbone, weights, image)
    told = run_onnx(onnx_model(architecture(backbone), weights, half=False), image)
    assert told.shape == expected.shape
    assert np.ptp(expected) > 0.1, "nothing to compare"
    np.testing.assert_allclose(told, expected, atol=2e-3 * np.abs(expected).max())


def test_sixteen_bits_are_enough() -> None:
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, 97, 129)).astype(np.float32)
    weights = random_weights("mobilenetv2")
    network = architecture("mobilenetv2")
    full = run_onnx(onnx_model(network, weights, half=False), image)
    half = run_onnx(onnx_model(network, weights, half=True), image)
    assert 0 < np.abs(half - full).max() < 0.02 * np.abs(full).max()


def test_any_size_of_the_kind_is_taken() -> None:
    model = onnx_model(architecture("mobilenetv2"), random_weights("mobilenetv2"))
    for height, width in ((241, 321), (17, 33)):
        scores = run_onnx(model, np.zeros((1, 3, height, width), np.float32))
        assert scores.shape == (1, 21, (height - 1) // 4 + 1, (width - 1) // 4 + 1)


def test_what_is_spared_changes_nothing() -> None:
    network = architecture("mobilenetv2")
    weights = random_weights("mobilenetv2")
    weights["backbone.00.bias"][[3, 17]] = -100.0  # for no image above 0
    slimmed, fewer = slim(network, weights)
    stem = next(iter(slimmed.convolutions))
    assert stem.channels == (3, 30)
    assert fewer["backbone.00.weight"].shape == (30, 3, 3, 3)
    assert next(conv for conv in slimmed.convolutions if conv.name == "decode_head.local").channels == (960, 256)
    assert slimmed.shapes()["backbone.02.weight"] == fewer["backbone.02.weight"].shape
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, 97, 97)).astype(np.float32)
    expected = run_torch("mobilenetv2", weights, image)
    told = run_onnx(onnx_model(network, weights, half=False), image)
    np.testing.assert_allclose(told, expected, atol=2e-3 * np.abs(expected).max())


def test_a_file_is_written_whole_and_small(tmp_path: Path) -> None:
    file = tmp_path / "deep" / "net.onnx"
    write_onnx(file, architecture("mobilenetv2"), random_weights("mobilenetv2"), about={"steps": "7"})
    assert [path.name for path in file.parent.iterdir()] == ["net.onnx"]
    assert file.stat().st_size < 6e6
    import onnx

    model = onnx.load(file)
    assert {(entry.key, entry.value) for entry in model.metadata_props} >= {
        ("architecture", "mobilenetv2"), ("stride", "16"), ("corners", "1"), ("steps", "7"),
    }  # fmt: skip


def test_absent_weights_are_named() -> None:
    weights = random_weights("mobilenetv2")
    del weights["decode_head.bins.3.bias"]
    with pytest.raises(WeightsError, match=r"decode_head\.bins\.3\.bias"):
        onnx_model(architecture("mobilenetv2"), weights)
