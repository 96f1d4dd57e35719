"""Bars have the heights of their figures, each system its colour, and a place that is empty where it has none."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from stillroom.viz.bar_plots import plot_bars
from stillroom.viz.style import ESTIMATES

STATISTICS = ("median", "mean", "min", "max")


def heights(picture: np.ndarray, color: str) -> list[int]:
    """Return the heights of the bars of a colour [px], from left to right."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    # Bars, not the legend's patches at the bottom.
    inside = np.abs(picture[: int(0.8 * len(picture))].astype(int) - rgb).max(axis=2) < 3
    per_column = inside.sum(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (per_column > 0).astype(int), [0]))))
    return [int(per_column[a:b].max()) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def test_bars_are_as_high_as_their_figures(tmp_path: Path) -> None:
    values = {"orb-slam2": [0.4, 0.5, 0.3, 0.8], "pspnet-slam": [0.1, 0.2, 0.05, 0.4]}
    plot_bars(tmp_path / "bars.png", {"room": values}, STATISTICS, "RMSE [m]")
    picture = cv2.imread(str(tmp_path / "bars.png"), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    measured = [heights(picture, color) for color in ESTIMATES[:2]]
    one_m = measured[0][3] / 0.8
    for px, figures in zip(measured, values.values(), strict=True):
        assert px == pytest.approx([one_m * figure for figure in figures], abs=2)


def test_a_system_that_a_panel_lacks_leaves_its_place_and_colours_stay(tmp_path: Path) -> None:
    panels = {"first": {"a": [1.0], "b": [1.0]}, "second": {"b": [1.0]}}
    plot_bars(tmp_path / "bars.png", panels, ("median",), "RMSE [m]")
    picture = cv2.imread(str(tmp_path / "bars.png"), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    upper, lower = picture[: len(picture) // 2], picture[len(picture) // 2 :]
    assert len(heights(np.concatenate((upper, 255 + 0 * upper)), ESTIMATES[0])) == 1
    assert heights(lower, ESTIMATES[0]) == []
    assert len(heights(lower, ESTIMATES[1])) == 1


def test_as_pdf(tmp_path: Path) -> None:
    plot_bars(tmp_path / "bars.pdf", {"room": {"a": [1.0] * 4}}, STATISTICS, "RMSE [m]")
    assert (tmp_path / "bars.pdf").read_bytes().startswith(b"%PDF")
