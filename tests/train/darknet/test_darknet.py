"""The converter against a darknet written plainly in numpy, and against damaged files."""

import importlib.resources
import struct
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from stillroom.data.image import RgbdImage
from stillroom.errors import WeightsError
from stillroom.semantics.onnx.darknet import DarknetFile
from stillroom.semantics.yolo_fastest import SHIPPED, YoloFastestConfig
from stillroom_train.darknet.cfg import read_cfg
from stillroom_train.darknet.onnx_file import convert_files
from stillroom_train.darknet.weights import read_weights

# Each kind of layer, each activation, groups, negative and absolute routes, two heads.
CFG = """
[net]
width=12
height=16
channels=3

[convolutional]
batch_normalize=1
filters=8
size=3
stride=2
pad=1
activation=leaky

[convolutional]   # 1
batch_normalize=1
groups=8
filters=8
size=5
stride=1
pad=1
activation=relu6

[dropout]
probability=.5

[convolutional]   # 3
filters=8
size=1
pad=1
activation=linear

[shortcut]        # 4
from=-4
activation=leaky

[maxpool]         # 5
size=3
stride=1

[maxpool]         # 6
size=2
stride=2

[convolutional]   # 7
filters=14
groups=2
size=1
activation=logistic

[yolo]            # 8
mask=1,2
anchors=1,2, 3,4, 5,6
classes=2

[route]           # 9
layers=-3

[upsample]        # 10
stride=2

[route]
layers=-1,5,0

[convolutional]   # 12
filters=7
size=3
stride=1
padding=0
batch_normalize=1
activation=relu

[yolo]
mask=0
anchors=1,2, 3,4, 5,6
classes=2
scale_x_y=1.05
"""
# (filters, inputs per group, size, batch normalisation) of the convolutions above, counted by hand
CONVOLUTIONS = [(8, 3, 3, True), (8, 1, 5, True), (8, 8, 1, False), (14, 4, 1, False), (7, 24, 3, True)]


def activate(x, name):
    return {
        "linear": lambda: x,
        "leaky": lambda: np.where(x > 0, x, 0.1 * x),
        "relu": lambda: np.maximum(x, 0),
        "relu6": lambda: np.clip(x, 0, 6),
        "logistic": lambda: 1 / (1 + np.exp(-x)),
    }[name]()


def plain_convolution(x, kernel, stride, padding, groups):
    x = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
    filters, depth, size, _ = kernel.shape
    rows, columns = (x.shape[1] - size) // stride + 1, (x.shape[2] - size) // stride + 1
    out = np.zeros((filters, rows, columns))
    for f in range(filters):
        first = f // (filters // groups) * depth
        for r in range(rows):
            for c in range(columns):
                window = x[first : first + depth, r * stride : r * stride + size, c * stride : c * stride + size]
                out[f, r, c] = np.sum(window * kernel[f])
    return out


