"""OpenCV's robust estimators: the same pairs and seed give the same answer, and a degenerate input gives none."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from stillroom.geometry.arrays import F64, Bool, Floats

Model = tuple[F64, Bool]
"""A matrix (3, 3), and which pairs (N,) agree with it."""


def find_homography(first_px: Floats, second_px: Floats, settings: cv2.UsacParams) -> Model | None:
    """Return the homography (3, 3) that most pairs (N, 2) [px] agree with; None where they determine none."""
    return _find(cv2.findHomography, first_px, second_px, settings)


def find_fundamental(first_px: Floats, second_px: Floats, settings: cv2.UsacParams) -> Model | None:
    """Return the fundamental matrix (3, 3) that most pairs (N, 2) [px] agree with; None where they determine none."""
    return _find(cv2.findFundamentalMat, first_px, second_px, settings)


def usac(inlier_px: float, seed: int, confidence: float, magsac: bool = True) -> cv2.UsacParams:
    """Return the settings of a robust estimation.

    Args:
        inlier_px: Largest residual of a pair that agrees [px].
        seed: Of the random samples.
        confidence: Probability with which one of the samples is free of outliers.
        magsac: Whether to use MAGSAC++, which weights pairs and refines the best model; else OpenCV's plain RANSAC,
            which fits its best model again to the pairs that agree (`sampled_homography` does not).
    """
    params = cv2.UsacParams()
    params.randomGeneratorState = seed
    params.threshold = inlier_px
    params.confidence = confidence
    params.sampler = cv2.SAMPLING_UNIFORM
    params.score = cv2.SCORE_METHOD_MAGSAC if magsac else cv2.SCORE_METHOD_RANSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA if magsac else cv2.LOCAL_OPTIM_NULL
    params.final_polisher = cv2.COV_POLISHER if magsac else cv2.NONE_POLISHER
    return params


def _find(estimator: Callable[..., Any], first_px: Floats, second_px: Floats, settings: cv2.UsacParams) -> Model | None:
    first, second = (np.ascontiguousarray(px, dtype=np.float64) for px in (first_px, second_px))
    try:
        found, agrees = estimator(first, second, settings)
    except cv2.error:  # OpenCV raises this when every sample was degenerate.
        return None
    if found is None or found.shape != (3, 3) or not np.all(np.isfinite(found)):
        return None
    return np.asarray(found, dtype=np.float64), np.asarray(agrees, dtype=np.bool_).ravel()
