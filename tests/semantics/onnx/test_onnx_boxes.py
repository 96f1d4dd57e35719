"""Boxes of any ONNX detector: every layout against plain loops, YOLO-Fastest against itself, and bad input."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import onnx
import pytest
from constant_detector import save_constant_detector

from stillroom.config import SlamConfig
from stillroom.config.settings import with_overrides
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.errors import ConfigError, WeightsError
from stillroom.semantics.carried_boxes import CarryConfig
from stillroom.semantics.class_names import COCO_CLASSES
from stillroom.semantics.onnx.onnx_boxes import OnnxBoxesConfig
from stillroom.semantics.yolo_fastest import SHIPPED, YoloFastestConfig

CLASSES = ("dog", "chair", "person", "cat", "box")
ASKED = ("person", "dog")
INPUT_PX = 128, 96
LEAST, MOST_IOU = 0.3, 0.4


def an_image(width=200, height=100, index=0):
    return RgbdImage(
        index / 30, np.full((height, width, 3), 90, np.uint8), np.zeros((height, width), np.float32), index
    )


def some_boxes(seed, n=60):
    """Edges in a network's input (n, 4) [px], objectness (n,), and the probability of each class (n, C), float32."""
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 90, (n, 2))
    edges = np.concatenate([corner, corner + rng.uniform(2, 60, (n, 2))], axis=1).astype(np.float32)
    return edges, rng.uniform(0.4, 1, n).astype(np.float32), rng.uniform(0, 1, (n, len(CLASSES))).astype(np.float32)


def by_middle(edges):
    return np.concatenate([(edges[:, :2] + edges[:, 2:]) / 2, edges[:, 2:] - edges[:, :2]], axis=1)


def plain_iou(a, b):
    w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    common = max(w, 0) * max(h, 0)
    return common / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common)


def expected_boxes(candidates, image, fit):
    """Return label, score and edges of what is to be told of candidates, (edges in the input, score, label) each."""
    kept = []
    for edges, score, label in sorted(candidates, key=lambda candidate: -candidate[1]):
        rivals = [other for other, _, theirs in kept if theirs == label]
        if label in ASKED and score >= LEAST and all(plain_iou(edges, rival) <= MOST_IOU for rival in rivals):
            kept.append((edges, score, label))
    width, height = image.width, image.height
    if fit == "stretch":
        gain, left, top = (INPUT_PX[0] / width, INPUT_PX[1] / height), 0, 0
    else:  # 200 × 100 in 128 × 96 becomes 128 × 64, with 16 rows of gray above
        gain, left, top = (0.64, 0.64), 0, 16
    told = []
    for (x0, y0, x1, y1), score, label in kept:
        xs = [min(max((x - left) / gain[0] - 0.5, 0), width - 1) for x in (x0, x1)]
        ys = [min(max((y - top) / gain[1] - 0.5, 0), height - 1) for y in (y0, y1)]
        told.append((label, score, (xs[0], ys[0], xs[1], ys[1])))
    return told


def config(model, **options):
    standard = {"classes": CLASSES, "movable": ASKED, "confidence": LEAST, "nms_iou": MOST_IOU}
    return OnnxBoxesConfig(model, **(standard | {"carry": CarryConfig(enabled=False)} | options))


def assert_told(boxes, expected):
    assert [box.label for box in boxes] == [label for label, _, _ in expected]
    assert len(expected) > 3
    for box, (_, score, edges) in zip(boxes, expected, strict=True):
        assert box.confidence == pytest.approx(score, abs=1e-6)
        np.testing.assert_allclose(box.xyxy_px, edges, atol=1e-3)


def as_yolo_v8(edges, objectness, scores):
    told = [(e, s, label) for e, row in zip(edges, scores, strict=True) for s, label in zip(row, CLASSES, strict=True)]
    return {"output0": np.concatenate([by_middle(edges), scores], axis=1).T[None]}, told


