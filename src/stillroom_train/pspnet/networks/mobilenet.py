"""PSPNet on MobileNetV2 (Sandler et al., CVPR 2018) at output stride 16: the one that runs live on a CPU."""

from stillroom_train.pspnet.networks.steps import (
    AUXILIARY,
    IMAGE,
    LOGITS,
    RELU6,
    Add,
    Architecture,
    Conv,
    Drop,
    Enlarge,
    Pyramid,
    Step,
)

STAGES = ((1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 1), (6, 320, 1, 1))
"""Expansion, channels, blocks, stride of the first block. The stage of 160 keeps its size: output stride 16."""

FIRST_DILATED = 14
"""Block from which on the convolutions are dilated by 2, as the stride that was taken out would have done."""

AUXILIARY_BLOCK = 12
"""The auxiliary loss looks at this block's output (96 channels)."""

CLASSES = 21
LEVEL, HIDDEN, AUXILIARY_HIDDEN = 256, 256, 64
BINS = (1, 2, 3, 6)


def pspnet_mobilenetv2() -> Architecture:
    """Return the network; its batch norms are folded into the convolutions, as in the backbone that it starts from."""
    steps: list[Step] = []
    features, middle = _backbone(steps)
    _head(steps, features)
    hidden = Conv("auxiliary_head.conv", middle, "auxiliary/hidden", (96, AUXILIARY_HIDDEN), 3, activation=RELU6)
    steps += [hidden, Conv("auxiliary_head.conv_seg", hidden.to, AUXILIARY, (AUXILIARY_HIDDEN, CLASSES))]
    half = (127.5, 127.5, 127.5)
    return Architecture("mobilenetv2", tuple(steps), stride=16, corners=True, mean=half, std=half)


def _backbone(steps: list[Step]) -> tuple[str, str]:
    """Append the backbone; return the names of its last value (320 channels) and of the middle one (96)."""
    names = (f"backbone.{number:02d}" for number in range(100))
    stem = Conv(next(names), IMAGE, "stem", (3, 32), 3, stride=2, activation=RELU6)
    steps.append(stem)
    value, channels, block, middle = stem.to, 32, 0, ""
    for expansion, wide, repeats, first_stride in STAGES:
        for repeat in range(repeats):
            stride = first_stride if repeat == 0 else 1
            dilation = 2 if block >= FIRST_DILATED else 1
            inner, source = channels * expansion, value
            if expansion > 1:
                steps.append(Conv(next(names), value, f"block{block}/wide", (channels, inner), activation=RELU6))
                value = f"block{block}/wide"
            depthwise = f"block{block}/depthwise"
            steps.append(
                Conv(next(names), value, depthwise, (inner, inner), 3, stride, dilation, inner, activation=RELU6)
            )
            plus = source if stride == 1 and channels == wide else ""
            value = f"block{block}"
            steps.append(Conv(next(names), depthwise, value, (inner, wide), plus=plus))
            middle = value if block == AUXILIARY_BLOCK else middle
            channels, block = wide, block + 1
    return value, middle


def _head(steps: list[Step], features: str) -> None:
    """Append pyramid pooling (Zhao et al., CVPR 2017) and the classifier.

    The 1×1 convolution that follows the pyramid is written level by level: a level is convolved at its own size, then
    enlarged and added. Enlarging is linear and keeps constants, so that the numbers are those of enlarging all levels,
    putting them beside each other and convolving that, at a fraction of the cost.

    Differs from the paper: the features go through a 1×1 convolution of their own before they meet the pyramid, and the
    3×3 convolution is depthwise. DeepLabv3's head without atrous branches is a special case of it (levels 2, 3 and 6
    count for nothing, the depthwise convolution is idle), so that learning can start where a trained head stands.
    """
    steps.append(Conv("decode_head.local", features, "local", (320, LEVEL), activation=RELU6))
    for bins in BINS:
        mean, level, mixed, large = (f"pyramid{bins}/{part}" for part in ("mean", "level", "mixed", "large"))
        steps += [
            Pyramid(features, mean, bins),
            Conv(f"decode_head.bins.{bins}", mean, level, (320, LEVEL), activation=RELU6),
            Conv(f"decode_head.bottleneck.{bins}", level, mixed, (LEVEL, HIDDEN), bias=False),
            Enlarge(mixed, features, large),
        ]
    steps += [
        Add(tuple(f"pyramid{bins}/large" for bins in BINS), "pyramid"),
        Conv("decode_head.bottleneck.local", "local", "hidden", (LEVEL, HIDDEN), plus="pyramid", activation=RELU6),
        Drop("hidden", "kept", 0.1),
        Conv("decode_head.around", "kept", "around", (HIDDEN, HIDDEN), 3, groups=HIDDEN),
        Conv("decode_head.conv_seg", "around", LOGITS, (HIDDEN, CLASSES)),
    ]
