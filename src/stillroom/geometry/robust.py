"""OpenCV's robust estimators, set up so that the same seed gives the same answer."""

import cv2


def usac(inlier_px: float, seed: int, confidence: float, magsac: bool = True) -> cv2.UsacParams:
    """Return the settings of a robust estimation.

    Args:
        inlier_px: Largest residual of a pair that agrees [px].
        seed: Of the samples that are drawn.
        confidence: Probability with which one of the samples is free of outliers.
        magsac: Whether pairs are weighed and the best answer is polished (MAGSAC++); else RANSAC by the book, whose
            answer goes exactly through a sample.
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
