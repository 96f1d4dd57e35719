"""What is learnt from: what is held out, and labels that follow their picture through every variation."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from examples import PERSON, example, people_example

from stillroom.errors import ConfigError, DatasetError
from stillroom_train.pspnet.pictures.batches import Batches
from stillroom_train.pspnet.pictures.example import PEOPLE, ROOM, images_in, read_mask, read_rgb, split
from stillroom_train.pspnet.pictures.vary import varied, with_stranger
from stillroom_train.pspnet.recipe import Recipe, Variation, preset

PLAIN = Variation(colors=False, blurs=0.0, noisy=0.0)


def test_every_fifth_picture_in_sorted_order_is_held_out() -> None:
    names = [Path(f"{letter}.jpg") for letter in "kbdcaefjghi"]
    learnt, kept = split(names)
    assert [path.stem for path in kept] == ["a", "f", "k"]
    assert [path.stem for path in learnt] == list("bcdeghij")


def test_pictures_and_masks_are_read(tmp_path: Path) -> None:
    for folder in ("images", "masks"):
        (tmp_path / folder).mkdir()
    rgb = np.zeros((20, 30, 3), np.uint8)
    rgb[..., 0] = 250  # red
    cv2.imwrite(str(tmp_path / "images" / "a.png"), rgb[..., ::-1])
    cv2.imwrite(str(tmp_path / "masks" / "a.png"), np.full((20, 30), 130, np.uint8))
    (path,) = images_in(tmp_path / "images")
    assert read_rgb(path)[0, 0].tolist() == [250, 0, 0]
    assert set(np.unique(read_mask(path))) == {255}
    (tmp_path / "masks" / "a.png").unlink()
    with pytest.raises(DatasetError, match="each image in images/ needs one"):
        read_mask(path)
    with pytest.raises(DatasetError, match="no images here"):
        images_in(tmp_path)


@pytest.mark.parametrize("seed", range(6))
def test_labels_follow_the_picture(seed: int) -> None:
    """The person is drawn in pure red on blue: what is red in the view is what its label says."""
    view = varied(people_example(), (97, 129), PLAIN, np.random.default_rng(seed))
    assert view.rgb.shape == (97, 129, 3)
    assert view.classes.shape == (25, 33, 21)
    assert view.weight.shape == (25, 33)
    np.testing.assert_allclose(view.classes.sum(-1), 1.0, atol=1e-5)
    red = (view.rgb[::4, ::4, 0] > 127).astype(np.float32)
    sure = (cv2.erode(red, np.ones((3, 3))) > 0) | (cv2.dilate(red, np.ones((3, 3))) == 0)
    known = sure & (view.weight > 0)
    assert known.sum() > 40
    np.testing.assert_array_equal(view.classes[known][:, PERSON] > 0.5, red[known] > 0.5)


@pytest.mark.parametrize("seed", range(4))
def test_the_teachers_classes_follow_the_picture(seed: int) -> None:
    """Left half a chair, right half a sofa, in two shades: classes and shades agree."""
    rgb = np.full((120, 160, 3), 60, np.uint8)
    rgb[:, 80:] = 200
    soft = np.zeros((15, 20, 21), np.float16)
    soft[:, :10, 9], soft[:, 10:, 18] = 1.0, 1.0
    view = varied(example(ROOM, rgb, soft=soft), (97, 97), PLAIN, np.random.default_rng(seed))
    shade = view.rgb[::4, ::4, 0]
    known = view.weight > 0
    chair, sofa = known & (shade < 80), known & (shade > 180)
    assert (view.classes[chair][:, 9] > 0.5).mean() > 0.93
    assert (view.classes[sofa][:, 18] > 0.5).mean() > 0.93


def test_outside_of_the_picture_nothing_is_known() -> None:
    variation = Variation(smallest=0.4, largest=0.41, rotation_deg=0.0, colors=False, blurs=0.0, noisy=0.0)
    view = varied(people_example(), (97, 97), variation, np.random.default_rng(1))
    assert 0.02 < view.weight.mean() < 0.2
    assert not view.weight[(view.rgb[::4, ::4] == 127).all(-1)].any()


def test_somebody_whom_the_mask_leaves_out_is_not_learnt_from() -> None:
    rgb = np.zeros((96, 96, 3), np.uint8)
    person = np.zeros((96, 96), np.uint8)
    person[10:40, 10:30] = 255
    soft = np.zeros((12, 12, 21), np.float16)
    soft[..., 0] = 1.0
    soft[1:5, 1:4], soft[7:11, 8:11] = np.eye(21)[PERSON], np.eye(21)[PERSON]  # the one of the mask, and another
    upright = Variation(1.0, 1.0001, rotation_deg=0.0, colors=False, blurs=0.0, noisy=0.0)
    for knows_all in (False, True):
        view = varied(example(PEOPLE, rgb, person, soft, knows_all), (97, 97), upright, np.random.default_rng(0))
        # Mirrored or not, the stranger is in the lower half, the known one in the upper.
        assert view.weight[:11, 1:-1].all()
        assert view.weight[13:23, 1:-1].all() == knows_all
        assert view.classes[13:, :, PERSON].max() == 0.0


def test_strangers_stand_in_rooms_with_their_mask() -> None:
    room = example(ROOM, np.full((120, 160, 3), (0, 0, 255), np.uint8))
    lot = np.random.default_rng(3)
    shares = []
    for _ in range(20):
        made = with_stranger(room, people_example(), lot)
        red = made.rgb[..., 0] > 127
        assert (red != (made.person > 127)).mean() < 0.03
        shares.append(red.mean())
    assert max(shares) > 0.1
    assert not room.person.any()


def test_a_batch_depends_on_seed_step_and_process_alone() -> None:
    examples = [people_example(), example(ROOM, np.full((120, 160, 3), 90, np.uint8))]
    recipe = Recipe(batch=2, crop=("65x65", "49x81"))
    one, two = Batches(examples, recipe, seed=1), Batches(examples, recipe, seed=1)
    one.at(0)
    again, same = one.at(5), two.at(5)
    np.testing.assert_array_equal(again.rgb, same.rgb)
    assert again.rgb.shape == (2, 3, 49, 81)
    assert again.classes.shape == (2, 21, 13, 21)
    assert not np.array_equal(again.rgb, Batches(examples, recipe, seed=2).at(5).rgb)
    assert not np.array_equal(again.rgb, Batches(examples, recipe, seed=1, process=1).at(5).rgb)
    with pytest.raises(DatasetError, match="no pictures of people"):
        Batches(examples[1:], recipe, seed=1)


def test_the_papers_recipe() -> None:
    paper = preset("paper")
    assert (paper.batch, paper.rate, paper.weight_decay, paper.epochs_a_step) == (8, 1e-4, 0.005, 30)
    assert paper.crops == [(481, 641)]
    with pytest.raises(ConfigError, match="paper, practical"):
        preset("fast")
    for wrong in ({"crop": ("640",)}, {"steps": 0}, {"schedule": "poly"}, {"shares": (0.0, 0.0, 0.0)}):
        with pytest.raises(ConfigError):
            preset("practical", **wrong)
