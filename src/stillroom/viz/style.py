"""How Stillroom's plots look, and how they are written."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from stillroom.data.replacing import cannot_be_written, replacing

TRUTH = "#30343b"
"""Colour of the ground truth."""

ESTIMATES = ("#1b7fc4", "#e0533d", "#2f9e67", "#9a5fc1", "#c98a12", "#5a6b7b")
"""Colours of the estimates, in order; told apart by colour-blind readers too."""

INK, QUIET, FAINT = "#22262c", "#6a717c", "#d5dae1"
"""Colours of titles, of notes, and of what only gives a frame."""

KEYFRAMES = "#7f90a6"
"""Colour of keyframes."""

DPI = 150
"""Pixels to the inch."""

_RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 10,
    "axes.titlesize": 12,
    "axes.titlelocation": "left",
    "axes.titlepad": 12,
    "axes.titlecolor": INK,
    "axes.labelcolor": "#4a4f57",
    "axes.edgecolor": "#b9bec6",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8eaee",
    "grid.linewidth": 0.8,
    "xtick.color": "#b9bec6",
    "ytick.color": "#b9bec6",
    "xtick.labelcolor": "#4a4f57",
    "ytick.labelcolor": "#4a4f57",
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "figure.facecolor": "white",
    "svg.hashsalt": "stillroom",
    "pdf.fonttype": 42,
}


FORMATS = ("png", "svg", "pdf")
"""What plots are written as."""

_SAME_BYTES: dict[str, dict[str, Any]] = {
    "png": {},
    "svg": {"metadata": {"Date": None}},
    "pdf": {"metadata": {"CreationDate": None}},
}
"""Without the time of writing: the same plot gives the same bytes."""


@contextmanager
def picture(path: Path, width_in: float, height_in: float) -> Iterator[Any]:
    """Yield a matplotlib figure in the package's style, and write it when the block ends without error.

    No display is needed and no global state is touched: plots may be drawn on any thread of a server.

    Args:
        path: The file to write, of the format that its suffix names (see `FORMATS`), else PNG; its folder is made.
        width_in, height_in: Size in inches, of 150 pixels each.

    Raises:
        StillroomError: The file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_RC):
        figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure
        drawn = BytesIO()
        kind = format_of(path)
        figure.savefig(drawn, format=kind, **_SAME_BYTES[kind])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_be_written(path, error) from error
    with replacing(path, durable=False) as file:
        file.write(drawn.getvalue())


def format_of(path: Path) -> str:
    """Return the format in which a plot is written to a path: what its suffix names, else PNG."""
    kind = path.suffix.lower().removeprefix(".")
    return kind if kind in FORMATS else "png"
