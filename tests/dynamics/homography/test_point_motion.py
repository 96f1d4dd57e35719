"""The test of a point on two textured planes, whose images follow from geometry alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stillroom.data.image import RgbdImage
from stillroom.dynamics.homography.past import view_of
from stillroom.dynamics.homography.patches import (
    HALF_PX,
    ROOM,
    SIDE_PX,
    compare,
    find_patch,
    moments,
    read_part,
    take_patch,
)
from stillroom.dynamics.homography.point_motion import DYNAMIC, STATIC, UNKNOWN, PointTest, PointTestConfig
from stillroom.geometry import homography, se3
from stillroom.geometry.camera import Camera

CAMERA = Camera(640, 480, 520.0, 523.0, 318.0, 241.0)
WALL_M, BOARD_M = 3.0, 1.5
BOARD = (200, 120, 420, 340)
"""Where the board before the wall is in the earlier image (x0, y0, x1, y1) [px]."""
EVERYWHERE = np.stack(np.meshgrid(np.arange(60.0, 600, 20), np.arange(60.0, 440, 20)), axis=-1).reshape(-1, 2)


def texture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.uniform(0, 255, (60, 80)).astype(np.float32), (640, 480), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.uniform(-600, 600, (480, 640)).astype(np.float32), (0, 0), 2.5)
    return np.clip(0.6 * coarse + fine + 50, 0, 255).astype(np.uint8)


def of_plane(T_now_then: np.ndarray, depth_m: float) -> np.ndarray:
    """K (R + t nᵀ/d) K⁻¹ of a plane at a depth of the earlier camera."""
    H = T_now_then[:3, :3] + np.outer(T_now_then[:3, 3], (0, 0, 1.0)) / depth_m
    return CAMERA.K @ H @ np.linalg.inv(CAMERA.K)


def image_of(gray: np.ndarray, depth_m: np.ndarray) -> RgbdImage:
    return RgbdImage(0.0, np.dstack([gray] * 3), depth_m.astype(np.float32), 0)


def planes(T_now_then: np.ndarray, board_moves_m: tuple[float, float, float] = (0, 0, 0)) -> PointTest:
    """A wall and a board before it, from two places; meanwhile the board moves. Points all over the present image."""
    wall, board = texture(1), texture(2)
    is_board = np.zeros((480, 640), np.uint8)
    is_board[BOARD[1] : BOARD[3], BOARD[0] : BOARD[2]] = 1
    then = image_of(np.where(is_board, board, wall), np.where(is_board, BOARD_M, WALL_M))
    T_board = T_now_then.copy()
    T_board[:3, 3] += T_now_then[:3, :3] @ board_moves_m
    H_wall, H_board = of_plane(T_now_then, WALL_M), of_plane(T_board, BOARD_M)
    seen = cv2.warpPerspective(is_board, H_board, (640, 480), flags=cv2.INTER_NEAREST)
    gray = np.where(
        seen, cv2.warpPerspective(board, H_board, (640, 480)), cv2.warpPerspective(wall, H_wall, (640, 480))
    )
    row, column = np.mgrid[:480, :640].reshape(2, -1)
    rays = CAMERA.back_project(np.stack((column, row), axis=1), np.ones(row.size))
    depth = {}
    for name, T, d in (("wall", T_now_then, WALL_M), ("board", T_board, BOARD_M)):
        normal = T[:3, 2]  # of the plane z = d, seen from now
        depth[name] = ((d + normal @ T[:3, 3]) / (rays @ normal)).reshape(480, 640)
    depth_m = np.where(seen, depth["board"], depth["wall"])
    at = EVERYWHERE.astype(int)
    return PointTest(
        PointTestConfig(),
        CAMERA,
        view_of(image_of(gray, depth_m)),
        view_of(then),
        EVERYWHERE,
        EVERYWHERE,
        depth_m[at[:, 1], at[:, 0]].astype(np.float32).astype(np.float64),
        se3.inverse(T_now_then),
        np.linalg.inv(H_wall),
    )


def on_board(test: PointTest, margin: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """Which points lie well inside the board, and which far from it, in the present image."""
    nearer = (test.now.depth_m < 0.5 * (WALL_M + BOARD_M)).astype(np.uint8)
    size = np.ones((2 * margin + 1, 2 * margin + 1))
    at = EVERYWHERE.astype(int)
    inside, around = (f(nearer, size)[at[:, 1], at[:, 0]] > 0 for f in (cv2.erode, cv2.dilate))
    return inside, ~around


ALL = np.arange(len(EVERYWHERE))
STEP = se3.inverse(se3.exp(np.array([0.05, -0.02, 0.03, 0.01, -0.02, 0.015])))


def test_a_static_scene_is_static_though_its_parallax_is_large() -> None:
    test = planes(STEP)
    board, wall = on_board(test)
    verdicts, residual_px = test(ALL), test.residuals_px(ALL)
    assert not np.any(verdicts[board | wall] == DYNAMIC)
    assert np.mean(verdicts == DYNAMIC) < 0.02, "nor many at the outline, where a patch shows both"
    assert np.mean(verdicts[board] == STATIC) > 0.9
    assert np.mean(verdicts[wall] == STATIC) > 0.9
    found = board & (verdicts == STATIC)
    assert np.median(residual_px[found, 0]) < 0.3, "pose and depth say where the board was"
    assert np.median(residual_px[found, 1]) > 5, "the wall's homography does not"


def test_the_homography_alone_takes_the_board_for_moving() -> None:
    """The paper's letter, and what is wrong with it."""
    test = replace(planes(STEP), config=PointTestConfig(use_depth=False))
    board, wall = on_board(test)
    verdicts = test(ALL)
    assert np.mean(verdicts[board] == DYNAMIC) > 0.9
    assert not np.any(verdicts[wall] == DYNAMIC)


