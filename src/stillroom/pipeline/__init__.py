"""A run from input to results folder, and its evaluation. Start reading at `run`."""

from stillroom.pipeline.evaluating import EvaluatedTrajectory, evaluate_files, evaluate_folder
from stillroom.pipeline.intake import Intake, Recorded, Streamed
from stillroom.pipeline.options import RunOptions, RunOutcome, Source
from stillroom.pipeline.run import SILENT, RunProgress, run

__all__ = [
    "SILENT",
    "EvaluatedTrajectory",
    "Intake",
    "Recorded",
    "RunOptions",
    "RunOutcome",
    "RunProgress",
    "Source",
    "Streamed",
    "evaluate_files",
    "evaluate_folder",
    "run",
]
