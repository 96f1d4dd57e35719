"""Boxes over the frames in which the detector misses them: against a scene whose every pixel is known."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.data.semantics import Box
from stillroom.errors import ConfigError
from stillroom.presets.registry import configure
from stillroom.semantics.carried_boxes import CarriedBoxes, CarryConfig, Follower
from stillroom.semantics.detector import withhold

HEIGHT, WIDTH, TALL, BROAD, TOP = 240, 320, 150, 60, 60


def noise(seed, height, width):
    rng = np.random.default_rng(seed)
    return cv2.GaussianBlur(rng.integers(0, 256, (height, width, 3)).astype(np.uint8), (7, 7), 0)


WALL, FIGURE, OCCLUDER = noise(1, HEIGHT, WIDTH), noise(2, TALL, BROAD), noise(3, 200, 120)


def scene(index, x=None, figure=FIGURE, depth=True, occluder_x=None):
    """A wall at 3 m; a figure at 1.5 m with its left edge at x; perhaps something nearer before it."""
    rgb, depth_m = WALL.copy(), np.full((HEIGHT, WIDTH), 3.0, np.float32)

    def place(picture, x0, y0, z):
        left, right = max(0, x0), min(WIDTH, x0 + picture.shape[1])
        if left < right:
            rgb[y0 : y0 + len(picture), left:right] = picture[:, left - x0 : right - x0]
            depth_m[y0 : y0 + len(picture), left:right] = z

    if x is not None:
        place(figure, x, TOP, 1.5)
    if occluder_x is not None:
        place(OCCLUDER, occluder_x, 40, 0.8)
    return RgbdImage(index / 30, rgb, depth_m if depth else np.zeros_like(depth_m), index)


def box_at(x, confidence=0.9, label="person", y=TOP):
    return Box(
        float(np.clip(x, 0, WIDTH - 1)),
        float(y),
        float(np.clip(x + BROAD - 1, 0, WIDTH - 1)),
        float(y + TALL - 1),
        label,
        confidence,
    )


@dataclass
class Script:
    """A detector that finds what a script says."""

    boxes: dict[int, list[Box]] = field(default_factory=dict)

    def detect(self, image):
        return tuple(self.boxes.get(image.index, []))


def run(script, images, **options):
    segmenter = CarriedBoxes(Script(script), 0.8, CarryConfig(**options))
    return [segmenter(image).boxes for image in images]


def walk(frames, seen, step=4, start=20, **how):
    """A figure that walks; it is detected in the first frames only."""
    images = [scene(k, start + step * k, **how) for k in range(frames)]
    return {k: [box_at(start + step * k)] for k in range(seen)}, images


def test_nothing_is_computed_while_nothing_is_missed(monkeypatch):
    monkeypatch.setattr(Follower, "follow", lambda *_: pytest.fail("followed although nothing was missed"))
    monkeypatch.setattr(Follower, "begin", lambda *_: pytest.fail("looked at although nothing was missed"))
    script, images = walk(10, seen=10)
    for k, boxes in enumerate(run(script, images)):
        assert boxes == (replace(script[k][0], track_id=0),)


@pytest.mark.parametrize("step", [-3, 0, 4, 9])
@pytest.mark.parametrize("depth", [True, False])
def test_a_missed_box_follows_what_was_in_it(step, depth):
    start = 20 if step >= 0 else 200
    script, images = walk(20, seen=3, step=step, start=start, depth=depth)
    for k, boxes in enumerate(run(script, images)):
        (box,) = boxes
        assert box.carried == max(0, k - 2)
        assert box.track_id == 0
        np.testing.assert_allclose(box.xyxy_px, box_at(start + step * k).xyxy_px, atol=2.0)


def test_the_step_in_which_it_is_first_missed_counts_too():
    """Missed from the second frame on: no velocity is known, flow alone must tell."""
    script, images = walk(8, seen=1, step=7)
    (box,) = run(script, images)[-1]
    np.testing.assert_allclose(box.xyxy_px, box_at(20 + 7 * 7).xyxy_px, atol=2.0)


def test_it_is_given_up_after_max_carried_frames():
    script, images = walk(12, seen=3)
    answers = run(script, images, max_carried=4)
    assert [len(boxes) for boxes in answers] == [1] * 7 + [0] * 5
    assert [len(boxes) for boxes in run(script, images, max_carried=0)] == [1] * 3 + [0] * 9


def test_it_is_dropped_when_the_figure_is_gone():
    """Gone between two frames, as when a door closes: the wall is seen where the figure stood."""
    script, images = walk(3, seen=3, step=0)
    script[5] = [box_at(20)]  # missed and present in frame 3, gone in 4
    images += [scene(3, 20), scene(4, None), scene(5, 20)]
    answers = run(script, images)
    assert [len(boxes) for boxes in answers] == [1, 1, 1, 1, 0, 1]
    assert answers[5][0].track_id == 1, "what comes after is another one"


def test_it_is_kept_while_something_nearer_hides_it():
    script, images = walk(3, seen=3, step=0, start=100)
    images += [scene(k, 100, occluder_x=70) for k in range(3, 9)]
    answers = run(script, images)
    for boxes in answers:
        np.testing.assert_allclose(boxes[0].xyxy_px, box_at(100).xyxy_px, atol=2.0)
    # When what hid it has passed and there is nothing, it has left behind the other's back.
    gone = run(script, [*images, scene(9, None)])
    assert gone[-1] == ()


def test_it_is_dropped_when_it_has_left_the_image():
    script, images = walk(30, seen=3, step=8, start=190)
    answers = run(script, images)
    for k, boxes in enumerate(answers):
        visible = np.clip(WIDTH - (190 + 8 * k), 0, BROAD) / BROAD
        if visible > 0.3:
            assert len(boxes) == 1, k
        if visible < 0.1:
            assert boxes == (), k


def test_how_much_must_be_visible_is_a_choice():
    script, images = walk(12, seen=3, step=8, start=190)
    visible = [np.clip(WIDTH - (190 + 8 * k), 0, BROAD) / BROAD for k in range(12)]
    for boxes, share in zip(run(script, images, min_visible=0.75), visible, strict=True):
        if abs(share - 0.75) > 0.05:
            assert len(boxes) == (share > 0.75)


def test_a_new_detection_replaces_what_was_carried():
    images = [scene(k, 100) for k in range(4)]
    larger = replace(box_at(100), x_min_px=90.0, y_max_px=230.0)
    answers = run({0: [box_at(100)], 2: [larger]}, images)
    assert [boxes[0].carried for boxes in answers] == [0, 1, 0, 1]
    np.testing.assert_allclose(answers[1][0].xyxy_px, box_at(100).xyxy_px, atol=1.0)
    np.testing.assert_allclose(answers[3][0].xyxy_px, larger.xyxy_px, atol=1.0)


def test_one_who_runs_is_met_where_the_velocity_leads():
    """The last steps, 40 px, leave an overlap of 0.2 with where the box was; 0.3 is asked for."""
    places = [20, 45, 80, 120, 160]
    answers = run({k: [box_at(x)] for k, x in enumerate(places)}, [scene(k) for k in range(5)])
    assert [[box.track_id for box in boxes] for boxes in answers] == [[0]] * 5


def test_a_figure_without_texture_goes_on_with_its_velocity():
    flat = np.full_like(FIGURE, 90)
    script, images = walk(10, seen=5, figure=flat)
    (box,) = run(script, images)[-1]
    np.testing.assert_allclose(box.xyxy_px, box_at(20 + 4 * 9).xyxy_px, atol=6.0)
    script, images = walk(10, seen=5, figure=flat, depth=False)
    for image in images:
        image.rgb[:] = 90  # no corner, no depth: nothing speaks for it
    assert run(script, images)[5] == ()


def test_a_weak_detection_continues_but_does_not_begin():
    images = [scene(k, 100) for k in range(4)]
    weak, strong = box_at(100, 0.5), box_at(100, 0.85)
    answers = run({0: [weak], 1: [strong], 2: [weak], 3: [box_at(100, 0.3)]}, images)
    assert answers[0] == ()
    assert [(boxes[0].confidence, boxes[0].carried) for boxes in answers[1:]] == [(0.85, 0), (0.5, 0), (0.5, 1)]
    answers = run({0: [strong], 1: [weak]}, images[:2], continue_confidence=0.6)
    assert answers[1][0].carried == 1


def test_a_weak_detection_begins_at_the_left_and_right_border_only():
    for x, believed in ((0, True), (WIDTH - BROAD, True), (100, False)):
        (boxes,) = run({0: [box_at(x, 0.6)]}, [scene(0, x)])
        assert len(boxes) == believed
        (boxes,) = run({0: [box_at(x, 0.6)]}, [scene(0, x)], enter_confidence=0.8)
        assert boxes == ()


def test_two_who_cross_keep_their_identities():
    left, right = [20 + 8 * k for k in range(25)], [240 - 8 * k for k in range(25)]
    script = {k: [box_at(left[k]), box_at(right[k], 0.95, y=TOP - 20)] for k in range(25)}
    answers = run(script, [scene(k) for k in range(25)])
    for k, boxes in enumerate(answers):
        by_id = {box.track_id: box for box in boxes}
        assert sorted(by_id) == [0, 1], k
        assert by_id[0].x_min_px == left[k]
        assert by_id[1].x_min_px == right[k]


def test_classes_do_not_continue_each_other_but_one_thing_has_one_box():
    images = [scene(k, 100) for k in range(2)]
    answers = run({0: [box_at(100)], 1: [box_at(100, label="dog")]}, images)
    assert [(box.label, box.track_id, box.carried) for box in answers[1]] == [("dog", 1, 0)]
    answers = run({0: [box_at(100)], 1: [box_at(140, label="dog")]}, images)
    assert [(box.label, box.track_id, box.carried) for box in answers[1]] == [("dog", 1, 0), ("person", 0, 1)]


def test_dropped_images_count_as_carried_frames():
    script, images = walk(20, seen=5)
    answers = run(script, [*images[:5], images[8], images[12], *images[13:]], max_carried=8)
    assert [boxes[0].carried for boxes in answers[5:7]] == [4, 8]
    assert all(boxes == () for boxes in answers[7:])


def test_between_the_images_that_the_detector_sees_boxes_move_on_at_their_velocity():
    asked = []

    class Counting(Script):
        def detect(self, image):
            asked.append(image.index)
            return super().detect(image)

    script, images = walk(14, seen=14)
    segmenter = CarriedBoxes(Counting(script), 0.8, CarryConfig(every=2))
    answers = [segmenter(image).boxes for image in images]
    assert asked == list(range(0, 14, 2))
    for k, (box,) in enumerate(answers):
        assert (box.track_id, box.carried) == (0, k % 2)
        if k >= 9:  # the velocity is a running mean, of zero at first
            known = box_at(20 + 4 * (k - k % 2)), box_at(20 + 4 * k)
            around = known[0].x_min_px, known[0].y_min_px, known[1].x_max_px, known[0].y_max_px
            np.testing.assert_allclose(box.xyxy_px, around, atol=1.0)
    slow = CarriedBoxes(Counting(script), 0.8, CarryConfig(every=2))
    asked.clear()
    for image in images:
        slow(replace(image, timestamp_s=3.0 * image.timestamp_s))
    assert asked == list(range(14)), "a camera of 10 Hz"


def test_a_box_that_is_missed_at_a_stride_follows_what_was_in_it():
    script, images = walk(12, seen=5)
    answers = run(script, images, every=2)
    assert [boxes[0].carried for boxes in answers] == [0, 1, 0, 1, 0, 1, 2, 3, 4, 5, 6, 7]
    np.testing.assert_allclose(answers[10][0].xyxy_px, box_at(20 + 4 * 10).xyxy_px, atol=2.0)


def test_a_step_back_asks_the_detector_at_once():
    script, images = walk(5, seen=5)
    segmenter = CarriedBoxes(Script(script), 0.8, CarryConfig(every=2))
    for image in images[:2]:
        segmenter(image)
    assert [box.carried for box in segmenter(images[0]).boxes] == [0]


def test_going_back_in_time_forgets():
    script, images = walk(5, seen=3)
    segmenter = CarriedBoxes(Script(script), 0.8, CarryConfig())
    for image in images:
        segmenter(image)
    assert segmenter(scene(4, 20)).boxes == ()


def test_boxes_grow_on_request_and_stay_in_the_image():
    (boxes,) = run({0: [box_at(100)]}, [scene(0, 100)], grow=0.1)
    by = np.array([-5.9, -5.9, 5.9, 5.9])  # a tenth of 59 px
    np.testing.assert_allclose(boxes[0].xyxy_px, box_at(100).xyxy_px + by)
    (boxes,) = run({0: [box_at(0)]}, [scene(0, 0)], grow=5.0)
    assert boxes[0].xyxy_px == (0, 0, WIDTH - 1, HEIGHT - 1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"min_iou": 1.5}, "carry.min_iou' is 1.5; it must be from 0 to 1"),
        ({"continue_confidence": -0.1}, "carry.continue_confidence"),
        ({"max_carried": -1}, "carry.max_carried' is -1; it must be 0 or more"),
    ],
)
def test_impossible_values(options, said):
    with pytest.raises(ConfigError, match=said):
        run({}, [], **options)


def test_real_people_stay_covered_while_the_detector_is_off(bonn: Path):
    """Frames 450–470 of the Bonn stretch, three people, nobody enters: boxes with the detector on are the oracle."""
    images = [load_bonn(bonn, index) for index in range(445, 470)]
    config = configure("oc-slam").semantics
    full, cut = config.build(), withhold(config.build(), [(450, 470)])
    covered = present = 0
    for image in images:
        truth, carried = full(image), cut(image)
        if image.index >= 450:
            assert carried.boxes
            assert all(box.carried == image.index - 449 for box in carried.boxes)
            covered += np.count_nonzero(truth.movable & carried.movable)
            present += np.count_nonzero(truth.movable)
    assert covered / present > 0.85


def load_bonn(folder: Path, index: int) -> RgbdImage:
    def rows(name):
        return [line.split() for line in (folder / name).read_text().splitlines() if not line.startswith("#")]

    stamp, file = rows("rgb.txt")[index]
    _, depth_file = min(rows("depth.txt"), key=lambda row: abs(float(row[0]) - float(stamp)))
    rgb = cv2.cvtColor(cv2.imread(str(folder / file)), cv2.COLOR_BGR2RGB)
    depth = cv2.imread(str(folder / depth_file), cv2.IMREAD_UNCHANGED)
    return RgbdImage(float(stamp), rgb, depth.astype(np.float32) / 5000, index)


def test_a_chair_that_is_found_does_not_uncover_who_sits_on_it():
    script, images = walk(6, seen=3)
    chairs = {k: [*script.get(k, []), box_at(20 + 4 * k, label="chair")] for k in range(6)}
    told_apart = CarriedBoxes(Script(chairs), 0.8, CarryConfig(), named=("chair",))
    answers = [told_apart(image) for image in images]
    assert [[(box.label, box.carried) for box in answer.boxes] for answer in answers] == [
        [("person", max(k - 2, 0))] for k in range(6)
    ]
    assert [[(box.label, box.carried) for box in answer.named] for answer in answers] == [[("chair", 0)]] * 6
    fresh = told_apart.with_detector(Script(chairs))(images[0])
    assert [box.label for box in fresh.named] == ["chair"]
    assert "person" not in [box.label for box in run(chairs, images)[-1]]
