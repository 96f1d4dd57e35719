"""Stillroom's own method: what `oc-slam` rejects, a rolling shutter, and a trajectory that moves as cameras move.

Boxes and clusters, each judged over more than one image by epipolar lines and a history of depth, are those of
`oc-slam`. Beside them, each frame has a velocity, found with its pose from the times at which the rows of its image
were read (`optimize/rolling_pose.py`; only for cameras whose `readout_s` is known), and the poses of all frames become
one estimate under a prior of smooth motion (`optimize/trajectory_prior.py`).
"""

from dataclasses import replace

from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.presets import oc_slam
from stillroom.presets.method import Method
from stillroom.tracking.shutter import ROLLING

_OC_SLAM = oc_slam.METHOD.config

METHOD = Method(
    name="stillroom",
    summary="boxes and clusters of oc-slam; rolling-shutter poses; a trajectory under a prior of smooth motion",
    config=replace(
        _OC_SLAM,
        method="stillroom",
        dynamics=ClusterSieveConfig(max_turn_rad_s=0.5),
        tracking=replace(_OC_SLAM.tracking, shutter=ROLLING),
        trajectory=TrajectoryPriorConfig(enabled=True),
    ),
)
