"""Plots are written, decode, have the promised size, and show each line in its colour."""

import re
import subprocess
import sys
import zlib
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from stillroom.data.trajectory import Trajectory
from stillroom.errors import StillroomError
from stillroom.viz.style import ESTIMATES, TRUTH
from stillroom.viz.trajectory_plots import plot_error, plot_from_above, plot_over_time


def walk(offset_m: float, lost: slice | None = None) -> Trajectory:
    """A circle of 1 m in x and z, seen over 10 s; some of it lost."""
    times_s = np.arange(300) / 30
    T = np.tile(np.eye(4), (300, 1, 1))
    T[:, 0, 3] = np.cos(times_s / 2) + offset_m
    T[:, 1, 3] = 0.05 * np.sin(times_s)
    T[:, 2, 3] = np.sin(times_s / 2)
    kept = np.ones(300, bool)
    if lost is not None:
        kept[lost] = False
    return Trajectory(1.5e9 + times_s[kept], T[kept])


def shows(picture: np.ndarray, color: str) -> int:
    """Number of pixels of a line's colour."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - rgb).max(axis=2) < 12).sum())


def read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    assert picture is not None
    return picture


@pytest.mark.parametrize(("plot", "size"), [(plot_from_above, (1050, 930)), (plot_over_time, (1350, 960))])
def test_paths_are_drawn_in_their_colours(tmp_path: Path, plot, size) -> None:
    path = tmp_path / "new" / "plot.png"
    plot(path, {"oc-slam": walk(0.1), "orb-slam2": walk(0.4)}, walk(0.0), "a walk")
    picture = read(path)
    assert picture.shape[1::-1] == size
    assert tuple(picture[0, 0]) == (255, 255, 255)
    for color in (TRUTH, *ESTIMATES[:2]):
        assert shows(picture, color) > 300
    assert shows(picture, ESTIMATES[2]) == 0


def test_from_above_is_the_plane_of_most_extent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    labels = []
    from matplotlib.axes import Axes

    set_labels = Axes.set
    monkeypatch.setattr(Axes, "set", lambda axes, **given: (labels.append(given), set_labels(axes, **given))[1])
    plot_from_above(tmp_path / "plot.png", {"one": walk(0.1)}, walk(0.0))
    assert labels[0]["xlabel"] == "x [m]"
    assert labels[0]["ylabel"] == "z [m]"


def test_a_circle_is_round(tmp_path: Path) -> None:
    times_s = np.linspace(0, 4 * np.pi, 400)
    T = np.tile(np.eye(4), (400, 1, 1))
    T[:, 0, 3], T[:, 1, 3] = np.cos(times_s), np.sin(times_s)
    circle = Trajectory(times_s, T)
    plot_from_above(tmp_path / "plot.png", {"one": circle}, circle)
    rgb = [int(ESTIMATES[0][i : i + 2], 16) for i in (1, 3, 5)]
    rows, columns = np.nonzero(np.abs(read(tmp_path / "plot.png").astype(int) - rgb).max(axis=2) < 12)
    plot_area = rows < 800  # the legend lies below
    assert np.ptp(rows[plot_area]) == pytest.approx(np.ptp(columns[plot_area]), abs=4)


def test_where_tracking_was_lost_nothing_is_drawn(tmp_path: Path) -> None:
    plot_over_time(tmp_path / "whole.png", {"one": walk(0.3)}, walk(0.0))
    plot_over_time(tmp_path / "lost.png", {"one": walk(0.3, slice(100, 220))}, walk(0.0))
    whole, lost = (shows(read(tmp_path / f"{name}.png"), ESTIMATES[0]) for name in ("whole", "lost"))
    assert 0.5 < lost / whole < 0.75  # 60 % of the poses are left


def test_the_error_has_the_still_cameras_line_when_it_is_known(tmp_path: Path) -> None:
    errors = {"one": (walk(0.0).timestamps_s, np.abs(np.sin(np.arange(300) / 30)) * 0.05)}
    plot_error(tmp_path / "with.png", errors, 0.117, "error")
    plot_error(tmp_path / "without.png", errors)
    picture = read(tmp_path / "with.png")
    assert picture.shape == (570, 1350, 3)
    assert shows(picture, ESTIMATES[0]) > 500
    assert shows(picture, TRUTH) > shows(read(tmp_path / "without.png"), TRUTH) + 500


def test_more_lines_than_colours_and_very_short_ones_are_drawn(tmp_path: Path) -> None:
    one = walk(0.0)
    short = Trajectory(one.timestamps_s[:1], one.T_world_cam[:1])
    plot_from_above(tmp_path / "plot.png", {f"run {i}": short for i in range(10)}, one)
    read(tmp_path / "plot.png")


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(StillroomError, match=r"taken/.*cannot be written"):
        plot_from_above(tmp_path / "taken" / "plot.png", {"one": walk(0.1)}, walk(0.0))


def test_matplotlib_is_not_imported_before_a_plot_is_drawn_and_needs_no_display() -> None:
    code = (
        "import sys, stillroom.viz.trajectory_plots, stillroom.viz.recorder;"
        "assert 'matplotlib' not in sys.modules; print('clean')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert re.fullmatch("clean\n", done.stdout), done.stderr


PLOTS = {
    "above": lambda path: plot_from_above(path, {"oc-slam": walk(0.1)}, walk(0.0), "a walk"),
    "over time": lambda path: plot_over_time(path, {"oc-slam": walk(0.1)}, walk(0.0), "a walk"),
    "error": lambda path: plot_error(path, {"oc-slam": (np.arange(9.0), np.ones(9))}, 0.5, "a walk"),
}
SIZES_IN = {"above": (7.0, 6.2), "over time": (9.0, 6.4), "error": (9.0, 3.8)}


@pytest.mark.parametrize("name", PLOTS)
def test_a_plot_for_a_paper_is_drawn_in_lines(tmp_path: Path, name: str) -> None:
    PLOTS[name](tmp_path / "plot.svg")
    drawn = ElementTree.parse(tmp_path / "plot.svg").getroot()
    assert drawn.tag == "{http://www.w3.org/2000/svg}svg"
    assert [float(side) for side in drawn.attrib["viewBox"].split()[2:]] == pytest.approx(
        [72 * side for side in SIZES_IN[name]]
    )
    styles = [element.attrib.get("style", "") for element in drawn.iter()]
    assert any(f"stroke: {ESTIMATES[0]}" in style for style in styles)
    assert any(f"stroke: {TRUTH}" in style for style in styles)
    assert not list(drawn.iter("{http://www.w3.org/2000/svg}image"))

    PLOTS[name](tmp_path / "plot.pdf")
    pdf = (tmp_path / "plot.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-1.")
    assert pdf.rstrip().endswith(b"%%EOF")
    assert b"/Subtype /Image" not in pdf
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf)
    assert box is not None
    assert [float(side) for side in box.groups()] == pytest.approx([72 * side for side in SIZES_IN[name]])
    pages = [
        zlib.decompress(each) for each in re.findall(rb"FlateDecode >>\s+stream\n(.*?)\nendstream", pdf, re.DOTALL)
    ]
    blue = " ".join(f"{int(ESTIMATES[0][i : i + 2], 16) / 255:.10g}" for i in (1, 3, 5)) + " RG"
    assert any(blue[:8].encode() in page and b" RG" in page for page in pages)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_same_plot_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in ("a", "b"):
        PLOTS["error"](tmp_path / f"{name}.{suffix}")
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_among_many_lines_the_true_one_lies_on_top(tmp_path: Path) -> None:
    truth, path = walk(0.0), tmp_path / "above.png"
    plot_from_above(path, {f"system {n}": truth for n in range(8)}, truth)
    picture = read(path)[: -picture_legend_px(8)]
    assert shows(picture, TRUTH) > 3000
    assert sum(shows(picture, color) for color in ESTIMATES) < 0.1 * shows(picture, TRUTH)


def picture_legend_px(n_lines: int) -> int:
    """Height of the legend below, of four names a row and two more for truth and start."""
    return 60 * -(-(n_lines + 2) // 4) + 40
