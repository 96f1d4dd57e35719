"""A network that sees keyframes only: how often it runs, and where its masks are in the images between."""

from pathlib import Path

import numpy as np
import pytest
from red_network import red_config, reddened, save_red_network

from stillroom.bench.trial import noting_of
from stillroom.data.image import RgbdImage
from stillroom.datasets.open import open_dataset
from stillroom.pipeline import RunOptions, run
from stillroom.presets.registry import configure
from stillroom.protocols import KeyframeSegmenter
from stillroom.schedule import InOrder, LiveSchedule
from stillroom.semantics.detector import withhold
from stillroom.semantics.masks.onnx_masks import OnnxKeyframeMasks, OnnxMasks, Reading
from stillroom.semantics.masks.pspnet import PspNetConfig, PspNetwork
from stillroom.system import build
from stillroom.testing.segmenter_contract import check_segmenter

FRAMES = 24


@pytest.fixture(scope="module")
def images() -> list[RgbdImage]:
    """Two people who walk through the middle of the image, past a camera that moves."""
    dataset = open_dataset("synthetic:walking,frames=90,cache=off")
    return [reddened(dataset.load(place)) for place in range(54, 66)]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_red_network(tmp_path_factory.mktemp("model") / "red.onnx")


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The images that a network is run on, in order."""
    seen: list[int] = []
    segments = Reading.segments

    def counted(self, image, view):
        seen.append(image.index)
        return segments(self, image, view)

    monkeypatch.setattr(Reading, "segments", counted)
    return seen


def iou(mask: np.ndarray, truth: np.ndarray) -> float:
    return np.count_nonzero(mask & truth) / np.count_nonzero(mask | truth)


def test_only_what_sees_keyframes_is_a_keyframe_segmenter(model: Path) -> None:
    assert isinstance(red_config(model, sees="keyframes").build(), KeyframeSegmenter)
    assert not isinstance(red_config(model).build(), KeyframeSegmenter)
    assert isinstance(PspNetConfig(sees="keyframes").build(), OnnxKeyframeMasks)
    usual = PspNetConfig().build()
    assert isinstance(usual, OnnxMasks)
    assert not isinstance(usual, KeyframeSegmenter)


def test_the_first_image_is_seen_at_once_and_once(model: Path, images: list[RgbdImage], runs: list[int]) -> None:
    network = red_config(model, sees="keyframes").build()
    first = network(images[0])
    again = network.see(images[0])
    assert runs == [images[0].index]
    np.testing.assert_array_equal(first.mask, again.mask)
    assert iou(first.mask, images[0].truth.mask) > 0.97


def test_masks_of_a_keyframe_are_carried_on_and_those_of_the_next_replace_them(
    model: Path, images: list[RgbdImage], runs: list[int]
) -> None:
    network = red_config(model, sees="keyframes").build()
    answers = []
    for place, image in enumerate(images):
        answers.append(network(image))
        if place in (0, 6):
            found = network.see(image)
            assert iou(found.mask, image.truth.mask) > 0.97
            assert max(box.carried for box in found.boxes) == 0
    assert runs == [images[0].index, images[6].index]
    ages = [max(box.carried for box in answer.boxes) for answer in answers]
    assert ages == [0, 1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5]
    stale = iou(images[0].truth.mask, images[6].truth.mask)
    for answer, image in zip(answers, images, strict=True):
        assert iou(answer.mask, image.truth.mask) > max(0.75, stale + 0.05)
    # The step after a keyframe starts from what the network saw there.
    assert iou(answers[7].mask, images[7].truth.mask) > iou(answers[6].mask, images[6].truth.mask)


def test_a_result_that_comes_after_later_images_is_carried_past_them(model: Path, images: list[RgbdImage]) -> None:
    late, prompt = (red_config(model, sees="keyframes").build() for _ in range(2))
    for image in images[:9]:
        late(image)
    late.see(images[6])  # 7 and 8 were called already
    for image in images[:7]:
        prompt(image)
    prompt.see(images[6])
    for image in images[7:9]:
        prompt(image)
    for image in images[9:]:
        one, other = late(image), prompt(image)
        np.testing.assert_array_equal(one.mask, other.mask)
        assert one.boxes == other.boxes


def test_a_step_back_starts_afresh(model: Path, images: list[RgbdImage], runs: list[int]) -> None:
    network = red_config(model, sees="keyframes").build()
    first = [network(image) for image in images[:4]]
    again = [network(image) for image in images[:4]]
    assert runs == [images[0].index] * 2
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.mask, other.mask)


def test_an_image_that_is_no_longer_kept_is_seen_all_the_same(model: Path, images: list[RgbdImage]) -> None:
    network = red_config(model, sees="keyframes").build()
    network(images[4])
    before = network(images[5])
    found = network.see(images[0])
    assert iou(found.mask, images[0].truth.mask) > 0.97
    after = network(images[6])
    assert iou(after.mask, images[6].truth.mask) > 0.75
    assert before.boxes[0].carried + 1 == after.boxes[0].carried, "what comes after starts from where it was"


def test_it_keeps_the_contract(model: Path, images: list[RgbdImage]) -> None:
    answers = check_segmenter(red_config(model, sees="keyframes").build, images[:6])
    assert all(answer.mask.any() for answer in answers)


@pytest.mark.parametrize("live", [False, True])
def test_only_keyframes_reach_the_shipped_network(live: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real PSPNet in the preset, with a session that is counted and finds nothing."""
    saw: list[np.ndarray] = []

    def counted(self, rgb: np.ndarray, width: int, height: int) -> np.ndarray:
        saw.append(rgb)
        return np.zeros((14, height, width), np.float32)

    monkeypatch.setattr(PspNetwork, "probabilities", counted)
    dataset = open_dataset(f"synthetic:walking,frames={FRAMES}")
    images = [dataset.load(place) for place in range(len(dataset))]
    system = build(configure("pspnet-slam-paper"), dataset.camera, schedule=LiveSchedule() if live else InOrder())
    for image in images:
        system.process(image)
    system.close()
    keyframes = [result.index for result in system.results if result.is_keyframe]
    assert [next(image.index for image in images if image.rgb is rgb) for rgb in saw] == keyframes
    assert keyframes[0] == images[0].index
    assert 2 <= len(keyframes) < FRAMES


def test_what_wraps_a_segmenter_leaves_it_one_of_keyframes(
    model: Path, images: list[RgbdImage], runs: list[int]
) -> None:
    """Runs and benches wrap the segmenter; a network that is not told of keyframes would see the first image alone."""
    for wrap in (lambda one: withhold(one, [(images[2].index, images[3].index)]), noting_of):
        runs.clear()
        wrapped, plain = wrap(red_config(model, sees="keyframes").build()), red_config(model, sees="keyframes").build()
        assert isinstance(wrapped, KeyframeSegmenter)
        assert not isinstance(wrap(red_config(model).build()), KeyframeSegmenter)
        for image in images[:2]:
            np.testing.assert_array_equal(wrapped(image).mask, plain(image).mask)
        np.testing.assert_array_equal(wrapped.see(images[1]).mask, plain.see(images[1]).mask)
        assert runs == [images[0].index] * 2 + [images[1].index] * 2
        wrapped(images[2])
        found = wrapped.see(images[2])
        assert found.has_any == (wrap is noting_of)


def test_a_run_of_the_preset_shows_its_network_the_keyframes(runs: list[int]) -> None:
    outcome = run(open_dataset("synthetic:walking,frames=12"), configure("pspnet-slam-paper"), RunOptions(root=None))
    assert runs == [result.index for result in outcome.system.results if result.is_keyframe]
    assert len(runs) >= 2