def as_yolo_v5(edges, objectness, scores):
    rows = np.concatenate([by_middle(edges), objectness[:, None], scores], axis=1)
    return {"output0": rows[None], "one_head": np.zeros((1, 3, 4, 4), np.float32)}, [
        (e, float(o) * float(s), label)
        for e, o, row in zip(edges, objectness, scores, strict=True)
        for s, label in zip(row, CLASSES, strict=True)
    ]


def one_class_each(edges, scores):
    label = scores.argmax(axis=1)
    return label, [(e, row[k], CLASSES[k]) for e, row, k in zip(edges, scores, label, strict=True)]


def as_nms(edges, objectness, scores):
    label, told = one_class_each(edges, scores)
    rows = np.concatenate([edges, scores.max(axis=1)[:, None], label[:, None]], axis=1).astype(np.float32)
    filling = np.tile(np.array([0, 0, 0, 0, 0, -1], np.float32), (7, 1))  # as fixed-size exports fill up
    return {"output0": np.concatenate([rows, filling])[None]}, told


def as_nms_without_batch(edges, objectness, scores):
    outputs, told = as_nms(edges, objectness, scores)
    return {"output0": outputs["output0"][0]}, told


def as_torchvision(edges, objectness, scores):
    label, told = one_class_each(edges, scores)
    masks = np.zeros((len(edges), 1, 2, 2), np.float32)
    return {"boxes": edges, "labels": label.astype(np.int64), "scores": scores.max(axis=1), "masks": masks}, told


def as_scores_before_labels(edges, objectness, scores):
    outputs, told = as_torchvision(edges, objectness, scores)
    return {name: outputs[name][None] for name in ("boxes", "scores", "labels")}, told


LAYOUTS = [
    ("yolo-v8", as_yolo_v8),
    ("yolo-v5", as_yolo_v5),
    ("nms", as_nms),
    ("nms", as_nms_without_batch),
    ("detections", as_torchvision),
    ("detections", as_scores_before_labels),
]


@pytest.mark.parametrize("fit", ["letterbox", "stretch"])
@pytest.mark.parametrize(("layout", "told_as"), LAYOUTS, ids=lambda value: getattr(value, "__name__", value))
def test_every_layout_agrees_with_plain_loops(tmp_path, layout, told_as, fit):
    for seed in range(3):
        outputs, candidates = told_as(*some_boxes(seed))
        model = save_constant_detector(tmp_path / f"{seed}.onnx", outputs, says_shapes=seed != 1)
        image = an_image()
        segmenter = config(model, layout=layout, fit=fit).build()
        assert_told(segmenter(image).boxes, expected_boxes(candidates, image, fit))


def test_edges_in_shares_of_the_input(tmp_path):
    edges, objectness, scores = some_boxes(0)
    outputs, candidates = as_torchvision(edges, objectness, scores)
    outputs["boxes"] = edges / np.array([*INPUT_PX, *INPUT_PX], np.float32)
    model = save_constant_detector(tmp_path / "ssd.onnx", outputs)
    segmenter = config(model, layout="detections", coordinates="shares").build()
    assert_told(segmenter(an_image()).boxes, expected_boxes(candidates, an_image(), "letterbox"))


@pytest.mark.parametrize("variant", ["1.1", "1.1-xl"])
def test_yolo_fastest_in_a_file_gives_the_very_boxes_of_yolo_fastest(bonn, variant):
    model, labels = Path(str(files("stillroom.semantics"))) / "weights" / SHIPPED[variant], ("person", "chair")
    common = {"movable": labels, "confidence": 0.2, "carry": CarryConfig(enabled=False)}
    ours = OnnxBoxesConfig(model, "darknet", fit="stretch", std=(1.0, 1.0, 1.0), **common).build_detector(0.2)
    known = YoloFastestConfig(variant, **common).build_detector(0.2)
    dataset, found = open_dataset(str(bonn)), 0
    for index in range(320, 420, 20):
        image = dataset.load(index)
        boxes = ours.detect(image)
        assert boxes == known.detect(image)
        found += len(boxes)
    assert found > 10


