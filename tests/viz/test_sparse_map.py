"""The sparse map's picture: a PNG of the promised size with points, keyframes and path at their places."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stillroom.data.trajectory import Trajectory
from stillroom.errors import StillroomError
from stillroom.geometry import se3
from stillroom.viz.sparse_map import HEIGHTS, draw_sparse_map
from stillroom.viz.style import KEYFRAMES, TRUTH


def walk() -> Trajectory:
    """Two metres to the right (x), looking along z, y down."""
    T = np.tile(np.eye(4), (60, 1, 1))
    T[:, 0, 3] = np.linspace(0, 2, 60)
    return Trajectory(np.arange(60) / 30, T)


def wall() -> np.ndarray:
    """A wall three metres ahead, from 1 m below the camera to 1 m above it."""
    x, y = np.meshgrid(np.linspace(-1, 3, 40), np.linspace(-1, 1, 20))
    return np.stack((x.ravel(), y.ravel(), np.full(x.size, 3.0)), axis=1)


def read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    return picture


def shows(picture: np.ndarray, color: str, within: int = 12) -> int:
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - rgb).max(axis=2) < within).sum())


def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, Any, Any]]:
    """Return a list that fills with the arguments of every scatter: x, y and the values that colours show."""
    from matplotlib.axes import Axes

    seen: list[tuple[Any, Any, Any]] = []
    scatter = Axes.scatter

    def spy(axes: Any, x: Any, y: Any, **given: Any) -> Any:
        seen.append((np.array(x), np.array(y), np.array(given["c"])))
        return scatter(axes, x, y, **given)

    monkeypatch.setattr(Axes, "scatter", spy)
    return seen


def test_the_picture_has_its_size_and_shows_everything(tmp_path: Path) -> None:
    path = tmp_path / "new" / "sparse.png"
    draw_sparse_map(path, wall(), walk().T_world_cam[::10], walk(), title="a wall")
    picture = read(path)
    assert picture.shape == (720, 1800, 3)
    assert tuple(picture[0, 0]) == (255, 255, 255)
    assert shows(picture, TRUTH) > 300
    assert shows(picture, KEYFRAMES, 40) > 300
    assert all(shows(picture, color, 60) > 100 for color in HEIGHTS)


def test_without_a_path_none_is_drawn(tmp_path: Path) -> None:
    draw_sparse_map(tmp_path / "with.png", wall(), walk().T_world_cam[::10], walk())
    draw_sparse_map(tmp_path / "without.png", wall(), walk().T_world_cam[::10])
    assert shows(read(tmp_path / "without.png"), TRUTH) < shows(read(tmp_path / "with.png"), TRUTH) - 300


@pytest.mark.parametrize("T", [np.eye(4), se3.exp(np.array([3.0, -1.0, 0.5, 0.4, -1.9, 0.3]))])
def test_from_above_is_right_and_forward_of_the_first_keyframe_and_colour_is_height(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, T: np.ndarray
) -> None:
    seen = drawn(monkeypatch)
    draw_sparse_map(tmp_path / "sparse.png", se3.transform(T, wall()), T @ walk().T_world_cam[::10])
    right, forward, height = seen[0]
    order = np.lexsort((right.round(6), height.round(6)))
    expected = wall()[np.lexsort((wall()[:, 0].round(6), -wall()[:, 1].round(6)))]
    np.testing.assert_allclose(right[order], expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(forward, 3.0, atol=1e-9)
    np.testing.assert_allclose(height[order], 1.0 - expected[:, 1], atol=0.11)  # Above the lowest percent.
    slanted_right, slanted_up, slanted_height = seen[1]
    assert np.corrcoef(slanted_up, slanted_height)[0, 1] > 0.5  # What is high is high in the slanted panel too.
    assert np.ptp(slanted_right) == pytest.approx(4 * np.cos(0.5), abs=0.01)


def test_age_takes_the_place_of_height(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = drawn(monkeypatch)
    age_s = np.arange(800.0)
    draw_sparse_map(tmp_path / "sparse.png", wall(), walk().T_world_cam[::10], age_s=age_s)
    assert sorted(seen[0][2]) == sorted(age_s)


def test_a_map_of_one_keyframe_and_no_points_is_no_error(tmp_path: Path) -> None:
    draw_sparse_map(tmp_path / "sparse.png", np.zeros((0, 3)), np.eye(4)[None])
    assert read(tmp_path / "sparse.png").shape == (720, 1800, 3)


def test_a_far_stray_point_does_not_shrink_the_map(tmp_path: Path) -> None:
    stray = np.concatenate((wall(), [[500.0, 0.0, 900.0]]))
    draw_sparse_map(tmp_path / "sparse.png", stray, walk().T_world_cam[::10], walk())
    assert shows(read(tmp_path / "sparse.png"), TRUTH) > 300


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(StillroomError, match=r"taken/.*cannot be written"):
        draw_sparse_map(tmp_path / "taken" / "sparse.png", wall(), np.eye(4)[None])


@pytest.mark.parametrize(("is_metric", "unit"), [(True, "m"), (False, "units of the map")])
def test_a_map_up_to_scale_is_not_drawn_in_metres(is_metric: bool, unit: str, tmp_path: Path) -> None:
    path = replace(walk(), is_metric=is_metric)
    draw_sparse_map(tmp_path / "map.svg", wall(), path.T_world_cam[::20], path)
    said = (tmp_path / "map.svg").read_text(encoding="utf-8")
    for name in ("right", "forward", "height"):
        assert f"{name} [{unit}]" in said
