"""Draw `docs/images/architecture.svg`: how an image goes through `System.process`, and where the three sieves stand.

    python docs/draw_architecture.py [FILE]

A file that ends in .png is drawn as PNG. The same libraries give the same bytes.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

HERE = Path(__file__).resolve().parent
WIDTH, HEIGHT = 13.0, 8.2
INK, FAINT, STATIC, MOVES = "#22313a", "#7b8a92", "#e4f1ef", "#c8441c"
LANES = {
    # name: bottom, top, colour
    "what may move": (6.35, 7.95, "#fdf1ea"),
    "where is the camera": (3.75, 6.15, "#eef3f8"),
    "mapping": (1.95, 3.55, "#f0f5ee"),
    "what is kept": (0.15, 1.75, "#f4f2f7"),
}


def main(file: Path) -> None:
    """Draw the picture into a file."""
    plt.rcParams.update({"svg.hashsalt": "stillroom", "font.family": "DejaVu Sans"})
    figure = plt.figure(figsize=(0.9 * WIDTH, 0.9 * HEIGHT), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axes.axis("off")
    for name, (bottom, top, colour) in LANES.items():
        axes.add_patch(
            FancyBboxPatch((0.1, bottom), WIDTH - 0.2, top - bottom, boxstyle="round,pad=0", fc=colour, ec="none")
        )
        axes.text(WIDTH - 0.25, top - 0.12, name, ha="right", va="top", size=9.5, color=FAINT, style="italic")
    draw_parts(axes)
    draw_arrows(axes)
    metadata = {"Date": None} if file.suffix == ".svg" else None
    figure.savefig(file, metadata=metadata, dpi=110)
    plt.close(figure)


def draw_parts(axes: Axes) -> None:
    """Draw every part, as `System` names it."""
    box(axes, 0.3, 4.55, 1.5, 0.9, "RGB-D image", "rgb, depth_m", fill="white")
    box(axes, 2.3, 6.6, 2.2, 0.9, "segmenter", "boxes, masks, objects")
    box(axes, 5.2, 6.6, 2.2, 0.9, "clusterer", "parts of the depth cloud")
    box(axes, 2.3, 4.55, 1.4, 0.9, "features", "ORB keypoints")
    box(axes, 4.15, 4.55, 1.6, 0.9, "SIEVE 1", "keypoints", is_sieve=True)
    box(axes, 6.25, 3.95, 4.0, 2.0, "", "", fill="white")
    axes.text(6.4, 5.78, "tracker", weight="bold", size=11, color=INK, va="center")
    axes.text(
        6.4,
        4.9,
        "motion model,\nelse reference\nkeyframe,\nthen local map",
        size=8.5,
        color=INK,
        va="center",
        linespacing=1.4,
    )
    box(axes, 8.35, 4.55, 1.6, 0.9, "SIEVE 2", "matches", is_sieve=True)
    axes.text(8.25, 4.2, "lost: recovery looks for the place", size=7.5, color=FAINT, ha="center", va="center")
    box(axes, 10.85, 4.55, 1.9, 0.9, "FrameResult", "pose, motion, state", fill="white")
    for x, name, what in (
        (0.6, "mapper", "insert, then refine:\nnew points, local bundle"),
        (3.25, "places", "words of what\nit looks like"),
        (5.4, "joiner", "sub-maps become\none"),
        (7.55, "loop closer", "pose graph,\nbundle; undone if wrong"),
    ):
        box(axes, x, 2.2, 2.35 if name in ("mapper", "loop closer") else 1.85, 1.05, name, what)
    box(axes, 10.55, 2.3, 1.9, 0.85, "SIEVE 3", "depth pixels", is_sieve=True)
    box(axes, 0.6, 0.4, 7.2, 0.95, "map", "keyframes, keypoints, points, covisibility, sub-maps", fill="white")
    box(axes, 8.2, 0.4, 1.5, 0.95, "map file", "room.stillmap", fill="white")
    box(axes, 10.1, 0.4, 2.6, 0.95, "dense map", "voxels of 2 cm, carved", fill="white")


def draw_arrows(axes: Axes) -> None:
    """Draw what goes from part to part."""
    arrow(axes, (1.05, 5.45), (1.05, 7.05), (2.3, 7.05))
    arrow(axes, (1.8, 5.0), (2.3, 5.0))
    arrow(axes, (4.5, 7.05), (5.2, 7.05))
    arrow(axes, (3.7, 5.0), (4.15, 5.0))
    arrow(axes, (5.75, 5.0), (6.25, 5.0))
    arrow(axes, (10.25, 5.0), (10.85, 5.0))
    # What may move, to the two sieves that ask.
    arrow(axes, (7.4, 7.05), (9.15, 7.05), (9.15, 5.45), colour=MOVES)
    arrow(axes, (6.3, 6.6), (6.3, 6.25), (4.95, 6.25), (4.95, 5.45), colour=MOVES)
    axes.text(7.5, 7.12, "what may move", size=8.5, color=MOVES, va="bottom")
    # A keyframe goes down.
    arrow(axes, (7.0, 3.95), (7.0, 3.66), (1.75, 3.66), (1.75, 3.25))
    axes.text(4.4, 3.7, "where a keyframe is wanted", size=8.5, color=INK, ha="center", va="bottom")
    arrow(axes, (2.95, 2.72), (3.25, 2.72))
    arrow(axes, (5.1, 2.72), (5.4, 2.72))
    arrow(axes, (7.25, 2.72), (7.55, 2.72))
    for x in (1.75, 4.15, 6.3, 7.68):
        arrow(axes, (x, 2.2), (x, 1.35), style="<|-|>")
    arrow(axes, (7.8, 0.87), (8.2, 0.87))
    # Every image goes on to the dense map, without what moves.
    arrow(axes, (11.5, 4.55), (11.5, 3.15), colour=MOVES)
    axes.text(11.6, 4.15, "image, pose,\nmotion.moving", size=8.5, color=MOVES, va="center", ha="left")
    arrow(axes, (11.5, 2.3), (11.5, 1.35))


def box(
    axes: Axes,
    x: float,
    y: float,
    width: float,
    height: float,
    name: str,
    what: str,
    fill: str = STATIC,
    is_sieve: bool = False,
) -> None:
    """Draw a part: its name, and in small what it makes."""
    edge, line = (MOVES, 2.2) if is_sieve else (INK, 1.0)
    axes.add_patch(
        FancyBboxPatch(
            (x, y),
            width,
            height,
            boxstyle="round,pad=0,rounding_size=0.12",
            fc="#fff4ef" if is_sieve else fill,
            ec=edge,
            lw=line,
        )
    )
    rows = what.count("\n") + 1
    middle = x + width / 2
    axes.text(
        middle,
        y + height / 2 + 0.09 * (rows + 1),
        name,
        ha="center",
        va="center",
        weight="bold",
        size=11,
        color=MOVES if is_sieve else INK,
    )
    axes.text(middle, y + height / 2 - 0.17, what, ha="center", va="center", size=8.5, color=INK, linespacing=1.25)


def arrow(axes: Axes, *corners: tuple[float, float], colour: str = INK, style: str = "-|>") -> None:
    """Draw an arrow along a line with corners."""
    axes.plot(*zip(*corners[:-1], strict=True), color=colour, lw=1.4, solid_joinstyle="round")
    axes.add_patch(
        FancyArrowPatch(
            corners[-2], corners[-1], arrowstyle=style, mutation_scale=13, lw=1.4, color=colour, shrinkA=0, shrinkB=0
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "images" / "architecture.svg")