def plain_maxpool(x, size, stride):
    padding = size - 1
    rows, columns = ((side + padding - size) // stride + 1 for side in x.shape[1:])
    out = np.full((x.shape[0], rows, columns), -np.inf)
    for r in range(rows):
        for c in range(columns):
            top, left = r * stride - padding // 2, c * stride - padding // 2
            window = x[:, max(top, 0) : top + size, max(left, 0) : left + size]
            out[:, r, c] = window.max(axis=(1, 2))
    return out


def random_convolutions(rng):
    """What the weights file holds, in its order: bias, scale, mean, variance, kernel."""
    for filters, depth, size, normalised in CONVOLUTIONS:
        vectors = [rng.normal(0, 0.5, filters)]
        if normalised:
            vectors += [rng.normal(1, 0.3, filters), rng.normal(0, 0.5, filters), rng.uniform(0.2, 2, filters)]
        yield [v.astype("<f4") for v in vectors], rng.normal(0, 0.3, (filters, depth, size, size)).astype("<f4")


def write(folder: Path, convolutions, version=(0, 2, 5), cfg=CFG, tail=b"") -> tuple[Path, Path, Path]:
    """Return cfg, weights and names."""
    seen = struct.pack("<q" if version[0] * 10 + version[1] >= 2 else "<i", 7)
    body = b"".join(b"".join(v.tobytes() for v in vectors) + kernel.tobytes() for vectors, kernel in convolutions)
    (folder / "net.cfg").write_text(cfg)
    (folder / "net.weights").write_bytes(struct.pack("<3i", *version) + seen + body + tail)
    (folder / "net.names").write_text("dog\ncat\n")
    return folder / "net.cfg", folder / "net.weights", folder / "net.names"


def converted(folder: Path, convolutions, version=(0, 2, 5)) -> Path:
    """Return the ONNX file of the network."""
    (folder / "net.onnx").write_bytes(convert_files(*write(folder, convolutions, version)))
    return folder / "net.onnx"


def plain_network(image, convolutions):
    """The layers of CFG one by one, batch normalisation unfolded."""
    convolutions = list(convolutions)

    def layer(k, x, stride, padding, groups, activation):
        vectors, kernel = convolutions[k]
        y = plain_convolution(x, kernel.astype(float), stride, padding, groups)
        if len(vectors) == 4:
            bias, scale, mean, variance = (v.astype(float)[:, None, None] for v in vectors)
            y = scale * (y - mean) / np.sqrt(variance + 1e-5) + bias
        else:
            y = y + vectors[0].astype(float)[:, None, None]
        return activate(y, activation)

    l0 = layer(0, image / 255.0, 2, 1, 1, "leaky")
    l1 = layer(1, l0, 1, 2, 8, "relu6")
    l3 = layer(2, l1, 1, 0, 1, "linear")
    l4 = activate(l3 + l0, "leaky")
    l5 = plain_maxpool(l4, 3, 1)
    l6 = plain_maxpool(l5, 2, 2)
    l7 = layer(3, l6, 1, 0, 2, "logistic")
    l10 = l6.repeat(2, axis=1).repeat(2, axis=2)
    l11 = np.concatenate([l10, l5, l0])
    l12 = layer(4, l11, 1, 0, 1, "relu")
    return [l7, l12]


@pytest.mark.parametrize(
    ("version", "classes"),
    [((0, 1, 0), [0, 1]), ((0, 2, 5), [0, 1]), ((0, 2, 5), [1]), ((0, 2, 5), [1, 0]), ((0, 2, 5), [])],
)
def test_every_layer_agrees_with_plain_numpy(tmp_path, version, classes):
    rng = np.random.default_rng(3)
    convolutions = list(random_convolutions(rng))
    model = DarknetFile(converted(tmp_path, convolutions, version)).cut_to(classes)
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    for _ in range(3):
        image = rng.uniform(0, 255, (1, 3, 16, 12)).astype(np.float32)
        answers = session.run(None, {"image": image})
        expected = plain_network(image[0].astype(float), convolutions)
        assert [out.name for out in session.get_outputs()] == ["head_0", "head_1"]
        for answer, truth in zip(answers, expected, strict=True):
            by_anchor = truth.reshape(-1, 7, *truth.shape[1:])
            chosen = by_anchor[:, [0, 1, 2, 3, 4, *(5 + k for k in classes)]].reshape(-1, *truth.shape[1:])
            assert answer.shape[1:] == chosen.shape
            np.testing.assert_allclose(answer[0], chosen, rtol=1e-4, atol=1e-5)


def test_the_cfg_is_read_as_it_says(tmp_path):
    (tmp_path / "net.cfg").write_text(CFG)
    network = read_cfg(tmp_path / "net.cfg")
    assert network.input_shape == (3, 16, 12)
    assert network.shapes[7] == (14, 4, 3)
    assert network.shapes[11] == (24, 8, 6)
    assert [head.anchors_px for head in network.heads] == [((3, 4), (5, 6)), ((1, 2),)]
    assert [head.scale_xy for head in network.heads] == [1.0, 1.05]


def test_the_file_says_what_its_heads_are_read_with(tmp_path):
    heads = DarknetFile(converted(tmp_path, random_convolutions(np.random.default_rng(3)))).heads
    assert heads.classes == ("dog", "cat")
    assert [(head.anchors_px, head.scale_xy) for head in heads.heads] == [(((3, 4), (5, 6)), 1.0), (((1, 2),), 1.05)]


@pytest.mark.parametrize("variant", ["1.1", "1.1-xl"])
def test_the_shipped_networks_are_the_converted_originals(yolo_weights, variant):
    files = [yolo_weights / f"yolo-fastest-{variant}.{suffix}" for suffix in ("cfg", "weights")]
    model = onnx.load_model_from_string(convert_files(*files, yolo_weights / "coco.names"))
    shipped = onnx.load(str(importlib.resources.files("stillroom.semantics") / "weights" / SHIPPED[variant]))
    assert "YOLO licence" in shipped.doc_string
    assert (shipped.graph, list(shipped.metadata_props)) == (model.graph, list(model.metadata_props))


def test_names_that_are_not_of_this_network(tmp_path):
    files = write(tmp_path, random_convolutions(np.random.default_rng(3)))
    files[2].write_text("dog\ncat\nmouse\n")
    with pytest.raises(WeightsError, match=r"net\.names: 3 class names; the network has 2"):
        convert_files(*files)


@pytest.mark.parametrize(
    ("cut", "tail", "said"),
    [(4, b"", "truncated"), (2, b"", "truncated"), (0, b"1234", "too long"), (10**6, b"", "truncated")],
)
def test_weights_of_the_wrong_length(tmp_path, cut, tail, said):
    cfg, weights, _ = write(tmp_path, random_convolutions(np.random.default_rng(3)), tail=tail)
    content = weights.read_bytes()
    weights.write_bytes(content[: max(0, len(content) - cut)])
    with pytest.raises(WeightsError, match=rf"net\.weights: {said}.*fetch it again") as caught:
        read_weights(weights, read_cfg(cfg))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("index", [0, 3])
def test_weights_that_are_not_finite(tmp_path, index):
    convolutions = list(random_convolutions(np.random.default_rng(3)))
    convolutions[0][0][index][2] = np.nan if index == 0 else -1.0  # a bias; a variance below zero
    cfg, weights, _ = write(tmp_path, convolutions)
    with pytest.raises(WeightsError, match="not finite"):
        read_weights(weights, read_cfg(cfg))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[dropout]", "[crnn]", r"layer \[crnn\] is not supported; known are convolutional"),
        ("activation=relu6", "activation=mish", "activation 'mish' is not supported"),
        ("stride=1\npadding=0", "stride=1\ndilation=2", "option 'dilation' is not supported"),
        ("filters=8", "filters=eight", "filters is 'eight', not a whole number"),
        ("width=12", "wide=12", "width is missing"),
        ("from=-4", "from=-9", "from is -9; it must be at least -4"),
        ("from=-4", "from=7", "names layer 7, which is not before it"),
        ("layers=-1,5,0", "layers=-1,0,6", "joins layers of different sizes"),
        ("groups=2", "groups=3", "do not go in 3 groups"),
        ("mask=1,2", "mask=1,5", "mask"),
        ("classes=2", "classes=3", "does not fit 14 channels"),
        ("stride=2", "stride=0", "stride is 0; it must be at least 1"),
        ("size=2\nstride=2", "size=90\npadding=0", "leaves an image of no size"),
        ("[net]", "[maxpool]", r"not with \[net\]"),
        ("classes=2", "new_coords=1", "new_coords"),
    ],
)
def test_a_cfg_that_is_not_understood_says_where_and_why(tmp_path, old, new, said):
    # The line of the heading under which (or in which) the change was made.
    line = CFG[: CFG.rindex("[", 0, CFG.index(old) + 1)].count("\n") + 1
    path = tmp_path / "net.cfg"
    path.write_text(CFG.replace(old, new, 1))
    with pytest.raises(WeightsError, match=said) as caught:
        read_cfg(path)
    assert str(caught.value).startswith(f"{path}:{line}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "empty"),
        ("hello", "no 'key=value'"),
        ("[net]\nwidth=8\nheight=8\n", "a detector"),
        ("[net]\nwidth=8\nheight=8\n[maxpool]\n", r"\[yolo\]"),
    ],
)
def test_a_file_that_is_no_cfg(tmp_path, content, said):
    (tmp_path / "net.cfg").write_text(content)
    with pytest.raises(WeightsError, match=said):
        read_cfg(tmp_path / "net.cfg")