def test_boxes_are_carried_and_named_things_stand_apart(tmp_path):
    rows = [[10, 30, 30, 70, 0.9, 2], [40, 30, 60, 70, 0.4, 0], [20, 30, 50, 70, 0.8, 1], [80, 30, 100, 70, 0.9, 3]]
    model = save_constant_detector(tmp_path / "d.onnx", {"output": np.array(rows, np.float32)})
    alone = config(model, layout="nms", named=("chair",)).build()(an_image())
    assert [box.label for box in alone.boxes] == ["person", "dog"]
    assert [box.label for box in alone.named] == ["chair"]
    carried = config(model, layout="nms", named=("chair",), carry=CarryConfig()).build()
    tracked = [carried(an_image(index=index)) for index in range(3)]
    said = [[(box.label, box.track_id, box.carried) for box in (*a.boxes, *a.named)] for a in tracked]
    assert said[0] == said[1] == said[2] == [("person", 0, 0), ("dog", 2, 0), ("chair", 1, 0)]


def test_boxes_without_a_place_are_left_out(tmp_path):
    rows = [[10, 20, 30, 40, 0.9, 2], [30, 20, 10, 40, 0.9, 2], [np.nan, 0, 9, 9, 0.9, 2], [0, 0, np.inf, 9, 0.9, 0]]
    rows += [[40, 50, 60, 70, np.nan, 2]]
    model = save_constant_detector(tmp_path / "d.onnx", {"output": np.array(rows, np.float32)})
    (box,) = config(model, layout="nms", fit="stretch").build()(an_image()).boxes
    np.testing.assert_allclose(box.xyxy_px, [10 / 0.64 - 0.5, 20 / 0.96 - 0.5, 30 / 0.64 - 0.5, 40 / 0.96 - 0.5])


def test_an_open_input_takes_the_size_of_the_config(tmp_path):
    outputs, candidates = as_nms(*some_boxes(2))
    model = save_constant_detector(tmp_path / "d.onnx", outputs, shape=("batch", 3, "rows", "columns"))
    segmenter = config(model, layout="nms", input_px=INPUT_PX).build()
    assert_told(segmenter(an_image()).boxes, expected_boxes(candidates, an_image(), "letterbox"))


@pytest.mark.parametrize("shape", [(3, 96, 128), (1, 96, 128, 3)])
def test_inputs_without_batch_and_with_channels_last(tmp_path, shape):
    outputs, candidates = as_nms(*some_boxes(2))
    model = save_constant_detector(tmp_path / "d.onnx", outputs, shape=shape)
    boxes = config(model, layout="nms").build()(an_image()).boxes
    assert_told(boxes, expected_boxes(candidates, an_image(), "letterbox"))


def test_classes_from_a_file_and_the_default_classes(tmp_path):
    outputs, _ = as_nms(*some_boxes(2))
    model = save_constant_detector(tmp_path / "d.onnx", outputs)
    (tmp_path / "names.txt").write_text("\n".join(CLASSES) + "\n\n")
    named = config(model, layout="nms", classes=(), classes_file=tmp_path / "names.txt")
    assert named.build()(an_image()).boxes == config(model, layout="nms").build()(an_image()).boxes
    assert len(set(COCO_CLASSES)) == 80
    coco = replace(named, classes_file=None, movable=("car",)).build()(an_image())
    assert {box.label for box in coco.boxes} == {"car"}  # class 2 of COCO, a person here


def test_the_kind_is_set_from_the_command_line(tmp_path):
    model = save_constant_detector(tmp_path / "d.onnx", as_nms(*some_boxes(2))[0])
    values = [
        "kind=onnx-boxes",
        f"model={model}",
        "layout=nms",
        "classes=dog,chair,person,cat,box",
        "movable=person,dog",
    ]
    built = with_overrides(SlamConfig(), [f"semantics.{value}" for value in values]).semantics
    assert built == OnnxBoxesConfig(model, "nms", classes=CLASSES, movable=ASKED)


EIGHT = np.zeros((1, 9, 30), np.float32)


