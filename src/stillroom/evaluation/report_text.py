"""An evaluation in plain words and rows, for whoever prints it."""

from stillroom.evaluation.report import Comparison, Evaluation, Improvement
from stillroom.evaluation.rpe import RelativeError
from stillroom.evaluation.statistics import Statistics

HEADER = ("error", "ground truth", "rmse", "mean", "median", "std", "min", "max")
"""Names of the columns of `rows`."""


def rows(evaluation: Evaluation) -> list[tuple[str, ...]]:
    """Return one row of text for each kind of error, its cells as in `HEADER`; the unit stands in the first."""
    comparisons = (evaluation.as_given, evaluation.at_camera)
    return [row for comparison in comparisons if comparison is not None for row in _rows(comparison)]


def lines(evaluation: Evaluation) -> list[str]:
    """Return, a sentence a line, what the rows must be read with: coverage, pairs, convention, the still camera."""
    sentences = [_coverage(evaluation)]
    for comparison in (evaluation.as_given, evaluation.at_camera):
        if comparison is not None:
            sentences.append(
                f"{comparison.n_compared} poses compared with the ground truth {comparison.groundtruth}; a camera "
                f"that never moved has ATE {comparison.still_camera_m:.4f} m there (SE(3), RMSE)"
            )
    if evaluation.at_camera is not None:
        sentences.append(
            f"RPE means something only against the ground truth {evaluation.at_camera.groundtruth}: the given poses "
            "are those of another body"
        )
    if evaluation.improvement is not None:
        sentences.append(_improvement(evaluation.improvement))
    return sentences


def as_text(evaluation: Evaluation) -> str:
    """Return rows, aligned in columns, and sentences as one text without colour."""
    table = [HEADER, *rows(evaluation)]
    widths = [max(len(row[column]) for row in table) for column in range(len(HEADER))]
    text = []
    for row in table:
        words = [cell.ljust(width) for cell, width in zip(row[:2], widths[:2], strict=True)]
        numbers = [cell.rjust(width) for cell, width in zip(row[2:], widths[2:], strict=True)]
        text.append("  ".join([*words, *numbers]))
    return "\n".join([*text, "", *lines(evaluation)]) + "\n"


def percent(share: float | None) -> str:
    """Return a share of 1 as per cent, never rounded up to 100 %; '–' for None."""
    if share is None:
        return "–"
    text = f"{share * 100:.1f} %"
    return "99.9 %" if share < 1 and text == "100.0 %" else text


def _rows(comparison: Comparison) -> list[tuple[str, ...]]:
    truth, scale = comparison.groundtruth, comparison.scale
    return [
        _row("ATE [m], SE(3)", truth, comparison.ate_se3_m, 4),
        _row(f"ATE [m], Sim(3), scale {scale:.4f}", truth, comparison.ate_sim3_m, 4),
        *_relative_rows("over 1 s", ("m/s", "deg/s"), truth, comparison.rpe_1s),
        *_relative_rows("over 30 frames", ("m", "deg"), truth, comparison.rpe_30_frames),
    ]


def _relative_rows(
    interval: str, units: tuple[str, str], truth: str, error: RelativeError | None
) -> list[tuple[str, ...]]:
    translation, rotation = (f"RPE [{unit}] {interval}" for unit in units)
    if error is None:
        return [(name, truth, *["–"] * (len(HEADER) - 2)) for name in (translation, rotation)]
    return [_row(translation, truth, error.translation_m, 4), _row(rotation, truth, error.rotation_deg, 3)]


def _row(name: str, truth: str, s: Statistics, digits: int) -> tuple[str, ...]:
    return (name, truth, *(f"{value:.{digits}f}" for value in (s.rmse, s.mean, s.median, s.std, s.min, s.max)))


def _coverage(evaluation: Evaluation) -> str:
    if evaluation.n_given is None:
        return f"{evaluation.n_tracked} poses; of how many frames is not known, so neither is the coverage"
    return f"{evaluation.n_tracked} of {evaluation.n_given} frames tracked ({percent(evaluation.coverage)})"


def _improvement(gain: Improvement) -> str:
    parts = [
        f"{name} {value:+.1f} %"
        for name, value in (
            ("ATE", gain.ate_percent),
            ("RPE translation", gain.rpe_translation_percent),
            ("RPE rotation", gain.rpe_rotation_percent),
        )
        if value is not None
    ]
    return f"improvement over {gain.baseline} in RMSE, (1 − β/α)·100: {', '.join(parts) or 'not comparable'}"