@pytest.mark.parametrize("use_depth", [True, False])
def test_a_camera_that_only_turns_needs_no_depth(use_depth: bool) -> None:
    test = replace(planes(se3.exp(np.array([0, 0, 0, 0.02, 0.03, -0.02]))), config=PointTestConfig(use_depth=use_depth))
    verdicts = test(ALL)
    assert np.mean(verdicts == STATIC) > 0.8
    assert not np.any(verdicts == DYNAMIC)


@pytest.mark.parametrize("moves_m", [(0.02, 0, 0), (0, 0.04, 0), (0.03, -0.03, 0), (-0.08, 0.0, 0), (0, 0, -0.3)])
def test_a_board_that_moves_is_dynamic_and_the_wall_is_not(moves_m: tuple[float, float, float]) -> None:
    test = planes(STEP, moves_m)
    board, wall = on_board(test)
    verdicts = test(ALL)
    assert np.mean(verdicts[board] == DYNAMIC) > 0.8
    assert np.mean(verdicts[wall] == DYNAMIC) < 0.01
    np.testing.assert_array_equal(test.is_dynamic(ALL), verdicts == DYNAMIC)


def test_a_place_that_was_empty_tells_even_of_what_has_no_texture() -> None:
    test = planes(STEP, (-0.8, 0, 0))
    blank = np.full_like(test.now.half, 90)
    test = replace(test, now=replace(test.now, half=blank, quarter=blank[::2, ::2].copy()))
    board, _ = on_board(test)
    emptied = board & (test(ALL) == DYNAMIC)
    assert emptied.sum() > 0.8 * board.sum()


def test_what_something_stood_before_is_unknown() -> None:
    test = planes(STEP, (0.5, 0, 0))
    _, wall = on_board(test)
    x0, y0, x1, y1 = BOARD
    back = homography.apply(np.linalg.inv(of_plane(STEP, WALL_M)), EVERYWHERE)
    hidden = wall & np.all((back > (x0 + 4, y0 + 4)) & (back < (x1 - 4, y1 - 4)), axis=1)
    assert hidden.sum() > 10
    assert np.all(test(ALL)[hidden] == UNKNOWN)


def test_without_a_depth_parallax_is_allowed_and_other_motion_is_not() -> None:
    sideways = se3.inverse(se3.exp(np.array([0.05, 0, 0, 0, 0, 0])))
    # The last motion looks just like parallax: without a depth it cannot be told.
    for moves_m, expected in (((0, 0, 0), STATIC), ((0, 0.012, 0), DYNAMIC), ((0.01, 0, 0), STATIC)):
        test = planes(sideways, moves_m)
        board, wall = on_board(test)
        verdicts = replace(test, depth_m=np.zeros(len(EVERYWHERE)))(ALL)
        found = board & (verdicts != UNKNOWN)
        assert found.sum() > 0.5 * board.sum(), moves_m
        assert np.mean(verdicts[found] == expected) > 0.9, moves_m
        assert np.mean(verdicts[wall] == STATIC) > 0.9


def test_where_nothing_can_be_known_nothing_is_said() -> None:
    test = planes(STEP)
    behind = replace(test, T_then_now=se3.exp(np.array([0, 0, -9.0, 0, 0, 0])))
    assert np.all(behind(ALL) == UNKNOWN)
    away = replace(test, T_then_now=se3.exp(np.array([50.0, 0, 0, 0, 0, 0])))
    assert np.all(away(ALL) == UNKNOWN)
    nowhere = replace(test, H_then_now=np.full((3, 3), np.nan), depth_m=np.zeros(len(EVERYWHERE)))
    assert np.all(nowhere(ALL) == UNKNOWN)
    black = np.zeros_like(test.now.half)
    dark = replace(test, now=replace(test.now, half=black, quarter=black[::2, ::2].copy()))
    assert np.all(dark(ALL) == UNKNOWN)
    assert len(test(ALL[:0])) == 0