@pytest.mark.parametrize(
    ("outputs", "options", "said"),
    [
        ({"o": EIGHT}, {"layout": "yolo-v5"}, r"shape \(1, 9, 30\), where .* promise \(1, boxes, 10\)"),
        ({"o": EIGHT}, {"classes": COCO_CLASSES, "movable": ("person",)}, r"promise \(1, 84, boxes\); set .* classes"),
        ({"o": EIGHT}, {"layout": "nms"}, r"promise \(1, boxes, 6\) or \(boxes, 6\)"),
        ({"o": EIGHT}, {"layout": "detections"}, "promise boxes .* labels .* scores"),
        ({"o": EIGHT + 3}, {}, "returns a score of 3; scores must be probabilities"),
        ({"o": np.array([[0, 0, 9, 9, 0.9, 5]], np.float32)}, {"layout": "nms"}, "class 5, where 5 classes are named"),
        (
            {"b": np.zeros((4, 4), np.float32), "l": np.zeros(4, np.int64), "s": np.zeros(3, np.float32)},
            {"layout": "detections"},
            "4 boxes, 4 labels and 3 scores",
        ),
    ],
)
@pytest.mark.parametrize("says_shapes", [True, False])
def test_outputs_that_do_not_fit_end_in_one_line(tmp_path, outputs, options, said, says_shapes):
    """Before the first image where the file tells the shapes, else at it."""
    model = save_constant_detector(tmp_path / "d.onnx", outputs, says_shapes=says_shapes)
    with pytest.raises(WeightsError, match=said) as caught:
        config(model, **options).build()(an_image())
    assert str(caught.value).startswith(str(model))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((1, 3, 96), r"input 'image' is of shape \[1, 3, 96\]; it must be \(1, 3, height, width\)"),
        ((1, 96, 128), "must be"),
        ((1, 1, 96, 128), "must be"),
        ((2, 3, 96, 128), "must be"),
        ((1, 1, 3, 96, 128), "must be"),
    ],
)
def test_an_input_of_the_wrong_rank_or_shape(tmp_path, shape, said):
    model = save_constant_detector(tmp_path / "d.onnx", {"o": EIGHT}, shape=shape)
    with pytest.raises(WeightsError, match=said):
        config(model).build()


def test_files_that_are_absent_or_something_else(tmp_path):
    with pytest.raises(WeightsError, match=r"no such network.*elsewhere\.onnx.*semantics\.model"):
        config(tmp_path / "elsewhere.onnx").build()
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(WeightsError, match=r"text\.onnx: not an ONNX network") as caught:
        config(tmp_path / "text.onnx").build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"model": None}, "model is not set"),
        ({"layout": "yolo"}, "layout' is 'yolo'; it must be one of yolo-v8, yolo-v5, nms, detections, darknet"),
        ({"fit": "crop"}, "fit' is 'crop'"),
        ({"coordinates": "metres"}, "coordinates' is 'metres'"),
        ({"confidence": 50.0}, "confidence' is 50.0"),
        ({"nms_iou": 0.0}, "nms_iou' is 0.0"),
        ({"std": (1.0, 0.0, 1.0)}, "std' is"),
        ({"input_px": (0, 640)}, "input_px' is"),
        ({"movable": ("ghost",)}, "'ghost' is not one of the network's"),
        ({"named": ("person",)}, "'person' comes twice"),
        ({"classes_file": "names.txt"}, "both set"),
        ({"classes": (), "classes_file": "names.txt"}, r"names\.txt: cannot be read"),
    ],
)
def test_impossible_values(tmp_path, options, said):
    values = dict(options)
    if "classes_file" in values:
        values["classes_file"] = tmp_path / values["classes_file"]
    model = values.pop("model", save_constant_detector(tmp_path / "d.onnx", {"o": EIGHT}))
    with pytest.raises(ConfigError, match=said):
        config(model, **values).build()


def test_whole_numbers_are_not_divided(tmp_path):
    model = save_constant_detector(tmp_path / "d.onnx", {"o": EIGHT}, input_type=onnx.TensorProto.UINT8)
    with pytest.raises(ConfigError, match="set mean to 0,0,0 and std to 1,1,1"):
        config(model).build()
    assert config(model, std=(1.0, 1.0, 1.0)).build()(an_image()).boxes == ()
