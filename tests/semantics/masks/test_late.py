"""Masks of a network that is late, carried to the present: against the renderer's masks."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from red_network import red_config, reddened, save_red_network

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Semantics
from stillroom.datasets.open import open_dataset
from stillroom.semantics.masks.carried_masks import LateMasks, MaskCarryConfig
from stillroom.semantics.masks.mask_segments import HalfImage, MaskSegments
from stillroom.semantics.masks.refine import (
    COMES,
    FAR_M,
    FEWEST,
    GOES,
    RefineConfig,
    border_verdicts,
    empty_sums,
    means_along,
    refined,
    slide_to,
)

Share = tuple[float, float, float]


@pytest.fixture(scope="module")
def images() -> list[RgbdImage]:
    """Two people who walk through the middle of the image, one before the other, past a camera that moves."""
    dataset = open_dataset("synthetic:walking,frames=90,cache=off")
    return [reddened(dataset.load(place)) for place in range(54, 72)]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_red_network(tmp_path_factory.mktemp("model") / "red.onnx")


def compared(masks: list[np.ndarray], truth: list[np.ndarray]) -> Share:
    """Return intersection over union, recall and precision over all pixels."""
    both = sum(np.count_nonzero(a & b) for a, b in zip(masks, truth, strict=True))
    told, true = (sum(np.count_nonzero(mask) for mask in all_) for all_ in (masks, truth))
    return both / (told + true - both), both / true, both / told


def told(model: Path, images: list[RgbdImage], every: int, latency_frames: int) -> list[Semantics]:
    segmenter = red_config(model, every=every, latency_frames=latency_frames).build()
    return [segmenter(image) for image in images]


def shares(answers: list[Semantics], images: list[RgbdImage], skip: int = 0) -> Share:
    return compared([a.mask for a in answers][skip:], [image.truth.mask for image in images][skip:])


def test_a_network_in_time_is_believed(model: Path, images: list[RgbdImage]) -> None:
    iou, _, _ = shares(told(model, images, 1, 0), images)
    assert iou > 0.97


@pytest.mark.parametrize(
    ("every", "latency_frames", "least"),
    [(3, 0, (0.92, 0.95, 0.95)), (1, 2, (0.90, 0.93, 0.94)), (3, 5, (0.80, 0.88, 0.88))],
)
def test_carried_masks_lie_on_the_people(
    every: int, latency_frames: int, least: Share, model: Path, images: list[RgbdImage]
) -> None:
    answers = told(model, images, every, latency_frames)
    assert np.greater(shares(answers, images, latency_frames), least).all()
    # Masks left where they were seen would be far off: that is what is mended.
    seen = [image.truth.mask for image in images]
    stale = compared(seen[: len(seen) - latency_frames - every], seen[latency_frames + every :])
    assert stale[0] < least[0] - 0.05


def test_answers_come_when_they_are_due(model: Path, images: list[RgbdImage]) -> None:
    ages = [max(box.carried for box in answer.boxes) for answer in told(model, images, 3, 5)]
    # Seen: 0, 3, 6, 9, 12. The first is waited for; that of 3 is known at 8, that of 6 at 11.
    assert ages == [0, 1, 2, 3, 4, 5, 6, 7, 5, 6, 7, 5, 6, 7, 5, 6, 7, 5]


def test_it_is_repeatable_and_starts_afresh_at_a_step_back(model: Path, images: list[RgbdImage]) -> None:
    segmenter = red_config(model, every=2, latency_frames=3).build()
    first = [segmenter(image) for image in images[:8]]
    again = [segmenter(image) for image in images[:8]]
    for one, other in zip(first, again, strict=True):
        assert one.boxes == other.boxes
        assert np.array_equal(one.mask, other.mask)


def test_people_who_come_later_are_known_as_soon_as_the_answer_is(model: Path, images: list[RgbdImage]) -> None:
    from dataclasses import replace

    gray = [replace(image, rgb=np.repeat(image.gray[..., None], 3, axis=2)) for image in images]
    answers = told(model, gray[:4] + images[4:12], 2, 3)
    known = [answer.has_any for answer in answers]
    assert known == [False] * 7 + [True] * 5  # seen at 4, known at 7


# The border


def blurred(truth: np.ndarray, threshold: float) -> MaskSegments:
    """Return a mask as a network of output stride 16 tells it, too large or too small by the threshold."""
    coarse = cv2.resize(truth.astype(np.float32), (40, 30), interpolation=cv2.INTER_AREA)
    likely = cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_LINEAR)
    return MaskSegments((likely >= threshold).astype(np.uint8), likely)


@pytest.mark.parametrize(("threshold", "gain"), [(0.2, 0.05), (0.5, 0.005), (0.8, 0.05)])
def test_depth_mends_the_border(threshold: float, gain: float, images: list[RgbdImage]) -> None:
    truth = [image.truth.mask[::2, ::2] for image in images]
    rough = [blurred(mask, threshold) for mask in truth]
    mended = [refined(s, HalfImage.of(i).depth_m, RefineConfig()) for s, i in zip(rough, images, strict=True)]
    before, _, _ = compared([s.mask for s in rough], truth)
    after, _, _ = compared([s.mask for s in mended], truth)
    assert after > before + gain


def plain(depth_m: np.ndarray, mask: np.ndarray) -> np.ndarray:
    likely = mask.astype(np.float32)
    return refined(MaskSegments(mask.astype(np.uint8), likely), depth_m.astype(np.float32), RefineConfig()).mask


def test_the_border_moves_to_the_jump_and_no_farther_than_the_band() -> None:
    depth_m = np.full((120, 160), 3.0)
    body = np.zeros((120, 160), np.bool_)
    body[20:100, 50:110] = True
    depth_m[body] = 1.5
    shifted = np.roll(body, 3, axis=1)
    assert np.array_equal(plain(depth_m, shifted), body)
    far_off = np.roll(body, 12, axis=1)
    assert np.count_nonzero(plain(depth_m, far_off) & ~far_off) <= 80 * (RefineConfig().band_px // 2 + 1)


@pytest.mark.parametrize("window_px", [3, 8, 45, 90])
def test_means_in_windows_are_those_of_box_filters(window_px: int) -> None:
    rng = np.random.default_rng(window_px)
    depth_m = rng.uniform(0.5, 4.0, (60, 77)).astype(np.float32)
    which = rng.integers(-1, 2, depth_m.shape).astype(np.int8)
    mean_m, n_pixels = np.empty((2, 60, 77), np.float32), np.empty((2, 60, 77), np.int32)
    sums = empty_sums(77, window_px)
    for y in range(60):
        slide_to(y, depth_m, which, window_px, sums)
        means_along(window_px, sums)
        mean_m[:, y], n_pixels[:, y] = sums.mean_m, sums.n_pixels
    for kind in range(2):
        count, mean = box_means(depth_m, which == kind, window_px)
        np.testing.assert_array_equal(n_pixels[kind], count)
        np.testing.assert_allclose(mean_m[kind], mean, atol=1e-5)


def box_means(depth_m: np.ndarray, chosen: np.ndarray, window_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how many chosen pixels (h, w) are in the window around each, and the mean of their depths [m]."""
    weight, size, outside = chosen.astype(np.float64), (window_px, window_px), cv2.BORDER_CONSTANT
    count = np.rint(cv2.boxFilter(weight, -1, size, normalize=False, borderType=outside))
    total_m = cv2.boxFilter(weight * depth_m, -1, size, normalize=False, borderType=outside)
    return count, total_m / np.maximum(count, 1.0)