@pytest.mark.parametrize("missing", [0, 1])
def test_missing_files(tmp_path, missing):
    files = write(tmp_path, random_convolutions(np.random.default_rng(3)))
    files[missing].unlink()
    with pytest.raises(WeightsError, match=rf"{files[missing].name}: No such file"):
        convert_files(*files)


def test_a_head_that_cannot_be_cut_is_refused(tmp_path):
    """Its one anchor is computed in two groups."""
    one_class_more = CFG.replace("filters=7\n", "filters=8\ngroups=2\n")
    before, _, last = one_class_more.rpartition("classes=2")
    (tmp_path / "net.cfg").write_text(f"{before}classes=3{last}")
    with pytest.raises(WeightsError, match=r"\[yolo\]: 1 anchors do not go in 2 groups"):
        read_cfg(tmp_path / "net.cfg")


def plain_boxes(heads, movable, width, height, least):
    """Every cell, anchor and class in turn, as darknet's yolo layer reads them."""
    anchors = [[(3, 4), (5, 6)], [(1, 2)]]
    for raw, sizes, scale in zip(heads, anchors, [1.0, 1.05], strict=True):
        for a, (anchor_w, anchor_h) in enumerate(sizes):
            for r in range(raw.shape[1]):
                for c in range(raw.shape[2]):
                    v = raw[7 * a : 7 * a + 7, r, c]
                    squashed = 1 / (1 + np.exp(-v))
                    x = (squashed[0] * scale - (scale - 1) / 2 + c) / raw.shape[2] * width
                    y = (squashed[1] * scale - (scale - 1) / 2 + r) / raw.shape[1] * height
                    w, h = np.exp(v[2]) * anchor_w, np.exp(v[3]) * anchor_h
                    for label, k in movable.items():
                        if squashed[4] * squashed[5 + k] >= least:
                            edges = np.array([x - w / 2, y - h / 2, x + w / 2, y + h / 2]) - 0.5
                            size = [width - 1, height - 1] * 2
                            yield (label, squashed[4] * squashed[5 + k], *np.clip(edges, 0, size))


