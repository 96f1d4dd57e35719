"""The user's own masks: names, values, and what is wrong with them."""

import logging
from dataclasses import replace

import cv2
import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.errors import ConfigError, DatasetError
from stillroom.semantics.mask_files import MaskFilesConfig

HEIGHT, WIDTH = 30, 40
STAMP_S = 1548339819.87426


def image(index=3, stamp_s=STAMP_S):
    return RgbdImage(stamp_s, np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.zeros((HEIGHT, WIDTH), np.float32), index)


def labels():
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[5:15, 8:20] = 15
    mask[19:29, 28:39] = 7
    return mask


def write(path, pixels):
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())


@pytest.mark.parametrize(
    "name",
    ["1548339819.87426.png", "1548339819.874260.PNG", "000003.png", "3.bmp", "mask_0003.png", "rgb-3.tiff"],
)
def test_a_mask_is_found_by_time_or_by_index(tmp_path, name):
    write(tmp_path / "000002.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    write(tmp_path / "1548339819.84071.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    (tmp_path / "readme.txt").write_text("not a mask")
    write(tmp_path / name.lower(), labels())
    (tmp_path / name.lower()).rename(tmp_path / name)
    semantics = MaskFilesConfig(tmp_path).build()(image())
    np.testing.assert_array_equal(semantics.mask, labels() > 0)
    assert [box.xyxy_px for box in semantics.boxes] == [(8, 5, 19, 14), (28, 19, 38, 28)]


def test_a_mask_called_like_its_colour_image_goes_before_time_and_index(tmp_path):
    write(tmp_path / "3.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    write(tmp_path / f"{STAMP_S:.5f}.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    write(tmp_path / "left-17b.png", labels())
    segmenter = MaskFilesConfig(tmp_path).build()
    assert segmenter(replace(image(), name="left-17b")).has_any
    assert not segmenter(replace(image(), name="left-18b")).has_any


def test_the_time_in_a_name_goes_before_the_index(tmp_path):
    write(tmp_path / "3.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    write(tmp_path / f"{STAMP_S:.5f}.png", labels())
    segmenter = MaskFilesConfig(tmp_path).build()
    assert segmenter(image()).has_any
    assert not segmenter(image(stamp_s=STAMP_S + 0.005)).has_any


@pytest.mark.parametrize(
    ("pixels", "values", "expected"),
    [
        (labels(), (), labels() > 0),
        (labels(), (15,), labels() == 15),
        (labels(), (7, 15), labels() > 0),
        (labels(), (1,), labels() == 1),
        (labels().astype(np.uint16) * 1000, (15000,), labels() == 15),
        (np.dstack([labels()] * 3), (15,), labels() == 15),
        (np.dstack([labels(), 0 * labels(), 0 * labels()]), (), labels() > 0),
        # Opaque everywhere: the fourth channel says nothing about what moves.
        (np.dstack([labels(), labels(), labels(), 0 * labels() + 255]), (), labels() > 0),
    ],
)
def test_what_a_pixel_says(tmp_path, pixels, values, expected):
    write(tmp_path / "3.png", pixels)
    semantics = MaskFilesConfig(tmp_path, movable_values=values).build()(image())
    np.testing.assert_array_equal(semantics.mask, expected)


def test_masks_grow(tmp_path):
    """Every pixel within the radius of a movable one, by plain distances."""
    point = np.zeros((HEIGHT, WIDTH), np.uint8)
    point[15, 20] = 255
    write(tmp_path / "3.png", point)
    mask = MaskFilesConfig(tmp_path, dilate_px=4).build()(image()).mask
    row, column = np.indices(mask.shape)
    distance = np.hypot(row - 15, column - 20)
    assert mask[distance <= 3.5].all()
    assert not mask[distance > 4.5].any()


def test_boxes_are_optional_and_small_regions_are_none(tmp_path):
    write(tmp_path / "3.png", labels())
    assert MaskFilesConfig(tmp_path, boxes=False).build()(image()).boxes == ()
    assert len(MaskFilesConfig(tmp_path, min_box_px=111).build()(image()).boxes) == 1


def test_a_missing_or_damaged_mask_warns_once_or_stops(tmp_path, caplog):
    write(tmp_path / "3.png", labels())
    (tmp_path / "5.png").write_bytes(b"no image")
    segmenter = MaskFilesConfig(tmp_path).build()
    with caplog.at_level(logging.WARNING):
        assert segmenter(image(3)).has_any
        assert not caplog.records
        for index in (4, 5, 6):
            assert not segmenter(image(index)).has_any
    (record,) = caplog.records
    assert "no mask for frame 4" in record.getMessage()
    strict = MaskFilesConfig(tmp_path, missing="error").build()
    with pytest.raises(DatasetError, match=rf"{tmp_path}: no mask for frame 4 \(1548339819\.874260 s\); add it"):
        strict(image(4))
    with pytest.raises(DatasetError, match=r"5\.png: cannot be read as an image"):
        strict(image(5))


def test_a_mask_of_another_size_is_an_error(tmp_path):
    write(tmp_path / "3.png", labels()[:, :-1])
    with pytest.raises(DatasetError, match=r"3\.png: the mask is 39×30, the image 40×30") as caught:
        MaskFilesConfig(tmp_path).build()(image())
    assert "\n" not in str(caught.value)


def test_labels_cannot_be_read_from_colours(tmp_path):
    write(tmp_path / "3.png", np.dstack([labels(), 0 * labels(), 0 * labels()]))
    with pytest.raises(DatasetError, match="a colour image, where movable_values needs labels"):
        MaskFilesConfig(tmp_path, movable_values=(15,)).build()(image())


def test_folders_that_cannot_serve(tmp_path):
    with pytest.raises(DatasetError, match="no such folder"):
        MaskFilesConfig(tmp_path / "absent").build()
    (tmp_path / "000001.jpg").write_bytes(b"lossy")
    with pytest.raises(DatasetError, match=r"no masks in it; expected <name of the colour image>\.png, "):
        MaskFilesConfig(tmp_path).build()
    write(tmp_path / "3.png", labels())
    write(tmp_path / "0003.png", labels())
    with pytest.raises(DatasetError, match=r"3\.png: claims the same frame as 0003\.png"):
        MaskFilesConfig(tmp_path).build()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"folder": None}, "semantics.folder is not set"),
        ({"missing": "ignore"}, "missing' is 'ignore'; it must be one of nothing, error"),
        ({"dilate_px": -1}, "dilate_px' is -1"),
    ],
)
def test_impossible_values(tmp_path, options, said):
    with pytest.raises(ConfigError, match=said):
        MaskFilesConfig(**{"folder": tmp_path, **options}).build()


