"""An evaluation as JSON, the `metrics.json` of a results folder, and back."""

import json
from dataclasses import asdict
from typing import Any

from stillroom.errors import TrajectoryError
from stillroom.evaluation.earlier import Earlier
from stillroom.evaluation.report import Comparison, Evaluation, Improvement
from stillroom.evaluation.smoothness import Smoothness
from stillroom.evaluation.trajectory_errors import Alignment, RelativeError, Statistics


def to_json(evaluation: Evaluation) -> str:
    """Return the figures as JSON text; `coverage` is added for readers."""
    return json.dumps(asdict(evaluation) | {"coverage": evaluation.coverage}, indent=2, allow_nan=False) + "\n"


def from_json(text: str) -> Evaluation:
    """Read what `to_json` wrote.

    Raises:
        TrajectoryError: The text holds no such figures.
    """
    try:
        data = json.loads(text)
        at_camera, improvement = data["at_camera"], data["improvement"]
        return Evaluation(
            n_tracked=int(data["n_tracked"]),
            n_given=None if data["n_given"] is None else int(data["n_given"]),
            as_given=_comparison(data["as_given"]),
            at_camera=None if at_camera is None else _comparison(at_camera),
            improvement=None if improvement is None else Improvement(**improvement),
            offset_s=float(data.get("offset_s", 0.0)),  # earlier versions knew no offset
            interpolated=bool(data.get("interpolated", False)),
            online=_read_earlier(data.get("online")),  # earlier versions did not measure these two
            lagged=_read_earlier(data.get("lagged")),
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise TrajectoryError(
            f"not the figures of an evaluation ({type(error).__name__}: {error}); expected a metrics.json"
        ) from None


def _comparison(data: dict[str, Any]) -> Comparison:
    return Comparison(
        groundtruth=str(data["groundtruth"]),
        n_compared=int(data["n_compared"]),
        ate_se3_m=_statistics(data["ate_se3_m"]),
        ate_sim3_m=_statistics(data["ate_sim3_m"]),
        scale=float(data["scale"]),
        still_camera_m=float(data["still_camera_m"]),
        rpe_1s=_relative(data["rpe_1s"]),
        rpe_30_frames=_relative(data["rpe_30_frames"]),
        rpe_refused=str(data.get("rpe_refused", "")),
        smoothness=_read_smoothness(data.get("smoothness")),  # earlier versions measured none
        alignment=Alignment(data.get("alignment", Alignment.SE3)),  # earlier versions knew metric trajectories only
    )


def _read_smoothness(data: dict[str, Any] | None) -> Smoothness | None:
    if data is None:
        return None
    power = data.get("fast_power")  # earlier versions measured none
    errors = {name: _statistics(value) for name, value in data.items() if name != "fast_power"}
    return Smoothness(**errors, fast_power=None if power is None else float(power))


def _read_earlier(data: dict[str, Any] | None) -> Earlier | None:
    if data is None:
        return None
    jitter_m = data["jitter_m"]
    return Earlier(float(data["ate_m"]), None if jitter_m is None else float(jitter_m), int(data["n_compared"]))


def _relative(data: dict[str, Any] | None) -> RelativeError | None:
    if data is None:
        return None
    return RelativeError(
        translation_m=_statistics(data["translation_m"]),
        rotation_deg=_statistics(data["rotation_deg"]),
        n_pairs=int(data["n_pairs"]),
    )


def _statistics(data: dict[str, Any]) -> Statistics:
    return Statistics(**{name: float(value) for name, value in data.items()})