@pytest.mark.parametrize("movable", [{"cat": 1}, {"cat": 1, "dog": 0}, {}])
def test_a_whole_detector_agrees_with_plain_loops(tmp_path, movable):
    """The tiny network in the place of YOLO-Fastest."""
    rng = np.random.default_rng(3)
    convolutions = list(random_convolutions(rng))
    config = YoloFastestConfig(movable=tuple(movable), nms_iou=1.0, model=converted(tmp_path, convolutions))
    detector = config.build_detector(0.3)
    for _ in range(3):
        rgb = rng.integers(0, 256, (16, 12, 3)).astype(np.uint8)
        found = detector.detect(RgbdImage(0.0, rgb, np.zeros((16, 12), np.float32), 0))
        heads = plain_network(rgb.transpose(2, 0, 1).astype(float), convolutions)
        expected = sorted(plain_boxes(heads, movable, 12, 16, 0.3), key=lambda row: -row[1])
        assert len(found) == len(expected)
        assert bool(expected) == bool(movable)
        got = sorted(((box.label, box.confidence, *box.xyxy_px) for box in found), key=lambda row: -row[1])
        assert [row[0] for row in got] == [row[0] for row in expected]
        np.testing.assert_allclose(
            np.array([row[1:] for row in got], float), np.array([row[1:] for row in expected], float), atol=1e-4
        )
