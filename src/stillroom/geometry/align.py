"""The motion that aligns one set of points with another: Horn 1987, in Umeyama's form (PAMI 1991)."""

from dataclasses import dataclass

import numpy as np

from stillroom.geometry import se3
from stillroom.geometry.arrays import F64, Floats

MIN_POINTS = 3
"""Fewer points leave the rotation undetermined."""


@dataclass(frozen=True)
class Similarity:
    """A rotation, a translation and a scale: `p_target = scale · R p_source + t`.

    Attributes:
        scale: Lengths of the target per length of the source; 1 for a rigid motion.
        T_target_source: The rotation R and translation t [m] as a motion (4, 4); to be applied after scaling.
    """

    scale: float
    T_target_source: F64

    def points(self, points_source: Floats) -> F64:
        """Take points (N, 3) of the source to the target, (N, 3)."""
        return se3.transform(self.T_target_source, self.scale * np.asarray(points_source, dtype=np.float64))

    def poses(self, T_source_cam: Floats) -> F64:
        """Take poses (N, 4, 4) in the source to the target: positions are scaled, rotations only turned."""
        scaled = np.array(T_source_cam, dtype=np.float64)
        scaled[:, :3, 3] *= self.scale
        moved: F64 = self.T_target_source @ scaled
        return moved


def align(source: Floats, target: Floats, with_scale: bool) -> Similarity:
    """Find the motion with the least sum of squared distances between moved source and target.

    Where the points do not determine the rotation (fewer than three, or all of one set in one place) it is the
    identity, the scale 1, and the means are aligned. Points on one line leave the rotation about it undetermined; one
    of the best motions is returned.

    Args:
        source: Points (N, 3), finite.
        target: Their counterparts (N, 3), finite.
        with_scale: Whether the scale is free, Sim(3), or held at 1, SE(3).
    """
    source, target = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    if len(source) == 0:
        return Similarity(1.0, se3.identity())
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    centred_source, centred_target = source - mean_source, target - mean_target
    if len(source) < MIN_POINTS or _in_one_place(centred_source, source) or _in_one_place(centred_target, target):
        return Similarity(1.0, se3.from_rotation_translation(np.eye(3), mean_target - mean_source))
    covariance = centred_target.T @ centred_source / len(source)  # (3, 3), Umeyama Eq. 38
    U, singular, Vt = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])  # Eq. 39: no mirror images
    R = (U * signs) @ Vt
    scale = float(singular @ signs / np.mean(np.sum(centred_source**2, axis=1))) if with_scale else 1.0  # Eq. 42
    return Similarity(scale, se3.from_rotation_translation(R, mean_target - scale * R @ mean_source))


def align_poses(T_source_cam: Floats, T_target_cam: Floats) -> F64:
    """Find the rigid motion `T_target_source` (4, 4) that best aligns poses (N, 4, 4), N ≥ 1, with their counterparts.

    Unlike `align`, which knows positions only, it takes the rotation from those of the poses, and is well determined
    however little the camera moved: the rotation is the chordal mean of those that the pairs ask for, the
            translation the mean one.
    """
    wanted = np.asarray(T_target_cam)[:, :3, :3] @ np.swapaxes(np.asarray(T_source_cam)[:, :3, :3], 1, 2)
    turned = se3.orthonormalize(se3.from_rotation_translation(wanted.mean(axis=0), np.zeros(3)))
    turned[:3, 3] = np.mean(T_target_cam[:, :3, 3] - T_source_cam[:, :3, 3] @ turned[:3, :3].T, axis=0)
    return turned


def _in_one_place(centred: Floats, points: Floats) -> bool:
    """Return whether points differ by no more than rounding."""
    return bool(np.abs(centred).max() <= 1e-12 * (1.0 + np.abs(points).max()))
