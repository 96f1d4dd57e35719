"""How images are fitted into a network's input, and boxes find back."""

import numpy as np
import pytest

from stillroom.semantics.onnx.fit import BORDER_GRAY, Colors, Fit


def planes(width, height):
    return np.full((3, height, width), np.nan, np.float32)


def test_an_image_of_the_inputs_size_is_only_counted_anew() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    colors = Colors((10.0, 20.0, 30.0), (2.0, 4.0, 8.0), bgr=True)
    filled = planes(8, 6)
    Fit.of((8, 6), (8, 6), "letterbox").fill(filled, rgb, colors)
    expected = (rgb - np.array([10.0, 20, 30])) / np.array([2.0, 4, 8])
    np.testing.assert_array_equal(filled, expected[..., ::-1].transpose(2, 0, 1).astype(np.float32))
    assert not colors.are_raw
    assert Colors(bgr=True).are_raw


@pytest.mark.parametrize(
    ("image_px", "content_px", "corner_px"),
    [
        ((40, 20), (32, 16), (0, 4)),
        ((20, 40), (12, 24), (10, 0)),
        ((10, 10), (24, 24), (4, 0)),
        ((1, 900), (1, 24), (15, 0)),
    ],
)
def test_a_letterbox_keeps_proportions_with_gray_around(image_px, content_px, corner_px) -> None:
    fit = Fit.of(image_px, (32, 24), "letterbox")
    assert (fit.content_px, fit.corner_px) == (content_px, corner_px)
    filled = planes(32, 24)
    fit.fill(filled, np.full((image_px[1], image_px[0], 3), 200, np.uint8), Colors((100.0,) * 3, (50.0,) * 3))
    expected = np.full((3, 24, 32), np.float32((BORDER_GRAY - 100) / 50))
    (x, y), (columns, rows) = corner_px, content_px
    expected[:, y : y + rows, x : x + columns] = 2.0
    np.testing.assert_allclose(filled, expected)


@pytest.mark.parametrize("how", ["letterbox", "stretch"])
@pytest.mark.parametrize("image_px", [(640, 480), (480, 640), (100, 31)])
def test_a_patch_is_found_where_it_was_put(how, image_px) -> None:
    """The box of a white patch in the input is the patch's box in the image."""
    width, height = image_px
    rgb = np.zeros((height, width, 3), np.uint8)
    x0, y0, x1, y1 = width // 4, height // 5, width // 2, height // 2
    rgb[y0 : y1 + 1, x0 : x1 + 1] = 255
    fit = Fit.of(image_px, (320, 256), how)
    filled = planes(320, 256)
    fit.fill(filled, rgb, Colors())
    row, column = np.nonzero(filled[0] > 128)
    edges = np.array([[column.min(), row.min(), column.max() + 1, row.max() + 1]], np.float64)
    found = fit.to_image_px(edges / np.array([320, 256, 320, 256]))[0]
    # An edge of the patch lies half a pixel beyond its outermost pixel's middle.
    step_px = max(width / fit.content_px[0], height / fit.content_px[1])
    np.testing.assert_allclose(found, [x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5], atol=0.51 * step_px + 0.01)


def test_boxes_are_cut_to_the_image() -> None:
    fit = Fit.of((200, 100), (128, 96), "letterbox")
    assert fit.to_image_px(np.array([[-1.0, 0.0, 2.0, 1.0]])).tolist() == [[0, 0, 199, 99]]
