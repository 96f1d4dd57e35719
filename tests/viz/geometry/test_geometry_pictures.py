"""The pictures of compensation and of the ants' way."""

import cv2
import numpy as np

from stillroom.geometry.camera import Camera
from stillroom.viz.geometry_pictures import (
    BAND,
    PATH,
    AntWalk,
    compensated,
    draw_ant_walk,
    draw_difference,
    draw_moving_points,
)
from stillroom.viz.marks import MOVING, STATIC

CAMERA = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)
BENT = Camera(160, 120, 150.0, 150.0, 80.0, 60.0, distortion=(0.2, -0.1, 0.002, 0.001, 0.0))


def texture() -> np.ndarray:
    noise = np.random.default_rng(0).uniform(0, 255, (120, 160)).astype(np.float32)
    return np.clip(128 + 6 * (cv2.GaussianBlur(noise, (0, 0), 3) - 128), 0, 255).astype(np.uint8)


def near(picture: np.ndarray, color: tuple[int, int, int], reach: int = 12) -> np.ndarray:
    return np.abs(picture.astype(int) - color).max(axis=-1) <= reach


def test_a_shift_is_compensated_and_what_was_not_seen_is_told() -> None:
    earlier = texture()
    now = np.roll(earlier, 7, axis=1)
    H_then_now = np.array([[1.0, 0, -7], [0, 1, 0], [0, 0, 1]])
    moved, seen = compensated(earlier, H_then_now, CAMERA)
    assert np.abs(moved[:, 8:].astype(int) - now[:, 8:]).max() <= 1
    assert seen[:, 8:].all()
    assert not seen[:, :6].any()


def test_the_lens_is_part_of_it() -> None:
    moved, seen = compensated(texture(), np.eye(3), BENT)
    inner = (slice(5, -5), slice(5, -5))
    assert np.abs(moved[inner].astype(int) - texture()[inner]).max() <= 3
    assert seen[inner].all()


def test_differences_are_dark_on_white() -> None:
    now, then, seen = np.full((20, 30), 100, np.uint8), np.full((20, 30), 100, np.uint8), np.ones((20, 30), bool)
    then[5:10, 5:10], then[15:, 25:], seen[15:, 25:] = 200, 0, False
    picture = draw_difference(now, then, seen)
    assert (picture[5:10, 5:10] < 80).all()
    assert (picture[15:, 25:] == 255).all()
    assert (picture[0] == 255).all()


def test_moving_points_are_red_static_green_and_others_not_drawn() -> None:
    image = np.full((120, 160, 3), 90, np.uint8)
    points = np.array([[30.0, 30], [60, 30], [90, 30]])
    picture = draw_moving_points(image, points, np.array([True, False, False]), np.array([True, True, False]), 4.0)
    assert near(picture[118:128, 118:128], MOVING).any()
    assert near(picture[118:128, 238:248], STATIC).any()
    assert (picture[110:134, 350:374] == 90).all()
    assert (image == 90).all()


def test_the_walk_shows_path_circles_hull_and_band() -> None:
    image = np.full((120, 160, 3), 200, np.uint8)
    path = np.array([[20.0, 20], [120, 20], [120, 90]])
    hull = np.array([[60.0, 50], [90, 50], [75, 75]])
    walk = AntWalk(hull, np.ones(3, bool), np.ones(3, bool), path, 12.0, 10.0, [hull])
    picture = draw_ant_walk(image, walk, 4.0)
    assert near(picture[80:84, 240:420], PATH).mean() > 0.3, "from the first node to the second"
    around = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    circle = np.rint(4 * (path[1] + 0.5) - 0.5 + 48 * np.stack((np.cos(around), np.sin(around)), axis=1)).astype(int)
    assert np.mean([near(picture[y - 1 : y + 2, x - 1 : x + 2], PATH, 60).any() for x, y in circle]) > 0.9
    assert near(picture[158:166, 240:360], BAND, 30).any(axis=0).mean() > 0.8, "ten pixels above the hull"
    inside, outside = picture[4 * 55, 4 * 75], picture[4 * 100, 4 * 40]
    assert inside[0] > outside[0]
    assert inside[1] < outside[1]


def test_nothing_to_walk() -> None:
    walk = AntWalk(np.zeros((0, 2)), np.zeros(0, bool), np.zeros(0, bool), np.zeros((0, 2)), 12.0, 10.0, [])
    assert draw_ant_walk(np.zeros((60, 80, 3), np.uint8), walk).shape == (60, 80, 3)
