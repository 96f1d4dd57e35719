"""DynaSLAM's test of a point on points that a homography carried: is something nearer where the point should be?"""

from dataclasses import dataclass, field

import numpy as np

from stillroom.bounds import bounded
from stillroom.data.frame import Frame
from stillroom.dynamics.multiview.multiview_geometry import offsets, rays_of
from stillroom.dynamics.multiview.multiview_kernels import (
    DYNAMIC,
    UNSEEN,
    Here,
    KeyframeDepths,
    Limits,
    Points,
    PointVerdicts,
    judge_points,
)
from stillroom.dynamics.multiview.multiview_sieve import PaperMultiViewConfig
from stillroom.dynamics.projected.compensation_frame import CompensationFrame, PreviousFrame
from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, I32, I64, U8, Bool

_DYNASLAM = PaperMultiViewConfig().test
"""DynaSLAM's numbers: its paper's, and where that gives none its code's (docs/reference.md#dynaslam)."""


@dataclass(frozen=True)
class OcclusionConfig:
    """The numbers of the test (DynaSLAM III.C; docs/reference.md#dynaslam).

    Attributes:
        max_parallax_deg: A point is not tested where the previous frame saw it from a direction farther off [°].
        tau_m: A point is dynamic where the depth is smaller than its own by more than this (τ) [m].
        reference_far_m, far_m: Points farther from the previous or the present camera are not tested [m].
        window_px: Half the window in which something nearer is searched; the nearest pixel counts.
        patch_px: Half the side of the patch whose depth variance must be small.
        patch_std_m: Largest standard deviation of depth in it; where it is larger, the point is static.
    """

    max_parallax_deg: float = bounded(_DYNASLAM.max_parallax_deg, least=0)
    tau_m: float = bounded(_DYNASLAM.tau_m, least=0)
    reference_far_m: float = bounded(_DYNASLAM.keyframes.far_m, above=0)
    far_m: float = bounded(_DYNASLAM.far_m, above=0)
    window_px: int = bounded(_DYNASLAM.window_px, least=0, pixels=1)
    patch_px: int = bounded(_DYNASLAM.patch_px, least=0, pixels=1)
    patch_std_m: float = bounded(_DYNASLAM.patch_std_m, least=0)

    @property
    def limits(self) -> Limits:
        """The numbers as the kernel takes them; no keyframe is asked whether it saw through the place."""
        cosine = float(np.cos(np.deg2rad(self.max_parallax_deg)))
        return Limits(
            cosine, self.tau_m, 0.0, self.far_m, self.patch_px, self.patch_std_m, 0.0, False, 0.0, 0.0
        )  # fmt: skip


@dataclass(frozen=True)
class Occlusion:
    """A test of the previous frame's features at the places x′ to which the homography carried them.

    Call it with those to be tested.

    Attributes:
        keypoint: Their numbers in the previous frame (N,); those with a depth that fall into the image.
        raw_px: x′ in the present image as taken (N, 2) [px].
        points: The same for the kernel: where the previous frame saw them, the pixel of x′, and z_proj.
        here, there: The present depth image, and the previous frame, in the place of a keyframe.
        limits, window: The numbers, and the offsets at which something nearer is searched.
        verdict: Result of each point so far (N,); see `multiview_kernels`.
        before_px: The pixel of what occludes it (N, 2), column first.
    """

    keypoint: I64 = field(repr=False)
    raw_px: F64 = field(repr=False)
    points: Points = field(repr=False)
    here: Here = field(repr=False)
    there: KeyframeDepths = field(repr=False)
    limits: Limits
    window: I32 = field(repr=False)
    verdict: U8 = field(repr=False)
    before_px: I32 = field(repr=False)

    def __call__(self, which: I64) -> Bool:
        """Return which of the points `which` (K,) are dynamic; their results are stored in `verdict`."""
        judged = PointVerdicts(self.verdict, self.before_px)
        judge_points(which, self.points, self.here, self.there, self.window, self.limits, judged)
        return np.asarray(self.verdict[which] == DYNAMIC)


def occlusion_of(
    earlier: PreviousFrame, moved: CompensationFrame, frame: Frame, T_cam_world: F64, config: OcclusionConfig
) -> Occlusion:
    """Return the test of the previous frame's features outside its masks, for a present pose (4, 4).

    The depth of a feature is that of the compensation frame at x′. The motion of the camera takes the point that the
    previous frame saw at that depth to z_proj, with which the depth measured at x′ is compared.
    """
    camera, keypoints = frame.camera, earlier.frame.keypoints
    chosen = np.flatnonzero(~earlier.is_masked)
    raw_px = camera.distort(moved.carried_px(keypoints.px[chosen]))
    # Comparisons with infinity and NaN are false: what the homography carries beyond its horizon falls outside.
    x, y = raw_px.T
    inside = (x >= -0.5) & (y >= -0.5) & (x < camera.width - 0.5) & (y < camera.height - 0.5)
    chosen, raw_px = chosen[inside], raw_px[inside]
    px = np.floor(raw_px + 0.5).astype(np.int32)
    depth_m = moved.depth_m[px[:, 1], px[:, 0]].astype(np.float64)
    known = (depth_m > 0) & (depth_m < config.reference_far_m)
    chosen, raw_px, px = chosen[known], raw_px[known], px[known]
    points_m = camera.back_project(keypoints.px[chosen], depth_m[known])
    T_now_then = T_cam_world @ se3.inverse(earlier.T_cam_world)
    z_m, n = se3.transform(T_now_then, points_m)[:, 2], len(chosen)
    # Nothing projects a point from behind the camera; such a one is not tested.
    px[z_m <= 0.0] = -1
    here_in_there_m = se3.inverse(T_now_then)[:3, 3]
    return Occlusion(
        keypoint=chosen,
        raw_px=raw_px,
        points=Points(points_m, np.zeros(n, dtype=np.int64), px, np.ascontiguousarray(z_m)),
        here=Here(
            np.ascontiguousarray(frame.image.depth_m, dtype=np.float32),
            rays_of(camera),
            se3.inverse(T_cam_world),
            camera.lens,
        ),
        there=KeyframeDepths(
            np.zeros((1, 1, 1, 3), dtype=np.float32),
            earlier.T_cam_world[None].copy(),
            T_now_then[None].copy(),
            np.stack((np.zeros(3), here_in_there_m))[None],
        ),
        limits=config.limits,
        window=offsets(config.window_px),
        verdict=np.full(n, UNSEEN, dtype=np.uint8),
        before_px=np.full((n, 2), -1, dtype=np.int32),
    )