def touching():
    numbers = np.zeros((HEIGHT, WIDTH), np.uint16)
    numbers[5:15, 8:20] = 300
    numbers[5:15, 20:30] = 44
    numbers[20:22, 2] = 300  # a foot, apart
    return numbers


def in_colours():
    colours = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    colours[touching() == 300] = 0, 128, 1
    colours[touching() == 44] = 1, 128, 0
    return colours


@pytest.mark.parametrize("pixels", [touching(), in_colours()], ids=["16 bits", "colours"])
def test_instances_are_told_apart_by_value(tmp_path, pixels):
    write(tmp_path / "3.png", pixels)
    answer = MaskFilesConfig(tmp_path, instances=True).build()(image())
    masks = {instance.area_px: instance.mask for instance in answer.instances}
    assert sorted(masks) == [100, 122]
    np.testing.assert_array_equal(masks[122], touching() == 300)
    np.testing.assert_array_equal(masks[100], touching() == 44)
    np.testing.assert_array_equal(answer.mask, touching() > 0)
    assert [box.xyxy_px for box in answer.boxes] == [(2, 5, 19, 21), (20, 5, 29, 14)]
    plain = MaskFilesConfig(tmp_path).build()(image())
    assert plain.instances == ()
    np.testing.assert_array_equal(plain.mask, answer.mask)


def test_instances_are_grown_one_by_one_and_chosen_by_value(tmp_path):
    write(tmp_path / "3.png", touching())
    grown = MaskFilesConfig(tmp_path, dilate_px=2, instances=True).build()(image())
    plain = MaskFilesConfig(tmp_path, dilate_px=2).build()(image())
    np.testing.assert_array_equal(grown.mask, plain.mask)
    first, second = (instance.mask for instance in grown.instances)
    assert (first & second).any()
    np.testing.assert_array_equal(first | second, grown.mask)
    (chosen,) = MaskFilesConfig(tmp_path, movable_values=(300,), instances=True).build()(image()).instances
    np.testing.assert_array_equal(chosen.mask, touching() == 300)


def test_a_file_without_instances_has_none(tmp_path):
    write(tmp_path / "3.png", np.zeros((HEIGHT, WIDTH), np.uint16))
    answer = MaskFilesConfig(tmp_path, instances=True).build()(image())
    assert (answer.instances, answer.boxes, answer.has_any) == ((), (), False)
