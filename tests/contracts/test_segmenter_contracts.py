"""Every segmenter keeps the socket's contract; and the contract notices when one does not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from constant_detector import save_constant_detector
from red_network import red_config, reddened, save_red_network

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box, Instance, Semantics
from stillroom.datasets.open import open_dataset
from stillroom.presets.registry import configure
from stillroom.protocols import Segmenter
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig
from stillroom.semantics.detector import withhold
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.semantics.masks.onnx_instances import OnnxInstancesConfig
from stillroom.semantics.masks.onnx_masks import OnnxMasksConfig
from stillroom.semantics.no_segmenter import NothingConfig
from stillroom.semantics.onnx.onnx_boxes import OnnxBoxesConfig
from stillroom.semantics.truth import TrueSemanticsConfig
from stillroom.semantics.yolo_fastest import YoloFastestConfig
from stillroom.testing.segmenter_contract import check_segmenter

Build = Callable[[], Segmenter]
Case = Callable[[Path, list[RgbdImage]], Build]


def a_walk(frames: int = 8) -> list[RgbdImage]:
    """A patch of noise, nearer than the noisy wall behind it, that walks to the right 4 px a frame."""
    rng = np.random.default_rng(5)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (120, 160, 3)).astype(np.uint8), (5, 5), 0)
    figure = cv2.GaussianBlur(rng.integers(0, 256, (80, 40, 3)).astype(np.uint8), (5, 5), 0)
    images = []
    for k in range(frames):
        x = 20 + 4 * k
        rgb, depth_m, mask = wall.copy(), np.full((120, 160), 3.0, np.float32), np.zeros((120, 160), np.bool_)
        rgb[30:110, x : x + 40] = figure
        depth_m[30:110, x : x + 40] = 1.5
        mask[30:110, x : x + 40] = True
        truth = Semantics(120, 160, (Box(x, 30, x + 39, 109, "person", 1.0),), mask)
        images.append(RgbdImage(1000.25 + k / 30, rgb, depth_m, 10 + k, truth=truth))
    return images


def nothing(folder: Path, images: list[RgbdImage]) -> Build:
    return NothingConfig().build


def truth_boxes(folder: Path, images: list[RgbdImage]) -> Build:
    return TrueSemanticsConfig().build


def truth_masks(folder: Path, images: list[RgbdImage]) -> Build:
    return TrueSemanticsConfig(masks=True).build


def masks_by_index(folder: Path, images: list[RgbdImage]) -> Build:
    for image in images:
        cv2.imwrite(str(folder / f"{image.index:06d}.png"), 255 * image.truth.mask.astype(np.uint8))
    return MaskFilesConfig(folder, dilate_px=2).build


def masks_by_time_with_a_gap(folder: Path, images: list[RgbdImage]) -> Build:
    for image in images[1:]:
        cv2.imwrite(str(folder / f"{image.timestamp_s:.5f}.png"), 255 * image.truth.mask.astype(np.uint8))
    return MaskFilesConfig(folder).build


def instance_files(folder: Path, images: list[RgbdImage]) -> Build:
    for image in images:
        numbers = image.truth.mask.astype(np.uint16)
        numbers[:70] *= 300
        cv2.imwrite(str(folder / f"{image.index:06d}.png"), numbers)
    return MaskFilesConfig(folder, dilate_px=2, instances=True).build


def carried(folder: Path, images: list[RgbdImage]) -> Build:
    return lambda: withhold(TrueSemanticsConfig(carry=CarryConfig(grow=0.5)).build(), [(12, 30)])


def withheld_masks(folder: Path, images: list[RgbdImage]) -> Build:
    return lambda: withhold(TrueSemanticsConfig(masks=True).build(), [(12, 14)])


CASES: list[Case] = [
    nothing,
    truth_boxes,
    truth_masks,
    masks_by_index,
    masks_by_time_with_a_gap,
    instance_files,
    carried,
    withheld_masks,
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_keeps_the_contract(case: Case, tmp_path: Path) -> None:
    images = a_walk()
    answers = check_segmenter(case(tmp_path, images), images)
    assert any(answer.has_any for answer in answers) == (case is not nothing)


@pytest.mark.parametrize("variant", ["1.1", "1.1-xl"])
@pytest.mark.parametrize("carry", [True, False])
def test_yolo_fastest_keeps_the_contract(variant: str, carry: bool, bonn: Path) -> None:
    files = [line.split() for line in (bonn / "rgb.txt").read_text().splitlines() if not line.startswith("#")]
    images = []
    for index in range(420, 424):
        stamp, name = files[index]
        rgb = cv2.cvtColor(cv2.imread(str(bonn / name)), cv2.COLOR_BGR2RGB)
        images.append(RgbdImage(float(stamp), rgb, np.zeros(rgb.shape[:2], np.float32), index))
    config = YoloFastestConfig(variant, carry=CarryConfig(enabled=carry))
    answers = check_segmenter(config.build, images)
    assert all(answer.boxes for answer in answers)


@pytest.mark.parametrize(("every", "latency_frames"), [(1, 0), (2, 1)])
def test_a_network_keeps_the_contract(every: int, latency_frames: int, tmp_path: Path) -> None:
    model = save_red_network(tmp_path / "red.onnx")
    config = red_config(model, every=every, latency_frames=latency_frames)
    answers = check_segmenter(config.build, [reddened(image) for image in a_walk()])
    assert all(answer.boxes and answer.mask.any() for answer in answers)
    assert max(box.carried for answer in answers for box in answer.boxes) == (0 if every == 1 else 2)


@pytest.mark.parametrize("carry", [True, False])
def test_a_detector_keeps_the_contract(carry: bool, tmp_path: Path) -> None:
    rows = np.array([[-20, 30, 50, 90, 0.9, 0], [60, 40, 900, 100, 0.7, 0], [10, 10, 90, 80, 0.8, 1]], np.float32)
    model = save_constant_detector(tmp_path / "detector.onnx", {"boxes": rows})
    config = OnnxBoxesConfig(model, "nms", classes=("person", "chair"), named=("chair",))
    answers = check_segmenter(replace(config, carry=CarryConfig(enabled=carry)).build, a_walk())
    assert all((len(answer.boxes), len(answer.named)) == (2, 1) for answer in answers)


@pytest.mark.parametrize(("every", "latency_frames"), [(1, 0), (2, 1)])
def test_an_instance_network_keeps_the_contract(every: int, latency_frames: int, tmp_path: Path) -> None:
    dets = np.array([[[-20, 30, 50, 90, 0.9], [60, 40, 900, 100, 0.7], [10, 10, 90, 80, 0.8]]], np.float32)
    labels = np.array([[0, 0, 56]])  # two people and a chair
    outputs = {"dets": dets, "labels": labels, "masks": np.ones((1, 3, 28, 28), np.float32)}
    model = save_constant_detector(tmp_path / "instances.onnx", outputs)
    config = OnnxInstancesConfig(model, masks_cover="box", named=("chair",), every=every, latency_frames=latency_frames)
    answers = check_segmenter(config.build, a_walk())
    assert all([one.label for one in answer.instances] == ["person", "person"] for answer in answers)
    assert all(len(answer.named) == 1 for answer in answers)
    assert max(box.carried for answer in answers for box in answer.boxes) == (0 if every == 1 else 2)


def test_onnx_masks_keep_the_contract(deeplab: Path, bonn: Path) -> None:
    dataset = open_dataset(str(bonn))
    config = OnnxMasksConfig(deeplab, every=2, latency_frames=1)
    answers = check_segmenter(config.build, [dataset.load(index) for index in range(420, 424)])
    assert all(answer.boxes and answer.mask.any() for answer in answers)


def test_pspnet_keeps_the_contract(bonn: Path) -> None:
    dataset = open_dataset(str(bonn))
    config = configure("pspnet-slam", overrides=["semantics.every=2", "semantics.latency_frames=1"]).semantics
    answers = check_segmenter(config.build, [dataset.load(index) for index in range(420, 424)])
    assert all(answer.boxes and answer.mask.any() for answer in answers)


class Fine:
    """A segmenter that keeps the contract; the classes below break one promise each."""

    def __call__(self, image: RgbdImage) -> Semantics:
        return self.spoil(Semantics(image.height, image.width, (self.box,), np.ones(image.gray.shape, np.bool_)))

    box = Box(3.0, 4.0, 50.0, 60.0, "person", 0.9)

    def spoil(self, answer: Semantics) -> Semantics:
        return answer


class Transposed(Fine):
    def spoil(self, answer: Semantics) -> Semantics:
        return replace(answer, height=answer.width, width=answer.height)


class ByteMask(Fine):
    def spoil(self, answer: Semantics) -> Semantics:
        return replace(answer, mask=answer.mask.astype(np.uint8))


class SmallMask(Fine):
    def spoil(self, answer: Semantics) -> Semantics:
        return replace(answer, mask=answer.mask[::2, ::2])


class InsideOut(Fine):
    box = Box(50.0, 4.0, 3.0, 60.0, "person", 0.9)


class UpsideDown(Fine):
    box = Box(3.0, 60.0, 50.0, 4.0, "person", 0.9)


class Outside(Fine):
    box = Box(3.0, 4.0, 160.0, 60.0, "person", 0.9)


class Nan(Fine):
    box = Box(3.0, 4.0, float("nan"), 60.0, "person", 0.9)


class PerCent(Fine):
    box = Box(3.0, 4.0, 50.0, 60.0, "person", 90.0)


class ClassNumber(Fine):
    box = Box(3.0, 4.0, 50.0, 60.0, 0, 0.9)


class FromTheFuture(Fine):
    box = Box(3.0, 4.0, 50.0, 60.0, "person", 0.9, carried=-1)


class Instances(Fine):
    """With an instance; the classes below break one promise of it each."""

    instance = Instance("person", 0.9, np.ones((30, 20), np.bool_), 5, 6, 120, 160)

    def spoil(self, answer: Semantics) -> Semantics:
        return replace(answer, instances=(self.instance,))


class ByteInstance(Instances):
    instance = replace(Instances.instance, pixels=np.ones((30, 20), np.uint8))


class OtherSizeInstance(Instances):
    instance = replace(Instances.instance, height=240, width=320)


class InstanceOutside(Instances):
    instance = replace(Instances.instance, x_px=150)


class InstancePerCent(Instances):
    instance = replace(Instances.instance, score=90.0)


class UnlabelledInstance(Instances):
    instance = replace(Instances.instance, label="")


class LooseInstance(Instances):
    instance = replace(Instances.instance, pixels=np.eye(30, 20, k=1, dtype=np.bool_))


class InstanceBeyondTheMask(Instances):
    def spoil(self, answer: Semantics) -> Semantics:
        return replace(super().spoil(answer), mask=np.eye(120, 160, dtype=np.bool_))


class OneInstanceBuffer(Instances):
    buffer = np.ones((30, 20), np.bool_)

    def spoil(self, answer: Semantics) -> Semantics:
        self.buffer[10:20, 10] ^= True
        return replace(answer, instances=(replace(self.instance, pixels=self.buffer),))


class Painter(Fine):
    def __call__(self, image: RgbdImage) -> Semantics:
        image.rgb[0, 0] ^= 255
        return super().__call__(image)


class DepthFiller(Fine):
    def __call__(self, image: RgbdImage) -> Semantics:
        image.depth_m[0, 0] += 1
        return super().__call__(image)


class Random(Fine):
    rng = np.random.default_rng(0)

    def spoil(self, answer: Semantics) -> Semantics:
        return replace(answer, boxes=(replace(self.box, confidence=float(self.rng.uniform())),))


class OneBuffer(Fine):
    buffer = np.zeros((120, 160), np.bool_)

    def spoil(self, answer: Semantics) -> Semantics:
        self.buffer[:] = ~self.buffer
        return replace(answer, mask=self.buffer)


class AfraidOfTheDark(Fine):
    def __call__(self, image: RgbdImage) -> Semantics:
        assert image.rgb.any(), "too dark"
        return super().__call__(image)


class Sloppy(Fine):
    def __call__(self, image: RgbdImage) -> Semantics:
        return [self.box]


def test_a_plain_segmenter_passes() -> None:
    assert len(check_segmenter(Fine, a_walk(3))) == 3
    assert all(answer.instances for answer in check_segmenter(Instances, a_walk(3)))


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (Transposed, r"semantics of \(160, 120\)"),
        (ByteMask, "mask is uint8, not bool"),
        (SmallMask, r"mask is \(60, 80\)"),
        (InsideOut, "inside out"),
        (UpsideDown, "inside out"),
        (Outside, "beyond the image"),
        (Nan, "not finite"),
        (PerCent, "not within 0 and 1"),
        (ClassNumber, "no text"),
        (FromTheFuture, "future"),
        (ByteInstance, r"pixels of Instance.* are uint8, not bool"),
        (OtherSizeInstance, "another image size"),
        (InstanceOutside, "beyond the image"),
        (InstancePerCent, "not within 0 and 1"),
        (UnlabelledInstance, "no label"),
        (LooseInstance, "not cropped to its pixels"),
        (InstanceBeyondTheMask, "reaches beyond the mask"),
        (OneInstanceBuffer, "changed after it was given"),
        (Painter, "changed rgb"),
        (DepthFiller, "changed depth_m"),
        (Random, "a fresh segmenter answers otherwise"),
        (OneBuffer, "changed after it was given"),
        (AfraidOfTheDark, "too dark"),
        (Sloppy, "is a list, not Semantics"),
    ],
)
def test_the_contract_notices(broken: type[Fine], said: str) -> None:
    with pytest.raises(AssertionError, match=said):
        check_segmenter(broken, a_walk(3))


def test_the_contract_wants_images() -> None:
    with pytest.raises(AssertionError, match="no images"):
        check_segmenter(Fine, [])


def test_carrying_is_part_of_the_contract_cases() -> None:
    """The case above must really carry, or it would prove nothing."""
    segmenter = carried(Path(), [])()
    assert isinstance(segmenter, CarriedBoxes)
    assert max(box.carried for image in a_walk() for box in segmenter(image).boxes) == 6
