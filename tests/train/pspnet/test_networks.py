"""The networks against what is known of them: parameters, shapes, and the names in OpenMMLab's checkpoint."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stillroom.errors import ConfigError, WeightsError
from stillroom_train.pspnet.networks.registry import architecture
from stillroom_train.pspnet.networks.starts import backbone_weights, deeplab_head, named_weights
from stillroom_train.pspnet.networks.steps import MaxPool, Pyramid
from stillroom_train.pspnet.recipe import PRESETS, fitting, preset

MOBILENET, RESNET = architecture("mobilenetv2"), architecture("resnet50")


def parameters(shapes: dict[str, tuple[int, ...]]) -> int:
    learnt = (shape for name, shape in shapes.items() if "running" not in name)
    return sum(int(np.prod(shape)) for shape in learnt)


def openmmlab() -> dict[str, tuple[int, ...]]:
    """Names and shapes in mmsegmentation's PSPNet-R50-D8 for VOC, written down from its modules."""
    shapes: dict[str, tuple[int, ...]] = {}

    def norm(name: str, channels: int) -> None:
        for key in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{name}.{key}"] = (channels,)

    # ResNetV1c: stem = Sequential(conv, norm, relu, conv, norm, relu, conv, norm, relu)
    for place, (channels_in, channels) in zip((0, 3, 6), ((3, 32), (32, 32), (32, 64)), strict=True):
        shapes[f"backbone.stem.{place}.weight"] = (channels, channels_in, 3, 3)
        norm(f"backbone.stem.{place + 1}", channels)
    channels_in = 64
    for layer, (width, blocks) in enumerate(((64, 3), (128, 4), (256, 6), (512, 3)), start=1):
        for block in range(blocks):
            at = f"backbone.layer{layer}.{block}"
            shapes[f"{at}.conv1.weight"] = (width, channels_in, 1, 1)
            shapes[f"{at}.conv2.weight"] = (width, width, 3, 3)
            shapes[f"{at}.conv3.weight"] = (4 * width, width, 1, 1)
            for number, channels in ((1, width), (2, width), (3, 4 * width)):
                norm(f"{at}.bn{number}", channels)
            if block == 0:
                shapes[f"{at}.downsample.0.weight"] = (4 * width, channels_in, 1, 1)
                norm(f"{at}.downsample.1", 4 * width)
            channels_in = 4 * width
    # PSPHead: psp_modules = ModuleList(Sequential(AdaptiveAvgPool2d, ConvModule)), bottleneck = ConvModule
    for level in range(4):
        shapes[f"decode_head.psp_modules.{level}.1.conv.weight"] = (512, 2048, 1, 1)
        norm(f"decode_head.psp_modules.{level}.1.bn", 512)
    shapes["decode_head.bottleneck.conv.weight"] = (512, 4096, 3, 3)
    norm("decode_head.bottleneck.bn", 512)
    shapes["decode_head.conv_seg.weight"], shapes["decode_head.conv_seg.bias"] = (21, 512, 1, 1), (21,)
    # FCNHead: convs = Sequential(ConvModule)
    shapes["auxiliary_head.convs.0.conv.weight"] = (256, 1024, 3, 3)
    norm("auxiliary_head.convs.0.bn", 256)
    shapes["auxiliary_head.conv_seg.weight"], shapes["auxiliary_head.conv_seg.bias"] = (21, 256, 1, 1), (21,)
    return shapes


def test_resnet_has_the_names_and_shapes_of_openmmlabs_checkpoint() -> None:
    assert RESNET.shapes() == openmmlab()


def test_resnet_has_as_many_parameters_as_the_papers_say() -> None:
    # He et al.: 23.5 million in ResNet-50 without its classifier, 25,557,032 with 2,049,000 for 1,000 classes; v1c has
    # three 3×3 convolutions (28,512 weights, 256 of norms) in place of one 7×7 (9,408 and 128).
    backbone = {name: shape for name, shape in RESNET.shapes().items() if name.startswith("backbone.")}
    assert parameters(backbone) == 25_557_032 - 2_049_000 - (9_408 + 128) + (28_512 + 256)


def test_mobilenet_is_the_light_one() -> None:
    learnt = parameters(MOBILENET.shapes(auxiliary=False))
    assert 2.4e6 < learnt < 2.8e6
    assert len([conv for conv in MOBILENET.convolutions if conv.name.startswith("backbone.")]) == 51


