"""Any ONNX segmentation network plugs in; and what does not fit is told in one line."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from onnx import TensorProto, helper
from red_network import CLASSES, red_config, save_red_network

from stillroom.data.image import RgbdImage
from stillroom.errors import ConfigError, StillroomError, WeightsError
from stillroom.semantics.class_names import VOC_CLASSES
from stillroom.semantics.masks.mask_segments import MaskSegments
from stillroom.semantics.masks.onnx_masks import DEEPLAB, OnnxMasksConfig
from stillroom.semantics.masks.regions import RegionsConfig, as_semantics, without_specks


def a_red_square(height: int = 240, width: int = 320) -> RgbdImage:
    rgb = np.full((height, width, 3), 100, np.uint8)
    rgb[40:120, 60:160] = 200, 60, 60
    rgb[140:180, 200:280] = 60, 60, 200
    return RgbdImage(0.0, rgb, np.zeros((height, width), np.float32), 0)


UINT8 = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}


@pytest.mark.parametrize(
    ("network", "options"),
    [
        ({}, {}),
        ({"channels_last": True}, {}),
        ({"output": "labels"}, {}),
        ({"output": "probabilities"}, {"scores": "probabilities"}),
        ({"size": (120, 160)}, {}),
        ({"input_type": TensorProto.FLOAT16}, {}),
        ({"input_type": TensorProto.UINT8}, UINT8),
        ({}, {"longer_side_px": 640}),
        ({}, {"longer_side_px": 161, "step_px": 16, "offset_px": 1}),
    ],
    ids=str,
)
def test_the_same_answer_by_every_way(network, options, tmp_path: Path) -> None:
    answer = red_config(save_red_network(tmp_path / "red.onnx", **network), **options).build()(a_red_square())
    expected = np.zeros((240, 320), np.bool_)
    expected[40:120, 60:160] = True
    wrong = answer.mask != expected
    assert wrong.sum() <= 0.06 * expected.sum()
    assert [box.label for box in answer.boxes] == ["person"]
    np.testing.assert_allclose(answer.boxes[0].xyxy_px, (60, 40, 159, 119), atol=2.1)
    assert answer.boxes[0].confidence > 0.9
    assert answer.boxes[0].carried == 0


def test_channels_are_swapped_for_a_network_that_wants_blue_first(tmp_path: Path) -> None:
    answer = red_config(save_red_network(tmp_path / "red.onnx"), bgr=True).build()(a_red_square())
    np.testing.assert_allclose(answer.boxes[0].xyxy_px, (200, 140, 279, 179), atol=1.1)


def test_classes_are_told_apart(tmp_path: Path) -> None:
    config = red_config(save_red_network(tmp_path / "red.onnx"), movable=("dog", "person"))
    answer = config.build()(a_red_square())
    assert [box.label for box in answer.boxes] == ["person", "dog"]
    assert answer.mask[150, 220]
    assert not answer.mask[10, 10]


def test_small_regions_go_and_the_others_grow(tmp_path: Path) -> None:
    config = red_config(save_red_network(tmp_path / "red.onnx"), movable=("dog", "person"))
    config = replace(config, regions=replace(config.regions, min_px=5000, dilate_px=6, boxes=True))
    answer = config.build()(a_red_square())
    assert [box.label for box in answer.boxes] == ["person"]
    assert answer.mask[34:126, 100].all()
    assert not answer.mask[32, 100]
    assert not answer.mask[150, 220]
    silent = replace(config, regions=replace(config.regions, boxes=False)).build()(a_red_square())
    assert silent.boxes == ()
    assert np.array_equal(silent.mask, answer.mask)


def test_odd_sizes_are_covered_to_the_last_pixel(tmp_path: Path) -> None:
    rgb = np.full((101, 77, 3), (200, 60, 60), np.uint8)
    image = RgbdImage(0.0, rgb, np.zeros((101, 77), np.float32), 0)
    answer = red_config(save_red_network(tmp_path / "red.onnx")).build()(image)
    assert answer.mask.all()
    assert answer.boxes[0].xyxy_px == (0, 0, 76, 100)


def broken(path: Path, kind: str) -> OnnxMasksConfig:
    """Return a config that something is wrong with."""
    red = save_red_network(path / "red.onnx")
    if kind == "absent":
        return red_config(path / "no.onnx")
    if kind == "folder":
        return red_config(path)
    if kind == "text":
        (path / "text.onnx").write_text("not a network")
        return red_config(path / "text.onnx")
    if kind == "cut":
        (path / "cut.onnx").write_bytes(red.read_bytes()[:-90])
        return red_config(path / "cut.onnx")
    if kind == "two colours":
        return red_config(save_red_network(path / "two.onnx", colors=2))
    if kind == "doubles":
        return red_config(save_red_network(path / "doubles.onnx", input_type=TensorProto.DOUBLE))
    if kind == "two inputs":
        return red_config(two_inputs(path / "both.onnx"))
    if kind == "other classes":
        return replace(red_config(red), classes=VOC_CLASSES)
    return red_config(red, **{kind.split("=")[0]: eval(kind.split("=")[1])})


def two_inputs(path: Path) -> Path:
    import onnx

    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, "h", "w"]) for name in ("a", "b", "c")]
    graph = helper.make_graph([helper.make_node("Add", ["a", "b"], ["c"])], "both", infos[:2], infos[2:])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), str(path))
    return path


@pytest.mark.parametrize(
    ("kind", "error", "said"),
    [
        ("absent", WeightsError, r"no such network: .*no\.onnx.*set semantics\.model"),
        ("folder", WeightsError, "no such network"),
        ("text", WeightsError, r"text\.onnx: not an ONNX network"),
        ("cut", WeightsError, r"cut\.onnx: not an ONNX network"),
        ("two colours", WeightsError, r"two\.onnx: its input 'image' is of shape \[1, 2, 'h', 'w'\]; it must be"),
        ("doubles", WeightsError, r"takes tensor\(double\)"),
        ("two inputs", WeightsError, r"takes 2 inputs \(a, b\)"),
        ("other classes", WeightsError, r"its output is of shape \(1, 3, 240, 320\), where 21 classes are named"),
        ("movable=('persn',)", ConfigError, "'persn' is not one of the network's; did you mean 'person'"),
        ("movable=('person', 'person')", ConfigError, "comes twice"),
        ("movable=()", ConfigError, "names no class"),
        ("every=0", ConfigError, "every' is 0; it must be 1 or more"),
        ("latency_frames=-1", ConfigError, "latency_frames' is -1"),
        ("probability=0.0", ConfigError, "probability' is 0.0"),
        ("std=(1.0, 0.0, 1.0)", ConfigError, "std' is"),
        ("scores='odds'", ConfigError, "scores' is 'odds'"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(kind: str, error: type, said: str, tmp_path: Path) -> None:
    with pytest.raises(StillroomError, match=said) as caught:
        broken(tmp_path, kind).build()(a_red_square())
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("refine", "jump_m", -1.0),
        ("refine", "window_px", 5),
        ("carry", "depth_step_m", 0.0),
        ("regions", "min_px", -1),
    ],
)
def test_impossible_values_of_sections_are_refused(section: str, key: str, value: float, tmp_path: Path) -> None:
    config = red_config(save_red_network(tmp_path / "red.onnx"))
    changed = replace(config, **{section: replace(getattr(config, section), **{key: value})})
    with pytest.raises(ConfigError, match=rf"{section}\.{key}' is {value}"):
        changed.build()


def test_a_bare_name_is_sought_in_the_models_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STILLROOM_MODELS", str(tmp_path))
    save_red_network(tmp_path / "red.onnx")
    assert red_config(Path("red.onnx")).build()(a_red_square()).boxes
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "empty"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(WeightsError, match=DEEPLAB.name):
        OnnxMasksConfig().build()


def test_deeplab_finds_the_people_and_nothing_in_an_empty_room(deeplab: Path, bonn: Path) -> None:
    from stillroom.datasets.open import open_dataset

    dataset = open_dataset(str(bonn))
    segmenter = OnnxMasksConfig(deeplab).build()
    people, empty = segmenter(dataset.load(460)), segmenter(dataset.load(20))
    assert 0.40 < people.mask.mean() < 0.52
    assert people.mask[300, 120]
    assert people.mask[300, 560]
    assert not people.mask[100, 300]
    assert {box.label for box in people.boxes} == {"person"}
    assert empty.mask is None or empty.mask.mean() < 0.002


def test_names_of_the_test_network() -> None:
    assert VOC_CLASSES[15] == "person"
    assert len(VOC_CLASSES) == 21
    assert CLASSES[1] == "person"


def test_named_classes_are_boxes_and_no_reason_to_think_that_anything_moves(tmp_path: Path) -> None:
    rgb = np.full((240, 320, 3), 90, np.uint8)
    rgb[20:120, 40:100] = 200, 60, 60  # a person
    rgb[60:200, 180:280] = 60, 60, 200  # a dog, which here stands for a chair
    image = RgbdImage(0.0, rgb, np.zeros((240, 320), np.float32), 0)
    red = save_red_network(tmp_path / "red.onnx")
    plain, named = (red_config(red, named=names).build()(image) for names in ((), ("dog",)))
    np.testing.assert_array_equal(named.mask, plain.mask)
    assert named.boxes == plain.boxes
    assert plain.named == ()
    (dog,) = named.named
    assert (dog.label, dog.carried) == ("dog", 0)
    assert np.abs(np.subtract(dog.xyxy_px, (180, 60, 279, 199))).max() <= 2
    assert dog.confidence > 0.9
    rgb[20:120, 40:100] = 90
    alone = red_config(red, named=("dog",)).build()(image)
    assert not alone.has_any
    assert alone.named == named.named


def test_named_things_are_carried_when_the_network_is_late(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    ground, coat = (
        cv2.resize(rng.integers(0, 120, (40, 60), dtype=np.uint8), (360, 240), interpolation=cv2.INTER_LINEAR)
        for _ in range(2)
    )
    masks = red_config(save_red_network(tmp_path / "red.onnx"), named=("dog",), every=4).build()
    for index in range(4):
        rgb = np.repeat(ground[:, :320, None], 3, axis=2)
        left = 120 + 5 * index
        rgb[60:200, left : left + 100] = coat[60:200, 120:220, None] + np.array([0, 0, 90], np.uint8)
        depth_m = np.full((240, 320), 2.0, np.float32)
        depth_m[60:200, left : left + 100] = 1.2
        known = masks(RgbdImage(index / 30.0, rgb, depth_m, index))
        (dog,) = known.named
        assert dog.carried == index
        assert abs(dog.x_min_px - left) <= 6


def test_in_a_crowd_masks_are_grown_less(tmp_path: Path) -> None:
    red = save_red_network(tmp_path / "red.onnx")
    config = red_config(red)
    config = replace(config, regions=replace(config.regions, dilate_px=15))

    def width_px(columns: int) -> int:
        rgb = np.full((240, 320, 3), 90, np.uint8)
        rgb[:, 20 : 20 + columns] = 200, 60, 60
        known = config.build()(RgbdImage(0.0, rgb, np.zeros((240, 320), np.float32), 0))
        return int(np.flatnonzero(known.movable[120]).max()) - (20 + columns - 1)

    assert abs(width_px(100) - 15) <= 1
    assert abs(width_px(180) - 5) <= 1, "it would be over 60 % of the image"


def test_boxes_are_around_each_region_and_as_sure_as_its_pixels() -> None:
    label, probability = np.zeros((60, 80), np.uint8), np.zeros((60, 80), np.float32)
    label[10:20, 30:50], probability[10:20, 30:50] = 2, 0.75
    label[40:60, 5:9], probability[40:60, 5:9] = 1, 0.5
    label[40:60, 60:80], probability[40:60, 60:80] = 2, 1.0
    label[2, 2], probability[2, 2] = 1, 0.9
    segments = without_specks(MaskSegments(label, probability), 40)
    assert segments.label[2, 2] == 0
    assert np.array_equal(segments.label > 0, (label > 0) & (np.arange(60)[:, None] > 2))
    boxes = as_semantics(segments, ("person", "dog"), 120, 160, 0, RegionsConfig(dilate_px=0)).boxes
    assert [(box.label, *box.xyxy_px, box.confidence) for box in boxes] == [
        ("dog", 120, 80, 159, 119, 1.0),
        ("dog", 60, 20, 99, 39, 0.75),
        ("person", 10, 80, 17, 119, 0.5),
    ]
