"""Bars of several figures, each with a bar for each system, one panel below the other (PSPNet-SLAM's Figure 9)."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np

from stillroom.viz.style import ESTIMATES, INK, QUIET, picture

WIDE = 0.84
"""Share of the place of a figure that its bars take."""

HATCHES = ("", "///", "...")
"""Of bars whose colours repeat."""


def plot_bars(
    path: Path,
    panels: Mapping[str, Mapping[str, Sequence[float]]],
    figures: Sequence[str],
    ylabel: str,
    digits: int = 3,
) -> None:
    """Draw bars, a panel for each sequence, a group for each figure, a bar for each system.

    Args:
        path: The file to write: PNG, or SVG or PDF by its suffix.
        panels: By the title of a panel, by system, its figures, as many as are named; at least one panel. Systems have
            one colour in all panels; one that a panel lacks leaves its place empty.
        figures: Their names.
        ylabel: What is measured, with its unit.
        digits: After the point, of the number over a bar.

    Raises:
        StillroomError: The file cannot be written.
    """
    systems = list(dict.fromkeys(system for panel in panels.values() for system in panel))
    width = WIDE / max(1, len(systems))
    looks = list(zip(systems, cycle(ESTIMATES), strict=False))
    with picture(path, 10.0, 0.7 + 2.4 * len(panels)) as figure:
        axes = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
        for one, (title, panel) in zip(axes, panels.items(), strict=True):
            for place, (system, color) in enumerate(looks):
                values = panel.get(system, [np.nan] * len(figures))
                left = np.arange(len(figures)) + (place - (len(systems) - 1) / 2) * width
                hatch = HATCHES[place // len(ESTIMATES) % len(HATCHES)]
                drawn = one.bar(
                    left, values, 0.9 * width, color=color, hatch=hatch, edgecolor="white", lw=0, label=system
                )
                told = ["" if np.isnan(value) else f"{value:.{digits}f}" for value in values]
                one.bar_label(drawn, told, rotation=90, padding=2, fontsize=7, color=QUIET)
            one.set_title(title, color=INK)
            one.set_ylabel(ylabel)
            one.grid(axis="x", visible=False)
            one.margins(y=0.24)  # for the numbers
        axes[-1].set_xticks(np.arange(len(figures)), figures)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))
