"""Keypoints as the optimisers want them."""

import numpy as np

from stillroom.geometry.arrays import F64, Floats, Ints


def observed_px(px: Floats, right_px: Floats) -> F64:
    """Return u, v, u_right (N, 3) [px] of keypoints at (N, 2) with right coordinates (N,), −1 for none."""
    return np.column_stack((px, np.maximum(right_px, 0.0))).astype(np.float64)


def weights(octave: Ints, right_px: Floats, inverse_variances: Floats) -> F64:
    """Return inverse variances (N, 3) [1/px²]; the third is 0 where there is no right coordinate.

    Args:
        octave: Level of each keypoint (N,).
        right_px: Right coordinates (N,), −1 for none.
        inverse_variances: Weight on each level (L,) [1/px²].
    """
    weight = np.asarray(inverse_variances, dtype=np.float64)[octave]
    return np.stack((weight, weight, np.where(right_px >= 0, weight, 0.0)), axis=1)