def test_verdicts_do_not_depend_on_what_else_is_asked() -> None:
    test = planes(STEP, (0.03, 0, 0))
    some = np.array([300, 5, 77, 201])
    np.testing.assert_array_equal(test(some), test(ALL)[some])


def test_distortion_is_undone() -> None:
    """Points are looked up in the images as taken: the same scene through a bent lens gives the same residuals."""
    bent = replace(CAMERA, distortion=(0.1, -0.1, 0.001, -0.001, 0.0))
    test = planes(STEP)
    row, column = np.mgrid[:480, :640].reshape(2, -1)
    where = bent.undistort(np.stack((column, row), axis=1).astype(np.float32)).reshape(480, 640, 2)

    def bend(image: np.ndarray) -> np.ndarray:
        return cv2.remap(image, where[..., 0], where[..., 1], cv2.INTER_LINEAR)

    views = []
    wall, board = texture(1), texture(2)
    is_board = np.zeros((480, 640), np.uint8)
    is_board[BOARD[1] : BOARD[3], BOARD[0] : BOARD[2]] = 1
    H_wall, H_board = of_plane(STEP, WALL_M), of_plane(STEP, BOARD_M)
    seen = cv2.warpPerspective(is_board, H_board, (640, 480))
    now = np.where(seen, cv2.warpPerspective(board, H_board, (640, 480)), cv2.warpPerspective(wall, H_wall, (640, 480)))
    for gray, depth_m in ((now, test.now.depth_m), (np.where(is_board, board, wall), test.then.depth_m)):
        nearest = cv2.remap(depth_m, where[..., 0], where[..., 1], cv2.INTER_NEAREST)
        views.append(view_of(image_of(bend(gray), nearest)))
    through = replace(test, camera=bent, now=views[0], then=views[1], raw_px=bent.distort(EVERYWHERE))
    verdicts, residual_px = through(ALL), through.residuals_px(ALL)
    assert np.mean(verdicts == STATIC) > 0.75
    assert np.mean(verdicts == DYNAMIC) < 0.02
    assert np.nanmedian(residual_px[:, 0]) < 0.4
    straight = replace(through, camera=CAMERA)
    assert np.nanmedian(straight.residuals_px(ALL)[:, 0]) > 0.6 or np.mean(straight(ALL) == STATIC) < 0.6


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.7), (2.4, 1.6), (-3.0, 2.0)])
def test_a_patch_is_found_to_a_tenth_of_a_pixel(shift: tuple[float, float]) -> None:
    now = texture(3)
    M = np.array([[1.0, 0, shift[0]], [0, 1.0, shift[1]]])
    then = np.clip(0.8 * cv2.warpAffine(now, M, (640, 480), flags=cv2.INTER_CUBIC) + 20, 0, 255).astype(np.uint8)
    scratch, found = np.zeros(ROOM, np.float32), np.empty(2)
    errors = []
    for x, y in EVERYWHERE[::5] + 0.37:
        likeness = find_patch(now, (x, y), then, (x, y), 20, scratch, found)
        if likeness > 0.95:
            errors.append(np.hypot(*(found - (x, y) - shift)))
    assert len(errors) > 0.7 * len(EVERYWHERE[::5])
    assert np.percentile(errors, 90) < 0.15


def test_sums_over_a_patch_are_those_of_plain_interpolation() -> None:
    now, scratch = texture(4), np.zeros(ROOM, np.float32)
    row, column = np.mgrid[-5:6, -5:6]

    def around(x: float, y: float) -> np.ndarray:
        u, v, fx, fy = column + int(x), row + int(y), x % 1.0, y % 1.0
        pixels = now.astype(np.float64)
        upper, lower = ((1 - fx) * pixels[v + k, u] + fx * pixels[v + k, u + 1] for k in (0, 1))
        return (1 - fy) * upper + fy * lower

    wide = around(100.3, 80.6)
    patch = wide[1:-1, 1:-1]
    p, g, h = patch - patch.mean(), (wide[1:-1, 2:] - wide[1:-1, :-2]) / 2, (wide[2:, 1:-1] - wide[:-2, 1:-1]) / 2
    assert take_patch(now, 100.3, 80.6, scratch) == pytest.approx(patch.mean(), rel=1e-5)
    expected = [np.sum(a) for a in (p * p, g * g, h * h, g * h, p * g, p * h, g, h)]
    np.testing.assert_allclose(moments(scratch), expected, rtol=1e-4, atol=0.1)
    t = around(131.8, 77.1)[1:-1, 1:-1] - 40.0
    read_part(now, 77 - HALF_PX, 131 - HALF_PX, SIDE_PX + 1, scratch[3])
    expected = [np.sum(a) for a in (t, t * t, t * p, t * g, t * h)]
    np.testing.assert_allclose(compare(0.8, 0.1, 40.0, scratch), expected, rtol=1e-4, atol=0.5)