def plain_verdicts(
    depth_m: np.ndarray, mask: np.ndarray, inner: np.ndarray, outer: np.ndarray, window_px: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return what `border_verdicts` says as two masks (h, w)."""
    known, config = depth_m > 0, RefineConfig()
    kinds = [inner & known, outer & known & ~inner]
    first = [box_means(depth_m, kind, window_px)[1] for kind in kinds]
    off_m = [np.abs(depth_m - mean) for mean in first]
    near = [kind & (off < FAR_M) for kind, off in zip(kinds, off_m, strict=True)]
    (n_body, body_m), (n_ground, ground_m) = (box_means(depth_m, kind, window_px) for kind in near)
    to_body, to_ground = np.abs(depth_m - body_m), np.abs(depth_m - ground_m)
    in_band, has_ground = known & (n_body >= FEWEST) & ~inner & ~outer, n_ground >= FEWEST
    goes = in_band & mask & (to_body > config.jump_m) & has_ground & (2.0 * to_ground < to_body)
    comes = in_band & ~mask & (to_body < config.near_m) & (~has_ground | (to_ground > config.jump_m))
    return goes, comes


@pytest.mark.parametrize("window_px", [15, 24])
def test_verdicts_on_a_border_are_those_of_plain_array_operations(window_px: int) -> None:
    rng = np.random.default_rng(window_px)
    column, row = np.meshgrid(np.arange(90), np.arange(70))
    edge = np.where(row % 20 < 10, 42, 48)
    depth_m = np.where(column < edge, 1.5, 2.4) + rng.choice([0.0, 0.2, 0.5], edge.shape)
    depth_m += rng.normal(0.0, 0.02, edge.shape)
    depth_m = np.where(rng.random(edge.shape) < 0.1, 0.0, depth_m).astype(np.float32)
    mask, inner, outer = column < 45, column < 40, column > 46
    limits = np.float32(RefineConfig().jump_m), np.float32(RefineConfig().near_m)
    found = border_verdicts(depth_m, mask, inner, outer, window_px, *limits)
    goes, comes = plain_verdicts(depth_m, mask, inner, outer, window_px)
    assert goes.any()
    assert comes.any()
    np.testing.assert_array_equal(found == GOES, goes)
    np.testing.assert_array_equal(found == COMES, comes)


def test_where_depth_does_not_jump_or_is_unknown_the_network_has_the_last_word() -> None:
    mask = np.zeros((120, 160), np.bool_)
    mask[20:100, 50:110] = True
    assert np.array_equal(plain(np.full((120, 160), 2.0), mask), mask)
    assert np.array_equal(plain(np.zeros((120, 160)), mask), mask)


def test_a_mask_of_nothing_costs_no_flow(monkeypatch: pytest.MonkeyPatch, images: list[RgbdImage]) -> None:
    def see(image: RgbdImage, view: HalfImage) -> MaskSegments:
        return MaskSegments(np.zeros(view.shape, np.uint8), np.zeros(view.shape, np.float32))

    def fail(*_: object) -> None:
        raise AssertionError("flow was measured")

    monkeypatch.setattr(HalfImage, "flow_to", fail)
    masks = LateMasks(see, 3, 2, MaskCarryConfig(), RefineConfig())
    assert not any(masks(image).segments.has_any for image in images)
