"""Stillroom's own method: what `oc-slam` rejects, a rolling shutter, and a trajectory that moves as cameras move.

Boxes and clusters, each judged over more than one image by epipolar lines and a history of depth, are those of
`oc-slam`. Beside them, each frame has a velocity, found with its pose from the times at which the rows of its image
were read (`optimize/rolling_pose.py`; only for cameras whose `readout_s` is known), depth counts as much as structured
light deserves and is that of the image's own time (`tracking/depth_clock.py`), nothing is evidence for motion while the
camera turns fast, every frame is fitted once more to the finished map (`tracking/last_look.py`), and the poses of all
frames become one estimate under a prior of smooth motion (`optimize/trajectory_prior.py`).
"""

from dataclasses import replace

from stillroom.dynamics.cluster_sieve import ClusterSieveConfig
from stillroom.loops.loop_closer import LoopsConfig
from stillroom.mapping.local_mapper import LocalMapperConfig
from stillroom.optimize.bundle import BundleConfig
from stillroom.optimize.trajectory_prior import TrajectoryPriorConfig
from stillroom.presets import oc_slam
from stillroom.presets.method import Method
from stillroom.tracking.last_look import LastLookConfig
from stillroom.tracking.shutter import ROLLING, DepthNoiseConfig

_OC_SLAM = oc_slam.METHOD.config
RIGHT_SIGMA = 0.5
"""How well a Kinect's disparity is known; of 1, ½, ¼ and 1/6 the best on a rendered room and on freiburg1_xyz."""
DEPTH = DepthNoiseConfig(right_sigma=RIGHT_SIGMA, in_time=True)

METHOD = Method(
    name="stillroom",
    summary="boxes and clusters of oc-slam; rolling-shutter poses, fitted again in the end; a prior of smooth motion",
    config=replace(
        _OC_SLAM,
        method="stillroom",
        dynamics=ClusterSieveConfig(max_turn_rad_s=0.5),
        tracking=replace(_OC_SLAM.tracking, shutter=ROLLING, depth=DEPTH),
        mapping=LocalMapperConfig(
            bundle=BundleConfig(right_sigma=RIGHT_SIGMA),
            looped_bundle=BundleConfig(first_damping=1e-8, right_sigma=RIGHT_SIGMA),
        ),
        loops=LoopsConfig(bundle=BundleConfig(first_damping=1e-8, right_sigma=RIGHT_SIGMA)),
        last_look=LastLookConfig(enabled=True),
        trajectory=TrajectoryPriorConfig(enabled=True),
    ),
)
