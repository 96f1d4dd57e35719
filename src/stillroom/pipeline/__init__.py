"""A run from input to results folder, and the evaluation of what lies there. `run` is a table of contents."""

from stillroom.pipeline.evaluating import Judged, evaluate_files, evaluate_folder
from stillroom.pipeline.options import RunOptions, RunOutcome, Source
from stillroom.pipeline.run import SILENT, Progress, run

__all__ = [
    "SILENT",
    "Judged",
    "Progress",
    "RunOptions",
    "RunOutcome",
    "Source",
    "evaluate_files",
    "evaluate_folder",
    "run",
]
