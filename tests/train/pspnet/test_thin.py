"""Leaving out channels: what can be made up for goes without a trace, and the best of the rest stays."""

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from random_network import random_weights, run_onnx

from stillroom.errors import ConfigError, DatasetError
from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.export.network_file import onnx_model
from stillroom_train.pspnet.export.slim import slim
from stillroom_train.pspnet.export.spaces import DEPTHWISE, spaces, work_of
from stillroom_train.pspnet.export.thin import refit, removals, thin
from stillroom_train.pspnet.networks.registry import architecture
from stillroom_train.pspnet.pictures.inputs import seen_by


def noise(count: int = 6) -> Iterator[F32]:
    """At the network's coarsest 221 pixels each: together more than any convolution has channels."""
    lot = np.random.default_rng(0)
    for _ in range(count):
        yield lot.uniform(-1.0, 1.0, (1, 3, 193, 257)).astype(np.float32)


def test_copies_go_without_a_trace() -> None:
    """Each channel twice, and one that is always the same: half of them say it all."""
    lot = np.random.default_rng(1)
    single = lot.normal(size=(500, 7))
    x = np.column_stack([single, single, np.full(500, 3.0), np.ones(500)])
    read = lot.normal(size=(4, 16))
    gone, lost = removals(x.T @ x / 500, read, 8)
    stays = ~np.isin(np.arange(15), gone)
    assert not stays[14]
    assert np.all(stays[:7] != stays[7:14])
    assert lost[-1] < 1e-3 * (x @ read.T).var()
    refitted = refit(x.T @ x / 500, read, stays)
    np.testing.assert_allclose(x[:, np.append(stays, True)] @ refitted.T, x @ read.T, atol=5e-3)


def test_the_rest_is_refitted_as_least_squares_would_and_the_choice_is_nearly_the_best() -> None:
    lot = np.random.default_rng(2)
    x = np.column_stack([lot.normal(size=(400, 8)) @ lot.normal(size=(8, 8)), np.ones(400)])
    read = lot.normal(size=(3, 9))

    def best(columns: list[int]) -> tuple[np.ndarray, float]:
        found, *_ = np.linalg.lstsq(x[:, [*columns, 8]], x @ read.T, rcond=None)
        return found.T, float(((x[:, [*columns, 8]] @ found - x @ read.T) ** 2).sum())

    gone, lost = removals(x.T @ x / 400, read, 3)
    stays = ~np.isin(np.arange(8), gone)
    expected, error = best(np.flatnonzero(stays).tolist())
    np.testing.assert_allclose(refit(x.T @ x / 400, read, stays), expected, rtol=0.02, atol=0.02)
    assert lost[-1] == pytest.approx(error / 400, rel=0.05)
    errors = sorted(best(list(some))[1] for some in combinations(range(8), 5))
    assert error < 1.5 * errors[0]
    assert error < np.median(errors) / 2.0


def test_a_network_with_copied_channels_says_the_same_with_fewer() -> None:
    """Half the channels inside each block are copies of the other half: they are the first to go, nothing is lost."""
    network, weights = architecture("mobilenetv2"), random_weights("mobilenetv2")
    for conv in network.convolutions:
        if conv.to.endswith(("/wide", "/depthwise")) and conv.to != "block0/depthwise":
            for part in ("weight", "bias"):
                value = weights[f"{conv.name}.{part}"]
                value[len(value) // 2 :] = value[: len(value) // 2]
    image = next(noise(1))
    expected = run_onnx(onnx_model(network, weights, half=False), image)
    thinner, fewer = thin(network, weights, 0.3, noise())
    spared = 1.0 - sum(work_of(thinner).values()) / sum(work_of(slim(network, weights)[0]).values())
    assert 0.25 < spared < 0.35
    widths = {conv.to: conv.channels[1] for conv in thinner.convolutions}
    assert widths["block1"] == 24, "what blocks add to stays"
    assert all(width % 8 == 0 for value, width in widths.items() if value.endswith("/depthwise"))
    assert thinner.shapes(auxiliary=False).items() <= {name: value.shape for name, value in fewer.items()}.items()
    told = run_onnx(onnx_model(thinner, fewer, half=False), image)
    off = np.abs(told - expected)
    assert np.sqrt((off**2).mean()) < 0.02 * expected.std()
    assert off.max() < 0.05 * np.abs(expected).max()


def test_work_is_multiplications() -> None:
    network = architecture("mobilenetv2")
    work = work_of(network)
    assert work["stem"] == 3 * 3 * 3 * 32 / 4
    assert work["block1/wide"] == 16 * 96 / 4
    assert work["block16"] == 960 * 320 / 256
    assert work["around"] == DEPTHWISE * 9 * 256 / 256
    assert work["pyramid6/mixed"] == 0.0


def test_channels_that_cannot_go_alone_are_left_alone() -> None:
    """Of MobileNetV2 what blocks add to and what all levels are projected with; of a network with batch norm, all."""
    slimmed, _ = slim(architecture("mobilenetv2"), random_weights("mobilenetv2"))
    found = {space.value: space for space in spaces(slimmed)}
    assert "block2" not in found
    assert not any("decode_head.bins.2" in space.readers for space in found.values())
    head = found["around"]
    assert head.makers == tuple(f"decode_head.bottleneck.{part}" for part in (1, 2, 3, 6, "local"))
    assert (head.depthwise, head.readers) == (("decode_head.around",), ("decode_head.conv_seg",))
    assert spaces(architecture("resnet50")) == []


def test_impossible_shares_and_no_pictures_are_refused() -> None:
    network, weights = architecture("mobilenetv2"), random_weights("mobilenetv2")
    with pytest.raises(ConfigError, match=r"thin is 0\.9"):
        thin(network, weights, 0.9, noise())
    with pytest.raises(ConfigError, match=r"of resnet50 at most 0\.00 can be pruned, as its convolutions have batch"):
        thin(architecture("resnet50"), random_weights("resnet50"), 0.1, noise())
    with pytest.raises(DatasetError, match="--pictures"):
        thin(network, weights, 0.2, [])


def test_pictures_are_seen_as_the_network_would_see_them(tmp_path: Path) -> None:
    network = architecture("mobilenetv2")
    (tmp_path / "people" / "images").mkdir(parents=True)
    (tmp_path / "room" / "rgb").mkdir(parents=True)
    for number in range(5):
        cv2.imwrite(str(tmp_path / "people" / "images" / f"{number}.png"), np.full((48, 64, 3), 10 * number, np.uint8))
        cv2.imwrite(str(tmp_path / "room" / "rgb" / f"{number}.png"), np.full((48, 64, 3), 255, np.uint8))
    inputs = list(seen_by(network, [tmp_path / "people", tmp_path / "room"]))
    # Of 1, 2, 3 and 4 the first and the last (0 is held out), of the room 0 and 3.
    brightness = [round(float(image.mean()) * 127.5 + 127.5) for image in inputs]
    assert brightness == [10, 40, 255, 255]
    assert [image.shape for image in inputs] == [
        (1, 3, 481, 641), (1, 3, 385, 513), (1, 3, 481, 641), (1, 3, 241, 321),
    ]  # fmt: skip
