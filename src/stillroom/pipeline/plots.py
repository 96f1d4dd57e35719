"""The pictures of an evaluation."""

from collections.abc import Mapping
from pathlib import Path

from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.ate import ate
from stillroom.viz.trajectory_plots import plot_error, plot_from_above, plot_over_time

ABOVE, OVER_TIME, ERROR = "trajectory_above.png", "trajectory_over_time.png", "error.png"


def draw_plots(
    folder: Path, estimates: Mapping[str, Trajectory], groundtruth: Trajectory, title: str
) -> tuple[Path, ...]:
    """Draw trajectories against the ground truth, from above and over time, and their errors.

    Args:
        folder: Where to; it is made.
        estimates: Trajectories by the name that the legend shows, the one that is judged first.
        groundtruth: The true poses; only the part that the first estimate covers is drawn.
        title: Shown above.

    Returns:
        The PNG files.

    Raises:
        TrajectoryError: One of them cannot be compared with the ground truth.
        StillroomError: A file cannot be written.
    """
    compared = {name: ate(estimate, groundtruth) for name, estimate in estimates.items()}
    judged = next(iter(compared.values()))
    aligned = {name: error.aligned for name, error in compared.items()}
    plot_from_above(folder / ABOVE, aligned, judged.groundtruth, title)
    plot_over_time(folder / OVER_TIME, aligned, judged.groundtruth, title)
    errors = {name: (error.groundtruth.timestamps_s, error.errors_m) for name, error in compared.items()}
    plot_error(folder / ERROR, errors, judged.still_camera_m, title)
    return folder / ABOVE, folder / OVER_TIME, folder / ERROR
