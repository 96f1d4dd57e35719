"""The absolute trajectory error (Sturm et al., IROS 2012; TUM's evaluate_ate.py)."""

from dataclasses import dataclass, field

import numpy as np

from stillroom.data.association import TUM_MAX_GAP_S
from stillroom.data.trajectory import Trajectory
from stillroom.evaluation.pairing import pair
from stillroom.evaluation.statistics import Statistics
from stillroom.geometry.align import align
from stillroom.geometry.arrays import F64


@dataclass(frozen=True)
class AbsoluteError:
    """How far the camera centres lie from the truth once one trajectory is laid upon the other.

    The classical tables align with SE(3), the learned systems' with Sim(3), which can only be lower
    (docs/reference.md#comparing-figures): both are here.

    Attributes:
        se3_m: Errors after a rigid alignment [m].
        sim3_m: Errors after an alignment that may also scale [m].
        scale: The scale that the Sim(3) alignment multiplies the estimate by.
        still_camera_m: RMSE of a camera that never moved, over the same poses [m]; what `se3_m` is read against.
        aligned: The compared poses of the estimate after SE(3) alignment, N of them.
        groundtruth: Their counterparts, N.
        errors_m: Distance of each pair after SE(3) alignment (N,) [m].
    """

    se3_m: Statistics
    sim3_m: Statistics
    scale: float
    still_camera_m: float
    aligned: Trajectory = field(repr=False)
    groundtruth: Trajectory = field(repr=False)
    errors_m: F64 = field(repr=False)

    @property
    def n_compared(self) -> int:
        """Number of poses compared."""
        return len(self.errors_m)


def ate(estimate: Trajectory, groundtruth: Trajectory, max_gap_s: float = TUM_MAX_GAP_S) -> AbsoluteError:
    """Measure the absolute trajectory error of all poses that find a partner in time.

    Raises:
        TrajectoryError: The two cannot be compared (see `pair`).
    """
    estimate, groundtruth = pair(estimate, groundtruth, max_gap_s)
    source_m, target_m = estimate.positions_m, groundtruth.positions_m
    rigid, similar = align(source_m, target_m, with_scale=False), align(source_m, target_m, with_scale=True)
    errors_m = np.linalg.norm(rigid.points(source_m) - target_m, axis=1)
    return AbsoluteError(
        se3_m=Statistics.of(errors_m),
        sim3_m=Statistics.of(np.linalg.norm(similar.points(source_m) - target_m, axis=1)),
        scale=similar.scale,
        still_camera_m=still_camera_m(target_m),
        aligned=Trajectory(estimate.timestamps_s, rigid.poses(estimate.T_world_cam)),
        groundtruth=groundtruth,
        errors_m=errors_m,
    )


def still_camera_m(positions_m: F64) -> float:
    """Return the ATE RMSE [m] of a camera that never moved: the spread of the true positions (N, 3) [m].

    Laid upon the truth, a single point comes to lie on the mean of the true positions.
    """
    return float(np.sqrt(np.mean(np.sum((positions_m - positions_m.mean(axis=0)) ** 2, axis=1))))
