"""`stillroom view`, and the options of `stillroom run` that show it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from stillroom.viz.viewer.recording import Destination

DEFAULT_FOLDER = Path("results/latest")


def view(
    folder: Annotated[
        Path | None, typer.Argument(metavar="RESULTS", help="Results of a run. \\[default: results/latest]")
    ] = None,
    rerun: Annotated[
        Path | None,
        typer.Option(metavar="FILE.rrd", help="Write it into this file instead of opening a window."),
    ] = None,
) -> None:
    """Show a finished run in rerun's viewer.

    Shows what the results hold: poses, keyframes, ground truth, the dense map, the state of tracking and the time of
    each stage, the sparse map where the run kept a map file, and the images where the sequence is at hand. A run does
    not keep keypoints, boxes, masks and clusters; 'stillroom run … --rerun FILE.rrd' does.

        stillroom view results/latest
        stillroom view results/latest --rerun run.rrd
    """
    from stillroom.cli.output import STDERR, FrameBar, print_lines, show_log
    from stillroom.pipeline.replay import replay

    show_log()
    (destination,) = destinations(rerun is None, rerun)
    bar = FrameBar(STDERR)
    bar.label = "replay"
    shown = replay(folder or DEFAULT_FOLDER, destination, bar)
    sentences = [f"{shown.n_frames} frames, {shown.n_images} of them with their image"]
    sentences += [f"not shown: {what}" for what in shown.missing]
    if rerun is not None:
        sentences.append(f"recording: {rerun}; open it with 'rerun {rerun}'")
    print_lines(sentences)


def destinations(window: bool, file: Path | None) -> "tuple[Destination, ...]":
    """Return where a run is to be shown.

    Args:
        window: Whether in a window.
        file: The file to write; None for none.

    Raises:
        MissingExtraError: It is to be shown, and rerun is not installed.
        ConfigError: The file cannot be written there, or its suffix is not `.rrd`.
    """
    if not window and file is None:
        return ()
    from stillroom.viz.viewer.recording import Destination

    wanted = (*([Destination()] if window else []), *([Destination(file)] if file is not None else []))
    for destination in wanted:
        destination.require_usable()
    return wanted
