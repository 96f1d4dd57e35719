"""PSPNet on ResNet-50 v1c at output stride 8, the paper's network, with the names of OpenMMLab's checkpoint.

v1c: three 3×3 convolutions in place of the stem's 7×7. Strides 1, 2, 1, 1 and dilations 1, 1, 2, 4 of the stages; the
first block of a dilated stage has the dilation of the stage before.
"""

from stillroom_train.pspnet.networks.steps import (
    AUXILIARY,
    IMAGE,
    LOGITS,
    RELU,
    Architecture,
    Concat,
    Conv,
    Drop,
    Enlarge,
    MaxPool,
    Pyramid,
    Step,
)

STAGES = ((64, 3, 1, 1), (128, 4, 2, 1), (256, 6, 1, 2), (512, 3, 1, 4))
"""Inner channels, blocks, stride of the first block, dilation."""

EXPANSION = 4
CLASSES = 21
LEVEL, AUXILIARY_HIDDEN = 512, 256
BINS = (1, 2, 3, 6)
IMAGENET_MEAN, IMAGENET_STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


def pspnet_resnet50() -> Architecture:
    """Return the network."""
    steps: list[Step] = []
    features, middle = _backbone(steps)
    _head(steps, features)
    hidden = _normed("auxiliary_head.convs.0", middle, "auxiliary/hidden", (1024, AUXILIARY_HIDDEN), 3)
    steps += [
        hidden,
        Drop(hidden.to, "auxiliary/kept", 0.1),
        Conv("auxiliary_head.conv_seg", "auxiliary/kept", AUXILIARY, (AUXILIARY_HIDDEN, CLASSES)),
    ]
    return Architecture("resnet50", tuple(steps), stride=8, corners=False, mean=IMAGENET_MEAN, std=IMAGENET_STD)


def _normed(name: str, source: str, to: str, channels: tuple[int, int], kernel: int = 1) -> Conv:
    """Return what OpenMMLab calls a ConvModule: convolution, batch norm, ReLU."""
    return Conv(f"{name}.conv", source, to, channels, kernel, norm=f"{name}.bn", bias=False, activation=RELU)


def _backbone(steps: list[Step]) -> tuple[str, str]:
    """Append the backbone; return the names of its last value (2048 channels) and of the third stage's (1024)."""
    value = IMAGE
    for place, channels, stride in ((0, (3, 32), 2), (3, (32, 32), 1), (6, (32, 64), 1)):
        name, norm = f"backbone.stem.{place}", f"backbone.stem.{place + 1}"
        steps.append(Conv(name, value, name, channels, 3, stride, norm=norm, bias=False, activation=RELU))
        value = name
    steps.append(MaxPool(value, "stem"))
    value, channels_in, stages = "stem", 64, []
    for number, (inner, repeats, first_stride, dilation) in enumerate(STAGES, start=1):
        for repeat in range(repeats):
            stride = first_stride if repeat == 0 else 1
            own_dilation = max(dilation // 2, 1) if repeat == 0 else dilation
            block = f"backbone.layer{number}.{repeat}"
            value = _bottleneck(steps, block, value, (channels_in, inner), stride, own_dilation)
            channels_in = inner * EXPANSION
        stages.append(value)
    return stages[3], stages[2]


def _bottleneck(
    steps: list[Step], block: str, source: str, channels: tuple[int, int], stride: int, dilation: int
) -> str:
    """Append a block of 1×1, 3×3 and 1×1 convolutions and the way past them; return the name of its value."""
    wide_in, inner = channels
    wide, plus = inner * EXPANSION, source
    if stride > 1 or wide_in != wide:
        plus, name = f"{block}/past", f"{block}.downsample.0"
        norm = f"{block}.downsample.1"
        steps.append(Conv(name, source, plus, (wide_in, wide), stride=stride, norm=norm, bias=False))
    sizes = ((wide_in, inner, 1, 1, 1), (inner, inner, 3, stride, dilation), (inner, wide, 1, 1, 1))
    value = source
    for number, (first, last, kernel, own_stride, own_dilation) in enumerate(sizes, start=1):
        name, to = f"{block}.conv{number}", f"{block}/{number}"
        steps.append(
            Conv(
                name, value, to, (first, last), kernel, own_stride, own_dilation,
                norm=f"{block}.bn{number}", bias=False, plus=plus if number == len(sizes) else "", activation=RELU,
            )
        )  # fmt: skip
        value = to
    return value


def _head(steps: list[Step], features: str) -> None:
    """Append pyramid pooling (Zhao et al., CVPR 2017) and the classifier."""
    beside = [features]
    for number, bins in enumerate(BINS):
        pooled, level, large = f"pyramid{bins}/mean", f"pyramid{bins}/level", f"pyramid{bins}"
        steps += [
            Pyramid(features, pooled, bins),
            _normed(f"decode_head.psp_modules.{number}.1", pooled, level, (2048, LEVEL)),
            Enlarge(level, features, large),
        ]
        beside.append(large)
    steps += [
        Concat(tuple(beside), "pyramid"),
        _normed("decode_head.bottleneck", "pyramid", "hidden", (2048 + len(BINS) * LEVEL, LEVEL), 3),
        Drop("hidden", "kept", 0.1),
        Conv("decode_head.conv_seg", "kept", LOGITS, (LEVEL, CLASSES)),
    ]