@pytest.mark.parametrize(("network", "stride"), [(MOBILENET, 16), (RESNET, 8)], ids=["mobilenetv2", "resnet50"])
def test_strides_and_dilations(network, stride: int) -> None:
    """A dilation takes the place of every stride that was taken out: the receptive field is that of stride 32."""
    reach = {"image": 1}
    for step in network.steps:
        before = getattr(step, "source", "")
        reach[step.to] = reach.get(before, 0) * getattr(step, "stride", 2 if isinstance(step, MaxPool) else 1)
    pooled = next(step.source for step in network.steps if isinstance(step, Pyramid))
    assert reach[pooled] == stride == network.stride
    dilations = [conv.dilation for conv in network.convolutions if conv.kernel == 3 and "backbone" in conv.name]
    if network is RESNET:  # stem, then 3, 4, 6 and 3 blocks
        assert dilations == [1] * 3 + [1] * 3 + [1] * 4 + [1] + [2] * 5 + [2] + [4] * 2
    else:
        assert dilations == [1] * 15 + [2] * 3


@pytest.mark.parametrize("name", PRESETS)
def test_crops_fit_the_scores_of_each_network(name: str) -> None:
    """Labels lie at 0, 4, 8 …; scores are enlarged to a fourth of what the features cover."""
    for network in (MOBILENET, RESNET):
        for side in {side for crop in fitting(preset(name), network).crops for side in crop}:
            features = -(-side // network.stride)
            times = network.stride // 4
            enlarged = (features - 1) * times + 1 if network.corners else features * times
            assert enlarged == -(-side // 4)
    assert fitting(preset(name), MOBILENET) == preset(name), "these sides fit already"
    assert fitting(preset("paper"), RESNET).crop == ("480x640",), "PSPNet-SLAM IV"


class Tensor:
    """What a checkpoint holds, without torch."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._values = np.full(shape, 0.5, np.float32)

    def detach(self) -> "Tensor":
        return self

    cpu = float = detach

    def numpy(self) -> np.ndarray:
        return self._values


def checkpoint(**changes: tuple[int, ...] | None) -> dict[str, object]:
    weights = {f"module.{name}": Tensor(shape) for name, shape in openmmlab().items()}
    weights["module.backbone.stem.1.num_batches_tracked"] = Tensor(())
    for name, shape in changes.items():
        weights.pop(f"module.{name}")
        if shape is not None:
            weights[f"module.{name}"] = Tensor(shape)
    return {"meta": {"CLASSES": ["background"]}, "state_dict": weights}


def test_openmmlabs_checkpoint_is_taken_over() -> None:
    found = named_weights(checkpoint(), RESNET, Path("r50.pth"))
    assert {name: value.shape for name, value in found.items()} == RESNET.shapes()
    headless = {k: v for k, v in checkpoint()["state_dict"].items() if "auxiliary" not in k}
    assert set(named_weights(headless, RESNET, Path("r50.pth"))) == set(RESNET.shapes(auxiliary=False))


@pytest.mark.parametrize(
    ("stored", "says"),
    [
        (lambda: checkpoint(**{"decode_head.conv_seg.weight": (19, 512, 1, 1)}), "is of shape (19, 512, 1, 1)"),
        (lambda: checkpoint(**{"backbone.layer3.5.bn2.weight": None}), "no weights 'backbone.layer3.5.bn2.weight'"),
        (lambda: [1, 2], "holds no weights by name"),
    ],
    ids=["shape", "absent", "list"],
)
def test_another_networks_checkpoint_is_told_in_one_line(stored: Callable[[], object], says: str) -> None:
    with pytest.raises(WeightsError) as told:
        named_weights(stored(), RESNET, Path("r50.pth"))
    assert says in str(told.value)
    assert str(told.value).startswith("r50.pth: ")
    assert "\n" not in str(told.value)


def test_the_backbone_and_the_teachers_head_fit(mobilenet_backbone: Path, deeplab: Path) -> None:
    backbone = backbone_weights(mobilenet_backbone, MOBILENET)
    assert set(backbone) == {name for name in MOBILENET.shapes() if name.startswith("backbone.")}
    head = deeplab_head(deeplab, MOBILENET)
    assert {name.split(".")[0] for name in head} == {"decode_head"}
    assert not head["decode_head.bottleneck.6.weight"].any()


def test_files_that_are_something_else(tmp_path: Path, mobilenet_backbone: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"no weights")
    for read in (backbone_weights, deeplab_head):
        with pytest.raises(WeightsError, match="cannot be read"):
            read(other, MOBILENET)
    with pytest.raises(WeightsError, match=r"backbone\.stem\.0\.weight"):
        backbone_weights(mobilenet_backbone, RESNET)


def test_unknown_backbone() -> None:
    with pytest.raises(ConfigError, match="mobilenetv2, resnet50"):
        architecture("vgg")
