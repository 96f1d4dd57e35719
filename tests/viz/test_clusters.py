"""Clusters in colour: each where it is, told apart from its neighbours, red only around what moves."""

import numpy as np
import pytest

from stillroom.data.clusters import PLANE, UNKNOWN, Clusters
from stillroom.data.semantics import Box, Semantics
from stillroom.viz.clusters import CLASSES, COLORS, cluster_colors, draw_clusters, draw_detections
from stillroom.viz.marks import MOVING

GRAY = np.full((120, 160, 3), 128, dtype=np.uint8)
NOTHING = Semantics(120, 160)


def clusters_of(labels: np.ndarray, n_planes: int = 1) -> Clusters:
    n = max(0, int(labels.max()) + 1)
    zeros = np.zeros((n, 3), np.float32)
    counts = np.bincount(labels[labels >= 0], minlength=n).astype(np.int32)
    no_box = np.full(n, -1, np.int32)
    return Clusters(labels.astype(np.int16), counts, zeros, zeros, zeros, no_box, np.zeros((n_planes, 4), np.float32))


def two_clusters() -> Clusters:
    """A plane above, unknown below, a cluster on the left and one on the right."""
    labels = np.full((120, 160), UNKNOWN)
    labels[:30] = PLANE
    labels[40:80, 20:60], labels[40:80, 64:110] = 0, 1
    return clusters_of(labels)


def close_to(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.abs(picture.astype(int) - color).max(axis=2) < 30


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_clusters_and_planes_are_tinted_where_they_are_and_the_unknown_is_left(scale: float) -> None:
    picture = draw_clusters(GRAY, two_clusters(), NOTHING, scale=scale)
    assert picture.shape == (120 * scale, 160 * scale, 3)
    assert picture.dtype == np.uint8

    def at(x: int, y: int) -> np.ndarray:
        return picture[round((y + 0.5) * scale), round((x + 0.5) * scale)].astype(int)

    first, second = cluster_colors(two_clusters())
    for pixel, color in ((at(40, 60), first), (at(85, 60), second)):
        # The colour of the picture lies on the way from the image's to the cluster's.
        towards, way = pixel - 128, np.array(color) - 128
        assert towards @ way / np.linalg.norm(towards) / np.linalg.norm(way) > 0.99
        assert np.linalg.norm(towards) > 0.4 * np.linalg.norm(way)
    assert at(80, 15)[2] > at(80, 15)[0] + 15  # grey-blue
    np.testing.assert_array_equal(at(130, 60), [128, 128, 128])


def test_the_image_is_not_touched() -> None:
    image = GRAY.copy()
    draw_clusters(image, two_clusters(), NOTHING, np.ones((120, 160), bool), 1.0)
    draw_detections(image, Semantics(120, 160, (Box(1, 2, 30, 40, "person", 0.9),)), 1.0)
    np.testing.assert_array_equal(image, GRAY)


def test_neighbours_differ_in_colour_whatever_their_numbers() -> None:
    """Labels 0, 10, 20 … would all have the first colour if colours went by number alone."""
    labels = np.full((120, 160), UNKNOWN)
    many = 4 * len(COLORS)
    for place in range(many):
        # Column by column, so that vertical neighbours are consecutive and horizontal ones are 10 apart.
        row, column = place % len(COLORS), place // len(COLORS)
        labels[12 * row : 12 * row + 11, 40 * column : 40 * column + 38] = place
    colors = cluster_colors(clusters_of(labels))
    for first in range(many):
        for second in (first + 1, first + len(COLORS)):
            apart = abs(first // len(COLORS) - second // len(COLORS)) + abs(first - second) % len(COLORS)
            if second < many and apart == 1:
                assert colors[first] != colors[second], (first, second)


def test_colours_are_bright_and_none_is_the_red_of_what_moves() -> None:
    colors = np.array((*COLORS, MOVING), float)
    apart = np.linalg.norm(colors[:, None] - colors[None], axis=2)
    assert apart[~np.eye(len(colors), dtype=bool)].min() > 45


def test_a_cluster_moves_when_more_than_half_of_it_does() -> None:
    moving = np.zeros((120, 160), bool)
    moving[:, :38] = True  # 18 of 40 columns of the left one
    moving[:, 80:] = True  # 30 of 46 of the right one
    picture = draw_clusters(GRAY, two_clusters(), NOTHING, moving, 2.0)
    red = close_to(picture, MOVING)[: 2 * 100]
    left, right = red[:, : 2 * 62], red[:, 2 * 62 :]
    rows, columns = np.nonzero(right)
    assert not left.any()
    assert (rows.min(), rows.max()) == (pytest.approx(80, abs=4), pytest.approx(159, abs=4))
    assert (columns.min(), columns.max()) == (pytest.approx(4, abs=4), pytest.approx(95, abs=4))
    assert not right[95:145, 20:80].any()  # an edge, not a filling
    assert not close_to(draw_clusters(GRAY, two_clusters(), NOTHING, None, 2.0), MOVING).any()


def test_no_clusters_and_boxes_are_no_error() -> None:
    none = clusters_of(np.full((120, 160), PLANE), 2)
    box = Box(20, 30, 80, 90, "person", 0.93)
    picture = draw_clusters(GRAY, none, Semantics(120, 160, (box,)), np.zeros((120, 160), bool))
    assert close_to(picture, (255, 255, 255))[120, 38:44].any()


def test_detections_have_a_colour_for_each_class_and_a_label() -> None:
    person, chair = Box(10, 30, 75, 90, "person", 0.93), Box(90, 40, 140, 100, "chair", 0.5)
    picture = draw_detections(GRAY, Semantics(120, 160, (person, chair)), 2.0)
    for box, color in ((chair, CLASSES[0]), (person, CLASSES[1])):  # In order of their names.
        rows, columns = np.nonzero(close_to(picture, color)[:200])
        expected = np.array([box.x_min_px, box.x_max_px, box.y_max_px]) * 2
        np.testing.assert_allclose([columns.min(), columns.max(), rows.max()], expected, atol=3)
        assert rows.min() == pytest.approx(box.y_min_px * 2 - 18, abs=8)  # The label stands above.
    inside = picture[100:150, 40:140]
    np.testing.assert_array_equal(inside, np.full_like(inside, 128))


def test_a_segmenters_mask_is_tinted_and_no_detections_are_said() -> None:
    mask = np.zeros((120, 160), bool)
    mask[40:80, 40:80] = True
    picture = draw_detections(GRAY, Semantics(120, 160, (), mask), 1.0).astype(int)
    assert picture[60, 60, 0] > picture[60, 60, 2] + 50
    np.testing.assert_array_equal(picture[20, 120], [128, 128, 128])
    assert picture[110:, :40].min() < 60  # the legend's ground
