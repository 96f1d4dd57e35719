"""Instances of any ONNX network: every layout, where its masks come to lie, classes by their numbers, and bad files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from constant_detector import save_constant_detector
from scipy.ndimage import map_coordinates

from stillroom.config import SlamConfig
from stillroom.config.settings import with_overrides
from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Semantics
from stillroom.errors import ConfigError, WeightsError
from stillroom.semantics.class_names import COCO_CLASSES
from stillroom.semantics.masks.onnx_instances import OnnxInstancesConfig
from stillroom.semantics.masks.refine import RefineConfig
from stillroom.semantics.masks.regions import RegionsConfig
from stillroom.semantics.onnx.instance_classes import COCO_NAMES, IDS
from stillroom.semantics.onnx.instance_layouts import Output, roles_of

INPUT_PX = 128, 96
PLAIN = OnnxInstancesConfig(
    movable=("person", "dog"),
    refine=RefineConfig(enabled=False),
    regions=RegionsConfig(min_px=0, dilate_px=0),
)
RECTANGLES = {"person": (20, 10, 60, 70), "dog": (80, 40, 120, 90), "chair": (2, 2, 14, 14)}
"""Edges of what is there, x0 y0 x1 y1 [px of the input], even numbers: they lie between pixels of the half image."""

FOUND = (("person", 0.9), ("dog", 0.7), ("chair", 0.8), ("person", 0.3))
"""What the networks find: class and score. The last one lies where the dog does, and is not sure enough."""


def an_image(width: int = 128, height: int = 96, index: int = 0) -> RgbdImage:
    rgb = np.full((height, width, 3), 90, np.uint8)
    return RgbdImage(index / 30, rgb, np.zeros((height, width), np.float32), index)


def edges() -> np.ndarray:
    return np.array([RECTANGLES[name if score > 0.5 else "dog"] for name, score in FOUND], np.float32)


def scores() -> np.ndarray:
    return np.array([score for _, score in FOUND], np.float32)


def numbers(names: tuple[str, ...] = COCO_CLASSES) -> np.ndarray:
    return np.array([names.index(name) for name, _ in FOUND], np.int64)


def filled(rectangles: np.ndarray, shape: tuple[int, int], inside: float, outside: float) -> np.ndarray:
    """Masks (N, h, w) that cover the input, of rectangles in its pixels."""
    masks = np.full((len(rectangles), *shape), outside, np.float32)
    for mask, rectangle in zip(masks, rectangles, strict=True):
        x0, y0, x1, y1 = (rectangle * np.tile((shape[1] / INPUT_PX[0], shape[0] / INPUT_PX[1]), 2)).round().astype(int)
        mask[y0:y1, x0:x1] = inside
    return masks


def as_torchvision() -> tuple[dict[str, Any], dict[str, Any]]:
    masks = filled(edges(), (96, 128), 0.9, 0.1)[:, None]
    return {"boxes": edges(), "labels": numbers(COCO_NAMES[IDS]), "scores": scores(), "masks": masks}, {}


def as_the_onnx_zoo() -> tuple[dict[str, Any], dict[str, Any]]:
    """Nameless, in another order, with masks of boxes."""
    masks = np.ones((4, 1, 28, 28), np.float32)
    outputs = {"6568": edges(), "6570": numbers() + 1, "6572": scores(), "6887": masks}
    return outputs, {"numbering": "from-1", "masks_cover": "box"}


def as_rtmdet() -> tuple[dict[str, Any], dict[str, Any]]:
    filling = np.zeros((3, 5), np.float32)  # as fixed-size exports fill up
    dets = np.concatenate([np.concatenate([edges(), scores()[:, None]], axis=1), filling])[None]
    labels = np.concatenate([numbers(), np.full(3, -1)])[None]
    masks = np.concatenate([filled(edges(), (96, 128), 0.9, 0.1), np.zeros((3, 96, 128), np.float32)])[None]
    return {"dets": dets, "labels": labels, "masks": masks}, {}


def as_mmdeploy_mask_rcnn() -> tuple[dict[str, Any], dict[str, Any]]:
    dets = np.concatenate([edges(), scores()[:, None]], axis=1)[None]
    return {"dets": dets, "labels": numbers()[None], "masks": np.full((1, 4, 28, 28), 0.999, np.float32)}, {
        "masks_cover": "box"
    }


def shares() -> np.ndarray:
    middle, size = (edges()[:, :2] + edges()[:, 2:]) / 2, edges()[:, 2:] - edges()[:, :2]
    return np.concatenate([middle / INPUT_PX, size / INPUT_PX], axis=1).astype(np.float32)


def logits(n: int, names: tuple[str, ...]) -> np.ndarray:
    every = np.full((len(FOUND), n), -6.0, np.float32)
    every[np.arange(len(FOUND)), numbers(names)] = np.log(scores() / (1 - scores()))
    return every


def as_rf_detr() -> tuple[dict[str, Any], dict[str, Any]]:
    """The third output has a number as its name, as in version 1.4."""
    masks = filled(edges(), (48, 64), 5.0, -5.0)
    return {"dets": shares()[None], "labels": logits(91, COCO_NAMES[IDS])[None], "4245": masks[None]}, {}


def as_detr_of_three_classes() -> tuple[dict[str, Any], dict[str, Any]]:
    """With one for no object, labels are as wide as boxes: the names tell."""
    names = ("dog", "person", "chair")
    masks = filled(edges(), (48, 64), 5.0, -5.0)
    return {"labels": logits(4, names)[None], "dets": shares()[None], "masks": masks[None]}, {"classes": names}


def as_detr_with_probabilities() -> tuple[dict[str, Any], dict[str, Any]]:
    likely = (1 / (1 + np.exp(-logits(80, COCO_CLASSES)))).astype(np.float32)
    masks = filled(edges(), (48, 64), 1.0, 0.0)
    return {"pred_logits": likely[None], "pred_boxes": shares()[None], "pred_masks": masks[None]}, {}


def as_yolo_seg() -> tuple[dict[str, Any], dict[str, Any]]:
    """Prototypes that cover everything: the box cuts a mask. The person comes twice, the second time a bit aside."""
    middle, size = (edges()[:, :2] + edges()[:, 2:]) / 2, edges()[:, 2:] - edges()[:, :2]
    likely = np.zeros((len(FOUND), 80), np.float32)
    likely[np.arange(len(FOUND)), numbers()] = scores()
    rows = np.concatenate([middle, size, likely, np.tile(np.array([3, -1], np.float32), (len(FOUND), 1))], axis=1)
    again = rows[:1].copy()
    again[0, 0], again[0, 4] = again[0, 0] + 4, 0.8
    prototypes = np.ones((1, 2, 24, 32), np.float32)
    return {"output0": np.concatenate([again, rows]).T[None].astype(np.float32), "output1": prototypes}, {}


LAYOUTS: list[Callable[[], tuple[dict[str, Any], dict[str, Any]]]] = [
    as_torchvision,
    as_the_onnx_zoo,
    as_rtmdet,
    as_mmdeploy_mask_rcnn,
    as_rf_detr,
    as_detr_of_three_classes,
    as_detr_with_probabilities,
    as_yolo_seg,
]


def answer(folder: Path, outputs: dict[str, Any], image: RgbdImage | None = None, **settings: Any) -> Semantics:
    shape = settings.pop("shape", (1, 3, 96, 128))
    model = save_constant_detector(folder / "network.onnx", outputs, shape=shape, says_shapes=False)
    return replace(PLAIN, model=model, **settings).build()(image or an_image())


def rectangle(name: str) -> np.ndarray:
    mask = np.zeros((96, 128), dtype=bool)
    x0, y0, x1, y1 = RECTANGLES[name]
    mask[y0:y1, x0:x1] = True
    return mask


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_objects_come_out_where_they_are_with_their_classes_and_scores(layout: Callable, tmp_path: Path) -> None:
    outputs, settings = layout()
    told = answer(tmp_path, outputs, named=("chair",), **settings)
    assert [(one.label, round(one.score, 4)) for one in told.instances] == [("person", 0.9), ("dog", 0.7)]
    for one in told.instances:
        assert np.array_equal(one.mask, rectangle(one.label))
    assert np.array_equal(told.mask, rectangle("person") | rectangle("dog"))
    assert [(box.label, box.xyxy_px) for box in told.boxes] == [
        ("person", (20, 10, 59, 69)),
        ("dog", (80, 40, 119, 89)),
    ]
    assert [(box.label, box.xyxy_px) for box in told.named] == [("chair", (2, 2, 13, 13))]
    assert told.named[0].confidence == pytest.approx(0.8)


@pytest.mark.parametrize("says_shapes", [True, False])
@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_a_network_is_accepted_before_its_first_image(layout: Callable, says_shapes: bool, tmp_path: Path) -> None:
    outputs, settings = layout()
    model = save_constant_detector(tmp_path / "network.onnx", outputs, says_shapes=says_shapes)
    assert replace(PLAIN, model=model, **settings).build()(an_image()).has_any


def sampled(mask: np.ndarray, area: tuple[float, ...], size: tuple[int, int], fit: str, outside: float | None):
    """A mask's value at the middle of each pixel of the half image, by plain loops over the chain of sizes."""
    width, height = size
    gain = np.array(INPUT_PX) / size if fit == "stretch" else np.full(2, min(np.array(INPUT_PX) / size))
    content = np.round(np.array(size) * gain)
    gain, corner = content / size, (np.array(INPUT_PX) - content) // 2
    x = (np.arange(width // 2) * 2 + 1) * gain[0] + corner[0]
    y = (np.arange(height // 2) * 2 + 1) * gain[1] + corner[1]
    column = (x - area[0]) / (area[2] - area[0]) * mask.shape[1] - 0.5
    row = (y - area[1]) / (area[3] - area[1]) * mask.shape[0] - 0.5
    how = {"mode": "nearest"} if outside is None else {"mode": "grid-constant", "cval": outside}
    return map_coordinates(mask, np.meshgrid(row, column, indexing="ij"), order=1, **how)


@pytest.mark.parametrize("fit", ["letterbox", "stretch"])
@pytest.mark.parametrize("size", [(200, 100), (96, 160), (128, 96)])
@pytest.mark.parametrize("in_box", [True, False])
def test_letterbox_and_stretch_are_undone(fit: str, size: tuple[int, int], in_box: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = rng.uniform(0, 1, (6, 5) if in_box else (24, 32)).astype(np.float32)
    area = (20.5, 17.25, 101.0, 70.0)
    outputs = {
        "dets": np.array([[*area, 0.9]], np.float32),
        "labels": np.zeros(1, np.int64),
        "masks": values[None],
    }
    told = answer(tmp_path, outputs, an_image(*size), fit=fit, masks_cover="box" if in_box else "input")
    expected = sampled(values, area if in_box else (0, 0, *INPUT_PX), size, fit, 0.0 if in_box else None)
    # Where the value is just at the threshold, OpenCV's steps of 1/32 px may decide otherwise.
    clear = np.abs(expected - 0.5) > 0.04
    found = told.instances[0].mask[::2, ::2]
    assert found.shape == expected.shape
    assert clear.mean() > 0.6
    assert np.array_equal(found[clear], (expected > 0.5)[clear])
    assert 100 < np.count_nonzero(found) < 0.9 * found.size


def test_masks_of_boxes_are_told_by_their_size(tmp_path: Path) -> None:
    outputs, _ = as_mmdeploy_mask_rcnn()
    outputs["dets"][..., :4] *= 4.0
    told = answer(tmp_path, outputs, an_image(512, 384), shape=(1, 3, 384, 512))
    assert told.instances[0].box.xyxy_px == (80, 40, 239, 279)


def test_of_two_that_overlap_the_surer_one_has_the_pixel(tmp_path: Path) -> None:
    masks = np.zeros((2, 96, 128), np.float32)
    masks[0, 10:50, 10:50], masks[1, 30:70, 30:70] = 1, 1
    dets = np.array([[10, 10, 50, 50, 0.6], [30, 30, 70, 70, 0.8]], np.float32)
    told = answer(tmp_path, {"dets": dets, "labels": np.zeros(2, np.int64), "masks": masks})
    assert [round(one.score, 2) for one in told.instances] == [0.8, 0.6]
    assert [one.area_px for one in told.instances] == [1600, 1200]


def test_masks_and_instances_are_dilated_but_no_boxes_and_small_ones_are_left_out(tmp_path: Path) -> None:
    outputs, settings = as_rtmdet()
    told = answer(tmp_path, outputs, regions=RegionsConfig(min_px=2100, dilate_px=3), **settings)
    assert [one.label for one in told.instances] == ["person"]
    assert told.instances[0].box.xyxy_px == (17, 7, 62, 72)
    assert told.boxes[0].xyxy_px == (20, 10, 59, 69)
    assert np.array_equal(told.mask, told.instances[0].mask)


def test_a_candidate_counts_by_the_likeliest_of_the_wanted_classes(tmp_path: Path) -> None:
    outputs, _ = as_rf_detr()
    outputs["labels"][0, 0, COCO_NAMES[IDS].index("chair")] = 4.0  # 0.98 a chair, 0.9 a person
    told = answer(tmp_path, outputs)
    assert [(one.label, round(one.score, 2)) for one in told.instances] == [("person", 0.9), ("dog", 0.7)]


def test_softmax_and_classes_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "names.txt").write_text("dog\nperson\nchair\n")
    outputs, _ = as_detr_of_three_classes()
    outputs["labels"] = np.array([[[0, 2, 0, 0], [0, 0, 0, 3], [0, 0, 0, 3], [0, 0, 0, 3]]], np.float32)
    told = answer(tmp_path, outputs, classes_file=tmp_path / "names.txt", scores="softmax")
    assert [one.label for one in told.instances] == ["person"]
    assert told.instances[0].score == pytest.approx(np.exp(2) / (np.exp(2) + 3), abs=1e-5)


def test_nothing_found_and_numbers_that_are_none(tmp_path: Path) -> None:
    empty = {"boxes": (0, 4), "labels": (0,), "scores": (0,), "masks": (0, 1, 96, 128)}
    outputs = {name: np.zeros(shape, np.int64 if name == "labels" else np.float32) for name, shape in empty.items()}
    assert not answer(tmp_path, outputs).has_any
    outputs, settings = as_torchvision()
    outputs["boxes"][0, 0], outputs["scores"][1] = np.nan, np.nan
    assert not answer(tmp_path, outputs, **settings).instances


def test_between_the_images_that_the_network_sees_its_instances_are_propagated(tmp_path: Path) -> None:
    outputs, settings = as_rtmdet()
    model = save_constant_detector(tmp_path / "network.onnx", outputs)
    segmenter = replace(PLAIN, model=model, every=3, named=("chair",), **settings).build()
    told = [segmenter(an_image(index=index)) for index in range(4)]
    assert [each.boxes[0].carried for each in told] == [0, 1, 2, 0]
    for each in told:
        assert [(one.label, round(one.score, 2)) for one in each.instances] == [("person", 0.9), ("dog", 0.7)]
        assert [box.label for box in each.named] == ["chair"]
        assert np.count_nonzero(each.instances[0].mask ^ rectangle("person")) < 300


def test_coco_s_classes_by_their_ids() -> None:
    by_id = COCO_NAMES[IDS]
    assert len(by_id) == 91
    known = {"person": 1, "boat": 9, "bench": 15, "bird": 16, "giraffe": 25, "backpack": 27, "bottle": 44}
    known |= {"chair": 62, "dining table": 67, "toilet": 70, "tv": 72, "laptop": 73, "book": 84, "toothbrush": 90}
    assert {name: by_id.index(name) for name in known} == known


def test_settings_are_read_from_the_command_line() -> None:
    overrides = ["semantics.kind=onnx-instances", "semantics.model=a.onnx", "semantics.movable=person,dog"]
    config = with_overrides(SlamConfig(), [*overrides, "semantics.bgr=true", "semantics.input_px=800,608"])
    assert config.semantics == OnnxInstancesConfig(
        Path("a.onnx"), movable=("person", "dog"), bgr=True, input_px=(800, 608)
    )


# What cannot be used


def changed(layout: Callable, **outputs: Any) -> dict[str, Any]:
    return {name: value for name, value in (layout()[0] | outputs).items() if value is not None}


BAD: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "no masks": (changed(as_rtmdet, masks=None), {}, "no output tells masks .*dets .*labels"),
    "no scores": (changed(as_torchvision, scores=None), {}, "no output tells scores"),
    "one output": ({"output0": np.zeros((1, 116, 10), np.float32)}, {}, "no output tells"),
    "too few masks": (
        changed(as_torchvision, masks=np.zeros((2, 1, 96, 128), np.float32)),
        {},
        "returns 4 boxes, 4 labels, 4 scores and 2 masks",
    ),
    "background counted, and not said": (
        changed(as_torchvision, labels=np.array([0, 1, 2, 3])),
        {},
        "returns class 0, where COCO has no such class; set .* semantics.numbering to one of from-0, from-1, ids",
    ),
    "more classes than named": (
        changed(as_rtmdet),
        {"classes": ("person", "dog")},
        "returns class 16, where 2 classes are named, counted from 0; set semantics.classes",
    ),
    "another number of classes": (
        changed(as_rf_detr, labels=np.zeros((1, 4, 7), np.float32)),
        {},
        "tells 7 classes, where COCO's are 80, 81 or 91; set semantics.classes to its names",
    ),
    "another number of classes than named": (
        changed(as_rf_detr),
        {"classes": ("person", "dog")},
        "tells 91 classes, where 2 are named; set semantics.classes",
    ),
    "logits for scores": (changed(as_torchvision, scores=np.full(4, 7.5, np.float32)), {}, "a score of 7.5"),
    "more prototypes than columns": (
        {"output0": np.zeros((1, 20, 9), np.float32), "output1": np.zeros((1, 32, 8, 8), np.float32)},
        {},
        "20 numbers for each box and 32 prototypes, which leaves no class",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_network_that_cannot_be_used_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    outputs, settings, message = BAD[case]
    with pytest.raises(WeightsError, match=message) as error:
        answer(tmp_path, outputs, **settings)
    assert "\n" not in str(error.value)
    assert str(tmp_path / "network.onnx") in str(error.value)


def test_a_missing_output_is_told_before_the_first_image(tmp_path: Path) -> None:
    model = save_constant_detector(tmp_path / "network.onnx", BAD["no masks"][0])
    with pytest.raises(WeightsError, match="no output tells masks"):
        replace(PLAIN, model=model).build()


def test_files_and_classes_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"no such network: .*absent.onnx"):
        replace(PLAIN, model=tmp_path / "absent.onnx").build()
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(WeightsError, match="not an ONNX network"):
        replace(PLAIN, model=tmp_path / "text.onnx").build()
    with pytest.raises(ConfigError, match="model is not set"):
        PLAIN.build()
    with pytest.raises(ConfigError, match="did you mean 'person'"):
        replace(PLAIN, model=tmp_path / "text.onnx", movable=("persn",)).build()
    with pytest.raises(ConfigError, match="both set"):
        replace(PLAIN, model=tmp_path / "a", classes=("dog",), classes_file=tmp_path / "names").build()


def test_an_output_s_name_has_priority_over_its_form() -> None:
    boxes, labels = Output("dets", (1, 9, 4), False), Output("labels", (1, 9, 4), False)
    masks = Output("4245", ("batch", "q", "h", "w"), False)
    for order in ([boxes, labels, masks], [masks, labels, boxes]):
        layout, roles = roles_of(order, "auto", "a network")
        assert layout == "detr"
        assert [order[roles[role]].name for role in ("boxes", "labels", "masks")] == ["dets", "labels", "4245"]
