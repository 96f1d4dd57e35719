"""The compensation frame: the previous image and its features, projected into the present one by a homography."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from stillroom.bounds import bounded
from stillroom.compiled import njit
from stillroom.data.frame import Frame
from stillroom.dynamics.multiview.multiview_geometry import rays_of
from stillroom.features.matching import NEAR_BITS, Queries, Targets, consistent_rotation, search_windows
from stillroom.geometry import homography
from stillroom.geometry.arrays import F32, F64, I32, U8, Bool
from stillroom.geometry.camera import Camera, Lens
from stillroom.geometry.distortion import distorted
from stillroom.geometry.homography import HomographyFit
from stillroom.geometry.sampled_homography import of_four_pairs


@dataclass(frozen=True)
class CompensationFrameConfig:
    """How the homography is found (PSPNet-SLAM III.B, Eq. 10–11).

    RANSAC over samples of four pairs, then Levenberg–Marquardt on the error in the present image alone, as Eq. 11 has
    it. The paper does not say how features are matched, nor when a pair agrees. Here ORB's descriptors are searched as
    ORB-SLAM2 does between two images of which it knows nothing (its initialization).

    Attributes:
        window_px: Half the side of the square around a feature's old place that is searched [px].
        ratio: The best match must be nearer than this share of the second best.
        inlier_px: Largest residual of a pair that agrees with RANSAC's homography [px]; OpenCV's default.
        min_inliers: With fewer pairs that agree there is no homography.
    """

    window_px: float = bounded(100.0, above=0, pixels=1)
    ratio: float = bounded(0.9, above=0, most=1)
    inlier_px: float = bounded(3.0, above=0, pixels=1)
    min_inliers: int = bounded(20, least=8)


@dataclass(frozen=True)
class PreviousFrame:
    """The very last frame.

    Attributes:
        frame: Its image and keypoints.
        is_masked: Which keypoints (N,) lie on what is potentially dynamic.
        T_cam_world: Its pose as tracked (4, 4).
    """

    frame: Frame
    is_masked: Bool = field(repr=False)
    T_cam_world: F64


@dataclass(frozen=True)
class CompensationFrame:
    """The previous image as the camera's motion alone would show it now (Figure 5).

    Attributes:
        fit: The homography of undistorted pixels, previous to present, and the pairs that agree.
        previous, present: The matched keypoints of the two frames (P,) each.
        gray: Brightness (H, W), warped; 0 where the previous image saw nothing.
        depth_m: Depth (H, W) float32 [m] as the previous image measured it, moved, not interpolated; 0 where unknown.
    """

    fit: HomographyFit
    previous: I32 = field(repr=False)
    present: I32 = field(repr=False)
    gray: U8 = field(repr=False)
    depth_m: F32 = field(repr=False)

    def carried_px(self, px: F32) -> F64:
        """Return where the homography carries undistorted points (N, 2) of the previous image, (N, 2) [px] (Eq. 10)."""
        return homography.apply(self.fit.H_second_first, px)


def compensate(
    earlier: PreviousFrame, frame: Frame, is_masked: Bool, config: CompensationFrameConfig, seed: int
) -> CompensationFrame | None:
    """Find the homography between two frames, and warp the previous image by it; None where too few pairs agree.

    Args:
        earlier: The previous frame.
        frame: The present one.
        is_masked: Which of its keypoints (N,) lie on what is potentially dynamic. Such pairs are left out.
        config: How.
        seed: Of RANSAC's samples.
    """
    previous, present = matched(earlier.frame, frame, ~earlier.is_masked, ~is_masked, config)
    first_px, second_px = earlier.frame.keypoints.px[previous], frame.keypoints.px[present]
    fit = of_four_pairs(first_px, second_px, config.inlier_px, seed)
    if fit is None or np.count_nonzero(fit.is_inlier) < config.min_inliers:
        return None
    fit = homography.refine(fit, first_px, second_px, symmetric=False)
    image = earlier.frame.image
    x_px, y_px = origins(frame.camera, fit.H_second_first)
    gray = cv2.remap(image.gray, x_px, y_px, cv2.INTER_LINEAR)
    depth_m = cv2.remap(image.depth_m, x_px, y_px, cv2.INTER_NEAREST)
    return CompensationFrame(
        fit, previous, present, np.asarray(gray, dtype=np.uint8), np.asarray(depth_m, dtype=np.float32)
    )


def matched(
    earlier: Frame, frame: Frame, usable_then: Bool, usable_now: Bool, config: CompensationFrameConfig
) -> tuple[I32, I32]:
    """Return the keypoints of two frames that match (P,) each, of those that may be used (M,) and (N,)."""
    chosen = np.flatnonzero(usable_then).astype(np.int32)
    then, now, n = earlier.keypoints, frame.keypoints, len(chosen)
    if n == 0 or not usable_now.any():
        return np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32)
    queries = Queries(
        px=then.px[chosen],
        radius_px=np.full(n, config.window_px, dtype=np.float32),
        min_octave=then.octave[chosen] - 1,
        max_octave=then.octave[chosen] + 1,
        right_px=np.full(n, -1.0, dtype=np.float32),
        descriptors=then.descriptors,
        row=chosen,
    )
    targets = Targets(now.px, now.octave, now.right_px, now.descriptors, usable_now)
    query, target = search_windows(queries, targets, NEAR_BITS, config.ratio)
    steady = consistent_rotation(then.angle_rad[chosen[query]], now.angle_rad[target])
    return chosen[query][steady], target[steady]


def origins(camera: Camera, H_present_previous: F64) -> F32:
    """Return where in the previous image, as taken, each pixel of the compensation frame comes from.

    Returns:
        Columns and rows (2, H, W) float32 [px].
    """
    from_px = np.empty((2, camera.height, camera.width), dtype=np.float32)
    # Rays in place of pixels: the homography of undistorted pixels, between two changes of units.
    rays_previous_present = np.linalg.inv(camera.K) @ np.linalg.inv(H_present_previous) @ camera.K
    write_origins(rays_of(camera), np.ascontiguousarray(rays_previous_present), camera.lens, from_px)
    return from_px


@njit(nogil=True, cache=True, error_model="numpy")
def write_origins(rays: F32, M: F64, lens: Lens, from_px: F32) -> None:
    """Write `origins`, given rays at unit depth (H, W, 2) and the homography of rays, present to previous (3, 3)."""
    for row in range(rays.shape[0]):
        for column in range(rays.shape[1]):
            x, y = float(rays[row, column, 0]), float(rays[row, column, 1])
            w = M[2, 0] * x + M[2, 1] * y + M[2, 2]
            if not w > 0.0:  # beyond the horizon
                from_px[0, row, column] = from_px[1, row, column] = -1e4
                continue
            u, v = distorted(lens, (M[0, 0] * x + M[0, 1] * y + M[0, 2]) / w, (M[1, 0] * x + M[1, 1] * y + M[1, 2]) / w)
            from_px[0, row, column], from_px[1, row, column] = u, v
