"""`stillroom evaluate`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillroom.cli.arguments import MAX_GAP_S, PLOT_FORMATS, Formats, chosen_of
from stillroom.errors import ConfigError, TrajectoryError

if TYPE_CHECKING:
    from stillroom.evaluation.time_matching import TimeMatching
    from stillroom.evaluation.trajectory_errors import Alignment
    from stillroom.pipeline.results import Truth

DEFAULT_FOLDER = Path("results/latest")
Sequence = Annotated[
    str | None, typer.Option(metavar="SEQUENCE", help="The sequence whose ground truth it is, instead of a file.")
]
Baseline = Annotated[
    Path | None, typer.Option(metavar="PATH", help="Another folder, or file, to report the improvement over.")
]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Where figures and pictures of an estimate go.")]
MaxGap = Annotated[float, typer.Option(metavar="S", help="Poses further apart in time than this are not compared.")]
Offset = Annotated[
    str,
    typer.Option(metavar="S|estimate", help="Add this to the estimate's times; 'estimate' finds it from the motion."),
]
Interpolate = Annotated[
    bool, typer.Option("--interpolate", help="Interpolate the ground truth, which is slow, at the estimate's times.")
]
Align = Annotated[
    str | None,
    typer.Option(
        metavar="se3|sim3",
        help="Align rigidly, or with a free scale. \\[default: se3; sim3 of trajectories that are up to scale]",
    ),
]


def evaluate(
    folder: Annotated[
        Path | None, typer.Argument(metavar="FOLDER", help="Results of a run. \\[default: results/latest]")
    ] = None,
    estimate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Any trajectory in the TUM format, instead of a folder.")
    ] = None,
    groundtruth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The ground truth of the estimate, in the TUM format.")
    ] = None,
    sequence: Sequence = None,
    baseline: Baseline = None,
    out: Out = None,
    max_gap: MaxGap = MAX_GAP_S,
    offset: Offset = "0",
    interpolate: Interpolate = False,
    align: Align = None,
    formats: Formats = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON; write nothing.")] = False,
) -> None:
    """Evaluate a trajectory: ATE and RPE.

    Against the ground truth, beside the static-pose baseline: a camera that never moved. A monocular run, which knows
    no scale, is aligned by Sim(3), and so is any trajectory with --align sim3; RPE is then of the scaled trajectory.

    Figures, pictures and the report are written into the folder of the run.

        stillroom evaluate results/latest --baseline results/the_run_before
        stillroom evaluate --estimate mine.txt --groundtruth groundtruth.txt
    """
    from stillroom.cli.output import show_log
    from stillroom.evaluation.report_file import to_json
    from stillroom.pipeline import evaluate_files, evaluate_folder
    from stillroom.pipeline.results import chosen_folder, new_folder

    show_log()
    alignment = None if align is None else _alignment(align)
    matching, drawn = _matching(max_gap, offset, interpolate), chosen_of("--format", formats, PLOT_FORMATS)
    if estimate is None:
        _refuse(("--groundtruth", groundtruth), ("--sequence", sequence), ("--out", out))
        judged = evaluate_folder(folder or DEFAULT_FOLDER, baseline, not json, matching, drawn, alignment)
    else:
        if folder is not None:
            raise ConfigError(f"both {folder} and --estimate {estimate} are given; leave one out")
        truth = _truth(groundtruth, sequence)
        place = None
        if not json:
            place = (
                chosen_folder(out) if out else new_folder(Path("results"), "evaluation", estimate.stem, latest=False)
            )
        judged = evaluate_files(estimate, truth, place, baseline, matching, drawn, alignment)
    if json:
        typer.echo(to_json(judged.evaluation), nl=False)
        return
    from stillroom.cli.output import print_evaluation, print_lines

    print_lines([judged.name])
    print_evaluation(judged.evaluation)
    print_lines([f"figures and {len(judged.pictures)} pictures: {_shown(judged.folder)}"])


def _matching(max_gap_s: float, offset: str, interpolate: bool) -> "TimeMatching":
    from stillroom.evaluation.time_matching import ESTIMATE, TimeMatching

    if offset == ESTIMATE:
        return TimeMatching(max_gap_s, None, interpolate)
    try:
        return TimeMatching(max_gap_s, float(offset), interpolate)
    except ValueError:
        raise ConfigError(f"offset is '{offset}'; it must be a number of seconds, or '{ESTIMATE}'") from None


def _alignment(asked: str) -> "Alignment":
    from stillroom.evaluation.trajectory_errors import Alignment

    named = {"se3": Alignment.SE3, "sim3": Alignment.SIM3}
    if asked not in named:
        raise ConfigError(f"align is '{asked}'; it must be 'se3' or 'sim3'")
    return named[asked]


def _shown(folder: Path | None) -> str:
    """Return a folder as seen from here."""
    if folder is not None and folder.is_relative_to(Path.cwd()):
        folder = folder.relative_to(Path.cwd())
    return str(folder)


def _refuse(*options: tuple[str, object]) -> None:
    for name, value in options:
        if value is not None:
            raise ConfigError(f"{name} goes with --estimate; the folder of a run has its own")


def _truth(groundtruth: Path | None, sequence: str | None) -> "Truth":
    from stillroom.data.trajectory import read_tum
    from stillroom.datasets.recording import groundtruth_flaw
    from stillroom.pipeline import Source
    from stillroom.pipeline.results import Truth

    if (groundtruth is None) == (sequence is None):
        raise ConfigError("--estimate needs a ground truth: one of --groundtruth FILE and --sequence SEQUENCE")
    if groundtruth is not None:
        return Truth(read_tum(groundtruth))
    dataset = Source(str(sequence)).open()
    truth = Truth.of(dataset)
    flaw = groundtruth_flaw(dataset)
    if flaw:
        raise TrajectoryError(f"{flaw} [see troubleshooting: groundtruth]")
    if truth is None:
        raise ConfigError(f"--sequence {sequence}: it has no ground truth; give a file with --groundtruth")
    return truth
